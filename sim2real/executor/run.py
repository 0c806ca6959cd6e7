"""Run jobs on this machine, or on a Ray cluster, skipping those that are done."""

import contextlib
import math
import os
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from tqdm import tqdm

from sim2real.errors import InputError, library, shown
from sim2real.executor.job import LOG, NOT_STARTED, Died, Job, JobOutcome, stop, write_job
from sim2real.output import check_writable


def run_jobs(
    jobs: Sequence[Job],
    *,
    executor: str = "local",
    at_once: int | None = None,
    address: str | None = None,
    gpus: int = 0,
    retries: int = 2,
    seconds: float = math.inf,
) -> list[JobOutcome]:
    """Run every job that is not done yet, with a progress bar on a terminal.

    A job whose process is killed or whose node is lost resumes in a new process; one that raises an
    exception has failed. Other jobs continue. A job whose ``done.json`` has the same function and
    options is skipped. An interrupt kills running jobs; the same call resumes them.

    Args:
        jobs: The jobs, with distinct names and folders. Each has one CPU core.
        executor: ``local`` for processes on this machine, ``ray`` for a Ray cluster whose nodes
            share the file system and the Python environment.
        at_once: Number of local jobs at a time; default: as many as fit on the GPUs, or on the
            CPUs if ``gpus`` is 0. Not used with a cluster.
        address: The Ray cluster; None for one that ``ray.init`` finds.
        gpus: GPUs of each job. With 0 no GPU is visible to the job.
        retries: Maximum number of further attempts if a process is killed.
        seconds: Time after which no further job is started; its failure is then ``NOT_STARTED``.

    Returns:
        The outcome of each job, in the order of ``jobs``.

    Raises:
        InputError: If two jobs share a name or a folder, a folder cannot be written, or there is no
            such executor, no Ray, no cluster or not enough GPUs.
    """
    jobs = [replace(job, folder=job.folder.absolute()) for job in jobs]
    for field in ("name", "folder"):
        for value, times in Counter(getattr(job, field) for job in jobs).most_common(1):
            if times > 1:
                raise InputError("jobs", field, f"{value} {times} times", "one for each job")
    for job in jobs:
        check_writable(job.folder / LOG)
    remaining = [job for job in jobs if not job.is_done()]
    outcomes = {job.name: JobOutcome(job) for job in jobs}
    if not remaining:
        return list(outcomes.values())
    outcomes |= {job.name: JobOutcome(job, NOT_STARTED) for job in remaining}
    deadline = time.time() + seconds
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    variables = {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    if executor == "local":
        in_time = takewhile(lambda _: time.time() < deadline, remaining)
        running = _run_local(in_time, slots(at_once, gpus), variables, retries)
    elif executor == "ray":
        running = run_on_ray(remaining, address, variables, gpus, retries, deadline)
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

    The function is ``package.module:function`` and called as that of a ``Job``; the options of each
    call, JSON values, are by name. Returns the run folders ``folder / NAME``, in the order of
    ``calls``. ``how`` and ``InputError`` are as of ``run_jobs``; ``RuntimeError`` names the calls
    that failed and the reasons, after all others have ended.
    """
    jobs = [Job(name, function, dict(options), folder / name) for name, options in calls.items()]
    failed = [str(outcome) for outcome in run_jobs(jobs, **how) if outcome.failure]
    if failed:
        raise RuntimeError("; ".join(failed))
    return [job.folder for job in jobs]


def _run_local(
    jobs: Iterator[Job], slots: Sequence[str], variables: Mapping[str, str], retries: int
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


def slots(at_once: int | None, gpus: int) -> list[str]:
    """``CUDA_VISIBLE_DEVICES`` of each job that may run at a time; arguments as of ``run_jobs``."""
    if at_once is not None and at_once < 1:
        raise InputError("--jobs", "", str(at_once), "at least 1")
    if gpus == 0:
        limited = hasattr(os, "sched_getaffinity")  # respects the limits of a scheduler
        return [""] * (
            at_once or (len(os.sched_getaffinity(0)) if limited else os.cpu_count() or 1)
        )
    visible = visible_gpus()
    places = [",".join(visible[k : k + gpus]) for k in range(0, len(visible) // gpus * gpus, gpus)]
    if len(places) < (at_once or 1):
        expected = f"enough for {at_once or 1} at a time, {gpus} each"
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


def run_on_ray(
    jobs: Sequence[Job],
    address: str | None,
    variables: Mapping[str, str],
    gpus: int,
    retries: int,
    deadline: float,
) -> Generator[JobOutcome | None]:
    """Run each job on a node with a CPU and ``gpus`` available; nodes may join and leave.

    A job whose process dies, or whose node is lost, gets up to ``retries`` more attempts, but none
    starts after ``deadline`` (``time.time``). Every node has the folders at the same path;
    ``variables`` are added to its environment. ``InputError`` if there is no Ray, no such cluster,
    or no node large enough for a job.

    Yields:
        The outcome of each job as it ends, and None about once a second in between. Closing the
        iterator kills running jobs.
    """
    ray: Any = library("ray", "--executor")
    joined = not ray.is_initialized()
    if joined:
        _join(ray, address)
    environment = dict(variables) if gpus else {**variables, "CUDA_VISIBLE_DEVICES": ""}
    pending: dict[Any, Job] = {}
    try:
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        if not any(node.get("CPU", 0) >= 1 and node.get("GPU", 0) >= gpus for node in nodes):
            expected = f"1 CPUs and {gpus} GPUs on one of them"  # it would wait forever
            raise InputError("--executor", "ray", f"{len(nodes)} nodes too small", expected)
        limits = {"max_retries": retries, "retry_exceptions": [Died]}
        task = ray.remote(num_cpus=1, num_gpus=gpus, **limits)(_attempt)
        for job in jobs:
            write_job(job)
            pending[task.remote(job, os.getcwd(), environment, deadline)] = job
        while pending:
            ended, _ = ray.wait(list(pending), num_returns=1, timeout=1.0)
            yield None
            for answer in ended:
                job, attempts = pending.pop(answer), f"{retries + 1} times"
                try:
                    yield JobOutcome(job, ray.get(answer))
                except ray.exceptions.RayTaskError as error:
                    yield JobOutcome(job, f"{error.cause}, {attempts}")
                except ray.exceptions.RayError as error:
                    lost = f"lost by Ray ({type(error).__name__})"
                    yield JobOutcome(job, f"{lost}, {attempts}")
    finally:
        for answer in pending:
            with contextlib.suppress(ray.exceptions.RayError):
                ray.cancel(answer, force=True)
        if joined:
            ray.shutdown()


def _attempt(job: Job, directory: str, variables: Mapping[str, str], deadline: float) -> str | None:
    """One attempt at a job, on a node; the reason if it failed."""
    if time.time() > deadline:
        return NOT_STARTED
    try:
        process = job.start(directory, variables)
    except OSError as error:
        return f"{error.filename} not accessible from node {os.uname().nodename}: {error.strerror}"
    try:
        return job.failure(process.wait())
    finally:
        stop(process)


def _join(ray: Any, address: str | None) -> None:  # noqa: ANN401 - a module
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    try:
        if port.isdecimal():  # Ray itself waits for minutes
            socket.create_connection((host, int(port)), timeout=10.0).close()
        quiet = {"include_dashboard": False, "log_to_driver": False, "logging_level": "error"}
        ray.init(address=address, **quiet)
    except (OSError, OverflowError, ValueError, RuntimeError) as error:
        problem, expected = getattr(error, "strerror", None) or error, "a Ray cluster that answers"
        raise InputError("--address", address or "", str(problem), expected) from None
