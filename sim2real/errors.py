"""The one exception that means: the input is at fault, not the program."""

from __future__ import annotations

from os import PathLike


class InputError(Exception):
    """Input that can't be used, said in one line: where, what was found, what was expected.

    The command line prints ``str(error)`` and leaves with status 2.

    Args:
        file: The file (or recording) at fault.
        where: Row, field or column inside it; empty if the whole file is meant.
        found: What is there.
        expected: What should be there.
    """

    def __init__(self, file: str | PathLike[str], where: str, found: str, expected: str) -> None:
        self.file, self.where, self.found, self.expected = str(file), where, found, expected
        place = f"{file}: {where}" if where else f"{file}"
        super().__init__(" ".join(f"{place}: found {found}, expected {expected}".splitlines()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickle its four parts, so that it crosses from one process to another."""
        return type(self), (self.file, self.where, self.found, self.expected)
