"""This process while servos are driven: signals as a flag, and real-time priority."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Context manager that gives a function: whether the user has asked to stop.

    Ctrl-C, kill and a closed terminal set a flag, so that no packet is cut off. In threads other
    than the main one no signal is handled, and it returns False.
    """
    asked = threading.Event()

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    before = [(number, signal.signal(number, ask)) for number in numbers]
    try:
        yield asked.is_set
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@contextmanager
def priority() -> Iterator[None]:
    """Context manager that gives the calling thread real-time priority, where it is permitted.

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
        yield
    finally:
        if granted:
            os.sched_setscheduler(0, *before)
