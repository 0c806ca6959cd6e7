"""The report's libraries are optional; when one is missing, say how to get it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def report_libraries() -> Iterator[None]:
    """Import Matplotlib or Jinja inside this block.

    Raises:
        ModuleNotFoundError: With one line that names the library and the command that brings it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = f"the report needs {error.name}: pip install sim2real[report]"
        raise ModuleNotFoundError(missing, name=error.name) from None
