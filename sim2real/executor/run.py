"""Run jobs on this machine or on a cluster, skipping those that are done."""

from __future__ import annotations

import math
import os
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from tqdm import tqdm

from sim2real.errors import InputError, shown
from sim2real.executor.cluster import run_on_ray
from sim2real.executor.job import LOG, NOT_STARTED, Job, JobOutcome
from sim2real.executor.local import run_local, slots
from sim2real.output import check_writable


def run_jobs(
    jobs: Sequence[Job],
    *,
    executor: str = "local",
    at_once: int | None = None,
    address: str | None = None,
    cpus: int = 1,
    gpus: float = 0,
    retries: int = 2,
    seconds: float = math.inf,
) -> list[JobOutcome]:
    """Run every job that is not done yet, with a progress bar on a terminal.

    A job whose process is killed or whose node is lost resumes in a new process; one that raises an
    exception has failed. Other jobs continue. A job whose ``done.json`` has the same function and
    options is skipped. An interrupt kills running jobs; the same call resumes them.

    Args:
        jobs: The jobs, with distinct names and folders.
        executor: ``local`` for processes on this machine, ``ray`` for a Ray cluster whose nodes
            share the file system and the Python environment.
        at_once: Number of local jobs at a time; default: as many as fit on the GPUs, or on the
            CPUs if ``gpus`` is 0. Not used with a cluster.
        address: The Ray cluster; None for one that ``ray.init`` finds.
        cpus: CPU cores, and threads, of each job.
        gpus: GPUs of each job: a whole number, or a fraction to share one GPU. With 0 no GPU is
            visible to the job.
        retries: Maximum number of further attempts if a process is killed.
        seconds: Time after which no further job is started; its failure is then ``NOT_STARTED``.

    Returns:
        The outcome of each job, in the order of ``jobs``.

    Raises:
        InputError: If two jobs share a name or a folder, a folder cannot be written, or there is no
            such executor, no Ray, no cluster or not enough GPUs.
    """
    jobs = [replace(job, folder=job.folder.absolute()) for job in jobs]
    _check(jobs)
    remaining = [job for job in jobs if not job.is_done()]
    outcomes = {job.name: JobOutcome(job) for job in jobs}
    if not remaining:
        return list(outcomes.values())
    outcomes |= {job.name: JobOutcome(job, NOT_STARTED) for job in remaining}
    deadline = time.monotonic() + seconds
    in_time = takewhile(lambda _: time.monotonic() < deadline, iter(remaining))
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    variables = {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": str(cpus)}
    if executor == "local":
        places = slots(at_once, cpus=cpus, gpus=gpus)
        running = run_local(in_time, places, variables, retries=retries)
    elif executor == "ray":
        running = run_on_ray(in_time, address, variables, cpus=cpus, gpus=gpus, retries=retries)
    else:
        raise InputError("--executor", "", shown(executor), "local or ray")
    style = {"desc": "jobs", "unit": "job", "miniters": 0, "mininterval": 1.0, "disable": None}
    bar = tqdm(total=len(jobs), initial=len(jobs) - len(remaining), **style)
    with bar, closing(running):
        for outcome in running:
            bar.update(outcome is not None)
            if outcome:
                outcomes[outcome.job.name] = outcome
    return list(outcomes.values())


def map_jobs(
    function: str,
    calls: Mapping[str, Mapping[str, Any]],
    folder: Path,
    **how: Any,  # noqa: ANN401
) -> list[Path]:
    """Call a function with each of many sets of options, as jobs that resume.

    Args:
        function: The function, as ``package.module:function``; called as for ``Job``.
        calls: Options of each call, JSON values, by name.
        folder: The call NAME has the run folder ``folder / NAME``.
        how: Where and how, as for ``run_jobs``.

    Returns:
        The run folders, in the order of ``calls``.

    Raises:
        InputError: As ``run_jobs``.
        RuntimeError: If calls failed, after all others have ended; it names each with its reason.
    """
    jobs = [Job(name, function, dict(options), folder / name) for name, options in calls.items()]
    failed = [str(outcome) for outcome in run_jobs(jobs, **how) if outcome.failure]
    if failed:
        raise RuntimeError("; ".join(failed))
    return [job.folder for job in jobs]


def _check(jobs: Sequence[Job]) -> None:
    """Check that jobs have distinct names and distinct, writable folders."""
    for field in ("name", "folder"):
        for value, times in Counter(getattr(job, field) for job in jobs).most_common(1):
            if times > 1:
                raise InputError("jobs", field, f"{value} {times} times", "one for each job")
    for job in jobs:
        check_writable(job.folder / LOG)
