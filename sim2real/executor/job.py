"""A job, its run folder and its outcome."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim2real.errors import InputError, shown
from sim2real.output import provenance, write_json
from sim2real.structured import Fields, read_json

LOG = "log.txt"
NOT_STARTED = "not started"
"""Failure of a job for which the time was over; the same call starts it."""
_JOB, _DONE = "job.json", "done.json"


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


@dataclass(frozen=True)
class JobOutcome:
    """JobOutcome of a job; ``failure`` is the reason in one line, None if the job is done."""

    job: Job
    failure: str | None = None

    def __str__(self) -> str:
        if self.failure is None:
            return f"{self.job.name}: done"
        if self.failure == NOT_STARTED:
            return f"{self.job.name}: {NOT_STARTED}"
        return f"{self.job.name}: {self.failure}; see {self.job.folder / LOG}"


def write_job(job: Job) -> None:
    """Write ``job.json`` into the run folder, which is created if missing.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_json(job.folder / _JOB, _content(job))


def read_job(folder: Path) -> Job:
    """Read the job of a run folder.

    Raises:
        InputError: If its ``job.json`` is missing or wrong.
    """
    path = folder / _JOB
    fields = Fields(path, "", read_json(path))
    options = fields.content.get("options")
    if not isinstance(options, dict):
        raise fields.error("options", "an object")
    return Job(fields.text("name"), fields.text("function"), options, folder)


def is_done(job: Job) -> bool:
    """Whether the run folder has the complete result of this function with these options."""
    try:
        done = read_json(job.folder / _DONE)
    except InputError:
        return False
    return all(_text(done.get(key)) == _text(_content(job)[key]) for key in ("function", "options"))


def mark_done(job: Job) -> None:
    """Write ``done.json``: the completed job and the versions of the software."""
    versions = provenance((), seed=None)["versions"]
    write_json(job.folder / _DONE, _content(job) | {"versions": versions})


def mark_begun(job: Job) -> None:
    """Remove the ``done.json`` of other options, if there is one."""
    (job.folder / _DONE).unlink(missing_ok=True)


def _text(value: object) -> str:
    """JSON text, which distinguishes 1, 1.0 and true, unlike ``==``."""
    return json.dumps(value, sort_keys=True)


def _content(job: Job) -> dict[str, Any]:
    return {"name": job.name, "function": job.function, "options": job.options}
