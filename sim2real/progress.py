"""Long computations: a progress bar, and items that several processes share."""

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
    """Show a bar on a terminal and nothing elsewhere; yields what to call."""
    from tqdm import tqdm

    with tqdm(total=100, desc=title, unit="%", disable=None) as bar:
        yield lambda share: bar.update(round(100 * share) - bar.n)


def shared(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of ``work``, of a module that is quick to import, for every item, in order."""
    if len(items) < MANY:
        return [work(item) for item in items]
    interrupts = (signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for this process, which ends them
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(None, spawn, signal.signal, interrupts) as pool:
        return list(pool.map(work, items, chunksize=4))
