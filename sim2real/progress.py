"""Long computations: a progress bar, and items that several processes share."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MANY = 24
"""Number of items from which processes are started."""

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


def shared(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of ``work`` for every item, in order.

    ``work`` must be a function of a module that is quick to import and does not use Warp.
    """
    if len(items) < MANY:
        return [work(item) for item in items]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        with _deaf_to_interrupts():
            results = pool.map(work, items, chunksize=4)
        return list(results)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Context in which processes start that leave Ctrl-C to this one, which then ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
