"""Progress bars for operations that take more than two seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[float], None]
"""What an operation calls with the share of it that is done, from 0 to 1."""


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Show a bar on a terminal and nothing elsewhere.

    Yields:
        A function to call with the completed share, from 0 to 1.
    """
    from tqdm import tqdm

    with tqdm(total=100, desc=title, unit="%", disable=None) as bar:
        yield lambda share: bar.update(round(100 * share) - bar.n)
