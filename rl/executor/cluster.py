"""Jobs as tasks of a Ray cluster, whose nodes share the file system and the Python environment."""

from __future__ import annotations

import contextlib
import importlib
import os
import socket
from collections.abc import Generator, Mapping, Sequence
from typing import Any

from rl.executor.job import Job, Outcome, write_job
from rl.executor.process import Died, failure, start, stop
from sim2real.errors import InputError

_LOOK_EVERY_S = 1.0
_ANSWER_WITHIN_S = 10.0


def run_on_ray(
    jobs: Sequence[Job],
    address: str | None,
    variables: Mapping[str, str],
    *,
    cpus: int,
    gpus: float,
    retries: int,
) -> Generator[Outcome | None]:
    """Run each job on a node with ``cpus`` and ``gpus`` available.

    A job whose process dies, or whose node is lost, gets up to ``retries`` more attempts.

    Args:
        jobs: The jobs; every node must have their folders at the same path.
        address: The cluster; None for one that ``ray.init`` finds, else a local one.
        variables: Environment variables of the jobs, in addition to those of the node.
        cpus: CPU cores that a job needs.
        gpus: GPUs that a job needs.
        retries: Attempts after the first.

    Yields:
        The outcome of each job as it ends, and None about once a second in between. Closing the
        iterator kills running jobs.

    Raises:
        InputError: If there is no Ray, no such cluster, or no node large enough for a job.
    """
    ray = _library()
    joined = not ray.is_initialized()
    if joined:
        _join(ray, address)
    pending: dict[Any, Job] = {}
    try:
        _check_room(ray, cpus, gpus)
        needs = {"num_cpus": cpus, "num_gpus": gpus}
        task = ray.remote(**needs, max_retries=retries, retry_exceptions=[Died])(_attempt)
        environment = dict(variables) if gpus else {**variables, "CUDA_VISIBLE_DEVICES": ""}
        for job in jobs:
            write_job(job)
            pending[task.remote(job, os.getcwd(), environment)] = job
        while pending:
            ended, _ = ray.wait(list(pending), num_returns=1, timeout=_LOOK_EVERY_S)
            yield None
            for answer in ended:
                job = pending.pop(answer)
                yield Outcome(job, _failure(ray, answer, retries))
    finally:
        for answer in pending:
            with contextlib.suppress(ray.exceptions.RayError):
                ray.cancel(answer, force=True)
        if joined:
            ray.shutdown()


def _attempt(job: Job, directory: str, variables: Mapping[str, str]) -> str | None:
    """One attempt at a job, on a node; the reason if it failed."""
    try:
        process = start(job.folder, directory, variables)
    except OSError as error:
        return f"{error.filename} not accessible from node {os.uname().nodename}: {error.strerror}"
    try:
        return failure(job, process.wait())
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


def _library() -> Any:  # noqa: ANN401 - a module
    try:
        return importlib.import_module("ray")
    except ModuleNotFoundError:
        expected = "it installed: pip install 'sim2real[cluster]'"
        raise InputError("--executor", "ray", "no Ray", expected) from None


def _join(ray: Any, address: str | None) -> None:  # noqa: ANN401 - a module
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    try:
        if port.isdecimal():  # Ray itself waits for minutes
            socket.create_connection((host, int(port)), timeout=_ANSWER_WITHIN_S).close()
        ray.init(
            address=address, include_dashboard=False, log_to_driver=False, logging_level="error"
        )
    except (OSError, OverflowError, ValueError, RuntimeError) as error:
        problem = str(getattr(error, "strerror", None) or error)
        raise InputError(
            "--address", address or "", problem, "a Ray cluster that answers"
        ) from None


def _check_room(ray: Any, cpus: int, gpus: float) -> None:  # noqa: ANN401 - a module
    """Check that a node is large enough for a job, which would otherwise wait forever."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if not any(node.get("CPU", 0) >= cpus and node.get("GPU", 0) >= gpus for node in nodes):
        expected = f"{cpus} CPUs and {gpus:g} GPUs on one of them"
        raise InputError("--executor", "ray", f"{len(nodes)} nodes too small", expected)
