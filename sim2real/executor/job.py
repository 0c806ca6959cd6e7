"""A job, its run folder, its process and its outcome."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim2real.errors import InputError, shown
from sim2real.output import provenance, write_json
from sim2real.structured import Fields, read_json

LOG, _JOB, _DONE = "log.txt", "job.json", "done.json"
NOT_STARTED = "not started"
"""Failure of a job for which the time was over; the same call starts it."""


class Died(Exception):
    """A job's process was killed by a signal; the job can be retried."""


@dataclass(frozen=True)
class Job:
    """One call of a function on a run folder: ``function(folder, **options)``.

    The function may be killed at any moment and is then called again with the same folder. It
    resumes from the content of the folder, after checking that the options are the same.

    Args:
        name: Name of the job in messages.
        function: The function, as ``package.module:function``.
        options: Keyword arguments; JSON values.
        folder: The run folder, not shared with other jobs.

    Raises:
        InputError: If ``function`` is not of that form or ``options`` are not JSON values.
    """

    name: str
    function: str
    options: dict[str, Any]
    folder: Path

    def __post_init__(self) -> None:
        module, _, function = self.function.partition(":")
        if not (function.isidentifier() and all(map(str.isidentifier, module.split(".")))):
            raise InputError(self.name, "function", shown(self.function), "package.module:function")
        try:
            exact = json.loads(json.dumps(self.options, allow_nan=False)) == self.options
        except (TypeError, ValueError):
            exact = False
        if not exact:
            expected = "values that JSON represents exactly"
            raise InputError(self.name, "options", shown(self.options), expected)

    @property
    def content(self) -> dict[str, Any]:
        """Content of ``job.json``."""
        return {"name": self.name, "function": self.function, "options": self.options}

    def is_done(self) -> bool:
        """Whether the run folder has the complete result of this function with these options."""
        try:
            done = read_json(self.folder / _DONE)
        except InputError:
            return False
        pairs = ({x: one.get(x) for x in ("function", "options")} for one in (done, self.content))
        found, wanted = (json.dumps(one, sort_keys=True) for one in pairs)
        return found == wanted  # as text, which distinguishes 1, 1.0 and true

    def begin(self) -> None:
        """Remove the ``done.json`` of other options, if there is one."""
        (self.folder / _DONE).unlink(missing_ok=True)

    def end(self) -> None:
        """Write ``done.json``: the completed job and the versions of the software."""
        versions = provenance((), seed=None)["versions"]
        write_json(self.folder / _DONE, self.content | {"versions": versions})

    def start(
        self, directory: str | os.PathLike[str], variables: Mapping[str, str]
    ) -> subprocess.Popen[bytes]:
        """Start the process of the written job in a directory; it ends with this process.

        The environment ``variables`` are in addition to those of this process.
        """
        with (self.folder / LOG).open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-P", "-m", "sim2real.executor", str(self.folder)],
                stdin=subprocess.PIPE,  # the lifeline: closed when this process ends
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=directory,
                env=os.environ | dict(variables),
                start_new_session=True,
            )

    def failure(self, status: int) -> str | None:
        """Why a process that ended with ``status`` failed; None if done, ``Died`` if killed."""
        if self.is_done():
            return None
        if status < 0:
            raise Died(f"killed by {signal.Signals(-status).name}")
        if status == 0:
            return "ended early, with status 0"
        lines = (self.folder / LOG).read_text(encoding="utf-8", errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "no output")


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job; ``failure`` is the reason in one line, None if the job is done."""

    job: Job
    failure: str | None = None

    def __str__(self) -> str:
        where = f"; see {self.job.folder / LOG}" if self.failure not in (None, NOT_STARTED) else ""
        return f"{self.job.name}: {self.failure or 'done'}{where}"


def write_job(job: Job) -> None:
    """Write ``job.json`` into the run folder, which is created if missing."""
    write_json(job.folder / _JOB, job.content)


def read_job(folder: Path) -> Job:
    """Read the job of a run folder; ``InputError`` if its ``job.json`` is missing or wrong."""
    path = folder / _JOB
    fields = Fields(path, "", read_json(path))
    options = fields.content.get("options")
    if not isinstance(options, dict):
        raise fields.error("options", "an object")
    return Job(fields.text("name"), fields.text("function"), options, folder)


def stop(process: subprocess.Popen[bytes]) -> None:
    """Kill the process, if it still runs, and its child processes."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin:
        process.stdin.close()
