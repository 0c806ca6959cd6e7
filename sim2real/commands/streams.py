"""Standard output and error that never stop a command: a failure is reported when it ends."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from typing import Any, TextIO


class Lenient:
    """A text stream whose first failure is kept as ``error``; all later text is dropped.

    Characters that the encoding lacks are written as escapes.

    Args:
        stream: The stream; None if it was closed before the program started.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        if self._stream is None and self.error is None:
            self.error = OSError(0, "closed")
        if self._stream is not None and self.error is None:
            with self._caught():
                try:
                    self._stream.write(text)
                except UnicodeEncodeError as error:
                    code = error.encoding
                    self._stream.write(text.encode(code, "backslashreplace").decode(code))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write all ``lines``."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream."""
        if self._stream is not None and self.error is None:
            with self._caught():
                self._stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - any attribute of the stream
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _caught(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:  # of a closed stream, a ValueError
            self.error = error if isinstance(error, OSError) else OSError(0, str(error))
            with contextlib.suppress(OSError, ValueError, AttributeError):
                # What is still in its buffer must not fail again when the program ends.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())  # type: ignore[union-attr]


def occupy_standard_descriptors() -> None:
    """Open the null device for each of the descriptors 0 to 2 that is closed.

    Otherwise a result file could get the number 1, and what a library prints would end in it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
