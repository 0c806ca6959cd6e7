"""Handling of Ctrl-C, kill and a closed terminal as a flag, so that no packet is cut off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Context manager that gives a function: whether the user has asked to stop.

    In threads other than the main one no signal is handled, and it returns False.
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
