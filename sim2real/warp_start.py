"""Start Warp in silence: it would greet every command, and complain where there is no GPU."""

from __future__ import annotations

import os
import sys

import warp

warp.config.log_level = max(warp.config.log_level, warp.LOG_ERROR)


def start_warp() -> None:
    """Initialize Warp; what its native code prints meanwhile, past Python's streams, is dropped."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        warp.init()  # type: ignore[no-untyped-call]
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
