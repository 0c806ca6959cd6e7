"""Jobs as processes on this machine, with a limited number at a time."""

from __future__ import annotations

import os
import subprocess
import time
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence

from sim2real.executor.job import Job, JobOutcome, write_job
from sim2real.executor.process import Died, failure, start, stop
from sim2real.executor.slots import Slot


def run_local(
    jobs: Iterator[Job], slots: Sequence[Slot], variables: Mapping[str, str], *, retries: int
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
                    running[number] = job, start(job.folder, os.getcwd(), environment)
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
                    yield JobOutcome(job, failure(job, process.returncode))
                except Died as death:
                    deaths[job.name] += 1
                    if deaths[job.name] > retries:
                        yield JobOutcome(job, f"{death}, {retries + 1} times")
                    else:
                        died.append(job)
    finally:
        for _, process in running.values():
            stop(process)
