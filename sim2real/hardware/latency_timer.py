"""Check of the time for which a USB adapter holds bytes back, on Linux."""

from __future__ import annotations

import os
from pathlib import Path

LONGEST_MS = 1


def latency_timer_ms(port: str, system: Path = Path("/sys")) -> tuple[Path, int] | None:
    """File and value in ms of the latency timer of a serial adapter; None if it has none.

    Args:
        port: The device, such as ``/dev/ttyUSB0``, or a link to it.
        system: Where sysfs is mounted.
    """
    name = os.path.basename(os.path.realpath(port))
    folders = system / "class/tty" / name / "device", system / "bus/usb-serial/devices" / name
    for folder in folders:
        try:
            return folder / "latency_timer", int((folder / "latency_timer").read_text())
        except (OSError, ValueError):
            continue
    return None


def latency_advice(port: str, system: Path = Path("/sys")) -> str | None:
    """One line if the latency timer is too long; None otherwise."""
    found = None if "://" in port else latency_timer_ms(port, system)
    if found is None or found[1] <= LONGEST_MS:
        return None
    file, value = found
    return (
        f"{port}: latency timer {value} ms, expected at most {LONGEST_MS} ms: "
        f"echo {LONGEST_MS} | sudo tee {file}"
    )
