"""How many jobs fit on this machine at a time, and which GPUs each may use."""

from __future__ import annotations

import math
import os
import shutil
import subprocess

from sim2real.errors import InputError

Seat = str  # what the job that sits there finds in CUDA_VISIBLE_DEVICES; empty for no GPU


def seats(at_once: int | None, *, cpus: int, gpus: float) -> list[Seat]:
    """A seat for each job that may run at a time, those of different GPUs first.

    Args:
        at_once: How many; None for as many as this machine has GPUs for, or CPUs if the jobs
            need no GPU.
        cpus: CPU cores that a job needs.
        gpus: GPUs that a job needs: a whole number, or a part of one that jobs share.

    Raises:
        InputError: If there are not so many GPUs.
    """
    if at_once is not None and at_once < 1:
        raise InputError("--jobs", "", str(at_once), "at least 1")
    if gpus == 0:
        return [""] * (at_once or max(1, _cores() // cpus))
    found = visible_gpus()
    room = _shared(found, gpus) if gpus < 1 else _grouped(found, math.ceil(gpus))
    if len(room) < (at_once or 1):
        expected = f"enough for {at_once or 1} at a time, {gpus:g} each"
        raise InputError("--jobs", "", f"{len(found)} GPUs", expected)
    return room[:at_once]


def visible_gpus() -> list[str]:
    """The GPUs that this process may use, as ``CUDA_VISIBLE_DEVICES`` names them."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [name for name in chosen.split(",") if name]
    if shutil.which("nvidia-smi") is None:
        return []
    question = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
    answer = subprocess.run(question, capture_output=True, text=True, check=False)
    return answer.stdout.split() if answer.returncode == 0 else []


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):  # what a scheduler left to this process
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _shared(gpus: list[str], part: float) -> list[Seat]:
    return gpus * int(1 / part + 1e-9)


def _grouped(gpus: list[str], size: int) -> list[Seat]:
    whole = len(gpus) // size * size
    return [",".join(gpus[first : first + size]) for first in range(0, whole, size)]
