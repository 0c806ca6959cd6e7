"""Jobs as tasks of a Ray cluster, whose nodes share the file system and the Python environment."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Generator, Iterator, Mapping
from itertools import islice
from typing import Any

from sim2real.errors import InputError, library
from sim2real.executor.job import Died, Job, JobOutcome, stop, write_job

_LOOK_EVERY_S = 1.0


def run_on_ray(
    jobs: Iterator[Job],
    address: str | None,
    variables: Mapping[str, str],
    *,
    cpus: int,
    gpus: float,
    retries: int,
) -> Generator[JobOutcome | None]:
    """Run each job on a node with ``cpus`` and ``gpus`` available.

    A job is taken from ``jobs`` when the nodes have room for it; nodes may join and leave. A job
    whose process dies, or whose node is lost, gets up to ``retries`` more attempts. Every node has
    the folders at the same path; ``variables`` are added to its environment. ``InputError`` if
    there is no Ray, no such cluster, or no node large enough for a job.

    Yields:
        The outcome of each job as it ends, and None about once a second in between. Closing the
        iterator kills running jobs.
    """
    ray: Any = library("ray", "--executor")
    joined = not ray.is_initialized()
    if joined:
        _join(ray, address)

    def nodes() -> list[dict[str, float]]:
        return [node["Resources"] for node in ray.nodes() if node["Alive"]]

    def room() -> int:
        """Number of jobs that the nodes hold at a time."""
        total = 0
        for node in nodes():
            by_cpu = int(node.get("CPU", 0) / cpus)
            total += min(by_cpu, int(node.get("GPU", 0) / gpus + 1e-9)) if gpus else by_cpu
        return total

    pending: dict[Any, Job] = {}
    try:
        if not room():
            found = f"{len(nodes())} nodes too small"
            expected = f"{cpus} CPUs and {gpus:g} GPUs on one of them"  # it would wait forever
            raise InputError("--executor", "ray", found, expected)
        needs = {"num_cpus": cpus, "num_gpus": gpus}
        task = ray.remote(**needs, max_retries=retries, retry_exceptions=[Died])(_attempt)
        environment = dict(variables) if gpus else {**variables, "CUDA_VISIBLE_DEVICES": ""}
        while True:
            places = room()
            for job in islice(jobs, max(0, places - len(pending))):
                write_job(job)
                pending[task.remote(job, os.getcwd(), environment)] = job
            if places and not pending:
                return
            if not pending:  # all nodes are lost: another may join
                time.sleep(_LOOK_EVERY_S)
                yield None
                continue
            ended, _ = ray.wait(list(pending), num_returns=1, timeout=_LOOK_EVERY_S)
            yield None
            for answer in ended:
                yield JobOutcome(pending.pop(answer), _failure(ray, answer, retries))
    finally:
        for answer in pending:
            with contextlib.suppress(ray.exceptions.RayError):
                ray.cancel(answer, force=True)
        if joined:
            ray.shutdown()


def _attempt(job: Job, directory: str, variables: Mapping[str, str]) -> str | None:
    """One attempt at a job, on a node; the reason if it failed."""
    try:
        process = job.start(directory, variables)
    except OSError as error:
        return f"{error.filename} not accessible from node {os.uname().nodename}: {error.strerror}"
    try:
        return job.failure(process.wait())
    finally:
        stop(process)


def _failure(ray: Any, answer: Any, retries: int) -> str | None:  # noqa: ANN401 - a module
    try:
        reason: str | None = ray.get(answer)
    except ray.exceptions.RayTaskError as error:
        return f"{error.cause}, {retries + 1} times"
    except ray.exceptions.RayError as error:
        return f"lost by Ray ({type(error).__name__}), {retries + 1} times"
    return reason


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
