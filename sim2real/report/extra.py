"""Optional libraries of the report, with an error that states how to install them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def report_libraries() -> Iterator[None]:
    """Context manager for imports of Matplotlib or Jinja.

    Raises:
        ModuleNotFoundError: With the name of the library and the command that installs it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = f"the report needs {error.name}: pip install sim2real[report]"
        raise ModuleNotFoundError(missing, name=error.name) from None
