"""Start, stop and check the process of a job."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from sim2real.executor.job import LOG, Job, is_done


class Died(Exception):
    """A job's process was killed by a signal; the job can be retried."""


def child_environment(cpus: int) -> dict[str, str]:
    """Environment variables of a job: the import path of this process, and ``cpus`` threads."""
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": str(cpus)}


def start(
    folder: Path, directory: str | os.PathLike[str], variables: Mapping[str, str]
) -> subprocess.Popen[bytes]:
    """Start the process of a run folder in a new session; it ends with this process.

    Args:
        folder: The run folder with ``job.json``.
        directory: Working directory of the process.
        variables: Environment variables in addition to those of this process.
    """
    with (folder / LOG).open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "sim2real.executor", str(folder), "--lifeline"],
            stdin=subprocess.PIPE,  # the lifeline: closed when this process ends
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=directory,
            env=os.environ | dict(variables),
            start_new_session=True,
        )


def stop(process: subprocess.Popen[bytes]) -> None:
    """Kill the process, if it still runs, and its child processes."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin:
        process.stdin.close()


def failure(job: Job, status: int) -> str | None:
    """Reason why a process that ended with ``status`` failed; None if its job is done.

    Raises:
        Died: If it was killed by a signal.
    """
    if is_done(job):
        return None
    if status < 0:
        raise Died(f"killed by {signal.Signals(-status).name}")
    return _last_line(job.folder / LOG) if status else "ended early, with status 0"


def _last_line(path: Path) -> str:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), "no output")
