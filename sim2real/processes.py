"""Map a function over many items, in several processes if there are enough."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MANY = 24
"""Number of items from which processes are started."""


def shared(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of ``work`` for every item, in order.

    ``work`` must be a function of a module that is quick to import and does not use Warp.
    """
    if len(items) < MANY:
        return [work(item) for item in items]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(work, items, chunksize=4))
