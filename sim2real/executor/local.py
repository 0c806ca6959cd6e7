"""Jobs as processes on this machine, as many at a time as its processors and GPUs allow."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import time
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence

from sim2real.errors import InputError
from sim2real.executor.job import Died, Job, JobOutcome, stop, write_job


def run_local(
    jobs: Iterator[Job], slots: Sequence[str], variables: Mapping[str, str], *, retries: int
) -> Generator[JobOutcome | None]:
    """Run each job in one of the ``slots``; one that dies gets up to ``retries`` more attempts.

    A job is taken from ``jobs`` when a slot is free.

    Yields:
        The outcome of each job as it ends, and None at every poll in between. Closing the
        iterator kills running jobs.
    """
    died, deaths = deque[Job](), Counter[str]()
    running: dict[int, tuple[Job, subprocess.Popen[bytes]]] = {}
    try:
        while True:
            for number, gpus in enumerate(slots):
                if number in running:
                    continue
                if job := died.popleft() if died else next(jobs, None):
                    write_job(job)
                    environment = {**variables, "CUDA_VISIBLE_DEVICES": gpus}
                    running[number] = job, job.start(os.getcwd(), environment)
            if not running:
                return
            yield None
            time.sleep(0.05)
            for number, (job, process) in list(running.items()):
                if process.poll() is None:
                    continue
                stop(process)
                del running[number]
                try:
                    yield JobOutcome(job, job.failure(process.returncode))
                except Died as death:
                    deaths[job.name] += 1
                    if deaths[job.name] > retries:
                        yield JobOutcome(job, f"{death}, {retries + 1} times")
                    else:
                        died.append(job)
    finally:
        for _, process in running.values():
            stop(process)


def slots(at_once: int | None, *, cpus: int, gpus: float) -> list[str]:
    """``CUDA_VISIBLE_DEVICES`` of each job that may run at a time; different GPUs are used first.

    Args:
        at_once: Number of jobs; default: as many as fit on the GPUs, or on the CPUs if jobs need
            no GPU.
        cpus: CPU cores that a job needs.
        gpus: GPUs that a job needs: a whole number, or a fraction to share one GPU.

    Raises:
        InputError: If there are too few GPUs.
    """
    if at_once is not None and at_once < 1:
        raise InputError("--jobs", "", str(at_once), "at least 1")
    if gpus == 0:
        limited = hasattr(os, "sched_getaffinity")  # respects the limits of a scheduler
        cores = len(os.sched_getaffinity(0)) if limited else os.cpu_count() or 1
        return [""] * (at_once or max(1, cores // cpus))
    visible, size = visible_gpus(), max(1, math.ceil(gpus))
    groups = [visible[k : k + size] for k in range(0, len(visible) // size * size, size)]
    places = [",".join(group) for group in groups] * max(1, int(1 / gpus + 1e-9))
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
