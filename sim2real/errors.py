"""The exception for invalid input."""

from __future__ import annotations

from os import PathLike


class InputError(Exception):
    """Invalid input, with a message of one line: place, what was found, what was expected.

    The command line prints ``str(error)`` and exits with status 2.

    Args:
        file: File or recording with the error.
        where: Row, field or column inside it; empty for the whole file.
        found: What was found.
        expected: What was expected.
    """

    def __init__(self, file: str | PathLike[str], where: str, found: str, expected: str) -> None:
        self.file, self.where, self.found, self.expected = str(file), where, found, expected
        place = f"{file}: {where}" if where else f"{file}"
        super().__init__(" ".join(f"{place}: found {found}, expected {expected}".splitlines()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle the four arguments, so that the error can be passed between processes."""
        return type(self), (self.file, self.where, self.found, self.expected)
