"""Real-time priority while the servos are driven, if the system permits it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def priority() -> Iterator[bool]:
    """Context manager that gives the calling thread real-time priority; returns whether it did.

    The timing of the bus is then kept on a loaded computer; the loop sleeps most of the time, so
    other programs are hardly affected. Linux requires root or a limit on ``rtprio``.
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
