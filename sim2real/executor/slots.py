"""Number of jobs that fit on this machine at a time, and the GPUs of each."""

from __future__ import annotations

import math
import os
import shutil
import subprocess

from sim2real.errors import InputError

Slot = str  # CUDA_VISIBLE_DEVICES of a job; empty for no GPU


def slots(at_once: int | None, *, cpus: int, gpus: float) -> list[Slot]:
    """A slot for each job that may run at a time; different GPUs are used first.

    Args:
        at_once: Number of slots; default: as many as fit on the GPUs, or on the CPUs if jobs need
            no GPU.
        cpus: CPU cores that a job needs.
        gpus: GPUs that a job needs: a whole number, or a fraction to share one GPU.

    Raises:
        InputError: If there are too few GPUs.
    """
    if at_once is not None and at_once < 1:
        raise InputError("--jobs", "", str(at_once), "at least 1")
    if gpus == 0:
        return [""] * (at_once or max(1, _cores() // cpus))
    visible = visible_gpus()
    places = _shared(visible, gpus) if gpus < 1 else _grouped(visible, math.ceil(gpus))
    if len(places) < (at_once or 1):
        expected = f"enough for {at_once or 1} at a time, {gpus:g} each"
        raise InputError("--jobs", "", f"{len(visible)} GPUs", expected)
    return places[:at_once]


def visible_gpus() -> list[str]:
    """The GPUs that this process may use, as named in ``CUDA_VISIBLE_DEVICES``."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [name for name in chosen.split(",") if name]
    if shutil.which("nvidia-smi") is None:
        return []
    question = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
    answer = subprocess.run(question, capture_output=True, text=True, check=False)
    return answer.stdout.split() if answer.returncode == 0 else []


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):  # respects the limits of a scheduler
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _shared(gpus: list[str], part: float) -> list[Slot]:
    return gpus * int(1 / part + 1e-9)


def _grouped(gpus: list[str], size: int) -> list[Slot]:
    used = len(gpus) // size * size
    return [",".join(gpus[start : start + size]) for start in range(0, used, size)]
