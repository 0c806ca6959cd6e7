"""The same work on many things, shared among processes where there are many."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Given = TypeVar("Given")
Made = TypeVar("Made")

MANY = 24
"""Things from which it pays to start processes."""


def shared(work: Callable[[Given], Made], things: Sequence[Given]) -> list[Made]:
    """``work`` on every thing, in order.

    ``work`` must be a function of a module that is quick to import and free of Warp.
    """
    if len(things) < MANY:
        return [work(thing) for thing in things]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(work, things, chunksize=4))
