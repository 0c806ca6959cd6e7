"""Jobs as processes on this machine, with a limited number at a time."""

from __future__ import annotations

import os
import subprocess
import time
from collections import Counter, deque
from collections.abc import Generator, Mapping, Sequence

from rl.executor.job import Job, Outcome, write_job
from rl.executor.process import Died, failure, start, stop
from rl.executor.seats import Seat

_LOOK_EVERY_S = 0.05


def run_local(
    jobs: Sequence[Job], seats: Sequence[Seat], variables: Mapping[str, str], *, retries: int
) -> Generator[Outcome | None]:
    """Run each job in one of the ``seats``; one that dies gets up to ``retries`` more attempts.

    Yields:
        The outcome of each job as it ends, and None at every poll in between. Closing the
        iterator kills running jobs.
    """
    waiting, deaths = deque(jobs), Counter[str]()
    running: dict[int, tuple[Job, subprocess.Popen[bytes]]] = {}
    try:
        while waiting or running:
            for number, gpus in enumerate(seats):
                if waiting and number not in running:
                    job = waiting.popleft()
                    write_job(job)
                    environment = {**variables, "CUDA_VISIBLE_DEVICES": gpus}
                    running[number] = job, start(job.folder, os.getcwd(), environment)
            yield None
            time.sleep(_LOOK_EVERY_S)
            for number, (job, process) in list(running.items()):
                if process.poll() is None:
                    continue
                stop(process)
                del running[number]
                try:
                    yield Outcome(job, failure(job, process.returncode))
                except Died as death:
                    deaths[job.name] += 1
                    if deaths[job.name] > retries:
                        yield Outcome(job, f"{death}, {retries + 1} times")
                    else:
                        waiting.appendleft(job)
    finally:
        for _, process in running.values():
            stop(process)
