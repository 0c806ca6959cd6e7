"""Initialize Warp without its messages, which it prints at every start and without a GPU."""

from __future__ import annotations

import os
import sys

import warp

warp.config.log_level = max(warp.config.log_level, warp.LOG_ERROR)


def start_warp() -> None:
    """Initialize Warp, discarding what its native code prints to standard error."""
    sys.stderr.flush()
    stderr_copy, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        warp.init()  # type: ignore[no-untyped-call]
    finally:
        os.dup2(stderr_copy, 2)
        os.close(stderr_copy)
        os.close(null)
