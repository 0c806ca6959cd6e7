"""Ahead of other programs while the servos are driven, where the system allows it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def priority() -> Iterator[bool]:
    """Within this block the calling thread has real-time priority, if it may; says whether.

    A computer with other work then still keeps the bus's schedule; the loop sleeps most of the
    time, so that the others lose little. On Linux it takes root or a limit on ``rtprio``.
    """
    granted = False
    if sys.platform == "linux":
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
            granted = True
    try:
        yield granted
    finally:
        if granted:
            os.sched_setscheduler(0, *before)
