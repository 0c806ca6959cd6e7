"""A job, its run folder, and what became of it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim2real.errors import InputError
from sim2real.output import provenance, write_json
from sim2real.structured import Fields, read_json, shown

LOG = "log.txt"
_JOB, _DONE = "job.json", "done.json"


@dataclass(frozen=True)
class Job:
    """One call of a function on a run folder: ``function(folder, **options)``.

    The function may be killed at any moment and is then called again on the same folder. It goes
    on from what the folder holds, having checked that this was made with the same options.

    Args:
        name: What messages call the job.
        function: Where the function is: ``package.module:function``.
        options: What it is called with; text, numbers, booleans, None, lists and objects, as in
            JSON.
        folder: The run folder, of this job alone.

    Raises:
        InputError: If ``function`` is not of that form or ``options`` are not JSON.
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
            same = json.loads(json.dumps(self.options, allow_nan=False)) == self.options
        except (TypeError, ValueError):
            same = False
        if not same:
            expected = "values that JSON keeps as they are"
            raise InputError(self.name, "options", shown(self.options), expected)


@dataclass(frozen=True)
class Outcome:
    """What became of a job; ``failure`` says in one line why it is not done, None if it is."""

    job: Job
    failure: str | None = None

    def __str__(self) -> str:
        if self.failure is None:
            return f"{self.job.name}: done"
        return f"{self.job.name}: {self.failure}; see {self.job.folder / LOG}"


def write_job(job: Job) -> None:
    """Write ``job.json`` into the run folder, which is made if it is not there.

    Raises:
        InputError: If the folder can't be written.
    """
    write_json(job.folder / _JOB, _content(job))


def read_job(folder: Path) -> Job:
    """The job that a run folder is for.

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
    """Whether the run folder holds the complete result of this function with these options."""
    try:
        done = read_json(job.folder / _DONE)
    except InputError:
        return False
    return all(_text(done.get(key)) == _text(_content(job)[key]) for key in ("function", "options"))


def mark_done(job: Job) -> None:
    """Write ``done.json``: the job that the folder now answers, and the versions that did it."""
    versions = provenance((), seed=None)["versions"]
    write_json(job.folder / _DONE, _content(job) | {"versions": versions})


def mark_begun(job: Job) -> None:
    """Take away the ``done.json`` of other options, if there is one."""
    (job.folder / _DONE).unlink(missing_ok=True)


def _text(value: object) -> str:
    """JSON that tells 1 from 1.0 and from true, as ``==`` does not."""
    return json.dumps(value, sort_keys=True)


def _content(job: Job) -> dict[str, Any]:
    return {"name": job.name, "function": job.function, "options": job.options}
