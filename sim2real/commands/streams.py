"""Standard output and error: failures are reported when a command ends; ``--json``."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

from sim2real.output import finite_json, place_of

Run = Callable[[argparse.Namespace], int]


class Lenient:
    """A text stream, or None, whose first failure is kept as ``error``; later text is dropped."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream
        self.error = OSError(0, "closed") if stream is None else None

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        with self._caught() as stream:
            if stream is not None:
                try:
                    stream.write(text)
                except UnicodeEncodeError as error:
                    code = error.encoding
                    stream.write(text.encode(code, "backslashreplace").decode(code))
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        with self._caught() as stream:
            if stream is not None:
                stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - any attribute of the stream
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _caught(self) -> Iterator[TextIO | None]:
        """The stream, or None after a failure, which is kept."""
        try:
            yield None if self.error else self._stream
        except (OSError, ValueError) as error:  # of a closed stream, a ValueError
            self.error = error if isinstance(error, OSError) else OSError(0, str(error))
            with contextlib.suppress(OSError, ValueError, AttributeError):
                # What is still in its buffer must not fail again when the program ends.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())  # type: ignore[union-attr]


def occupy_standard_descriptors() -> None:
    """Open the null device for descriptors 0 to 2 that are closed, so that no result gets them."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def run_as_json(run: Run, options: argparse.Namespace) -> int:
    """Run a command; print its output to standard error, its result (or its file) to output."""
    with contextlib.redirect_stdout(sys.stderr):
        status = run(options)
    result, out = options.result, getattr(options, "out", None)
    if status == 0 and result is None and isinstance(out, Path):
        place = place_of(out)
        result = {"out": str(place)}
        if out.suffix == ".json" and place is not None:
            result = json.loads(place.read_text(encoding="utf-8"))
    if status == 0 or result is not None:  # such as the findings of a refused recording
        print(json.dumps(finite_json(result), allow_nan=False))
    return status
