"""Ctrl-C, kill and a closed terminal as a wish that is looked at, not a blow in mid-packet."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Within this block, a function that says whether the user has asked to stop.

    In a thread other than the main one nothing is caught, and it says no.
    """
    asked = threading.Event()

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()

    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    before = [(number, signal.signal(number, ask)) for number in numbers]
    try:
        yield asked.is_set
    finally:
        for number, handler in before:
            signal.signal(number, handler)
