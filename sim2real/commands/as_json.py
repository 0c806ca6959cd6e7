"""``--json``: only the result on standard output, for scripts."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sim2real.output import finite_json, place_of

Run = Callable[[argparse.Namespace], int]


def run_as_json(run: Run) -> Run:
    """Wrap a command: its output is printed to standard error, its result to standard output.

    The result is ``options.result`` if set, else the JSON file that the command wrote, else the
    name of the file.
    """

    def quietly(options: argparse.Namespace) -> int:
        with contextlib.redirect_stdout(sys.stderr):
            status = run(options)
        if status == 0 or options.result is not None:  # such as the findings of a refused recording
            print(json.dumps(plain(_result(options)), allow_nan=False))
        return status

    return quietly


def _result(options: argparse.Namespace) -> Any:  # noqa: ANN401 - any JSON
    out: Path | None = getattr(options, "out", None)
    if options.result is not None or out is None:
        return options.result
    place = place_of(out)
    if out.suffix == ".json" and place is not None:
        return json.loads(place.read_text(encoding="utf-8"))
    return {"out": str(place)}


def plain(value: Any) -> Any:  # noqa: ANN401 - any value, any JSON
    """A value as JSON: dataclasses as objects, arrays as lists, numbers finite or null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return finite_json(value)
    return value if value is None or isinstance(value, bool | int | str) else str(value)
