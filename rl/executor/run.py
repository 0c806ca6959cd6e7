"""Run jobs on this machine or on a cluster, skipping those that are done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

from tqdm import tqdm

from rl.executor.cluster import run_on_ray
from rl.executor.job import LOG, Job, Outcome, is_done
from rl.executor.local import run_local
from rl.executor.process import child_environment
from rl.executor.seats import seats
from sim2real.errors import InputError, shown
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
) -> list[Outcome]:
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

    Returns:
        The outcome of each job, in the order of ``jobs``.

    Raises:
        InputError: If two jobs share a name or a folder, a folder cannot be written, or there is no
            such executor, no Ray, no cluster or not enough GPUs.
    """
    jobs = [replace(job, folder=job.folder.absolute()) for job in jobs]
    _check(jobs)
    remaining = [job for job in jobs if not is_done(job)]
    outcomes = {job.name: Outcome(job) for job in jobs}
    if not remaining:
        return list(outcomes.values())
    variables = child_environment(cpus)
    if executor == "local":
        places = seats(at_once, cpus=cpus, gpus=gpus)
        running = run_local(remaining, places, variables, retries=retries)
    elif executor == "ray":
        running = run_on_ray(remaining, address, variables, cpus=cpus, gpus=gpus, retries=retries)
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


def _check(jobs: Sequence[Job]) -> None:
    """Check that jobs have distinct names and distinct, writable folders."""
    for field in ("name", "folder"):
        for value, times in Counter(getattr(job, field) for job in jobs).most_common(1):
            if times > 1:
                raise InputError("jobs", field, f"{value} {times} times", "one for each job")
    for job in jobs:
        check_writable(job.folder / LOG)
