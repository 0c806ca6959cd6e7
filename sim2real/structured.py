"""Read JSON and TOML files and their fields, with error messages of one line.

Only regular files are read: a pipe or a device may have no end.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sim2real.errors import InputError, nearest, one_of, shown
from sim2real.units import plausible

LARGEST_FILE_BYTES = 16 * 2**20
LARGEST_STREAM_BYTES = 2**40
"""Largest video or bag, which is not read as a whole."""
_DEEP_KEY = re.compile(
    r"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){16,}"""
)
"""A dotted key of more than 16 parts: tables so deep take the parser the square of their depth."""
_MISSPELT = 0.8
"""Similarity above which an unknown key counts as a misspelling of a known one."""


def check_size(path: Path, largest: int, advice: str = "") -> None:
    """Check, without reading it, that ``path`` is a regular file of at most ``largest`` bytes.

    Raises:
        InputError: If it is missing, a folder, a pipe, a device, inaccessible or too large.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(path, "", "no such file", "a file") from None
    except OSError as error:
        raise InputError(path, "", str(error.strerror), "a readable file") from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(path, "", "a folder", "a file")
    if not stat.S_ISREG(found.st_mode):
        kind = "a pipe" if stat.S_ISFIFO(found.st_mode) else "a device or a socket"
        raise InputError(path, "", kind, "a file")
    size = found.st_size
    if size > largest:
        expected = f"at most {largest // 2**20} MiB{advice}"
        raise InputError(path, "", f"{size // 2**20} MiB", expected)


def read_text(path: str | os.PathLike[str]) -> str:
    """Read the text of a small file.

    Raises:
        InputError: If it is missing, a folder, unreadable, too large or not UTF-8.
    """
    file = Path(path)
    check_size(file, LARGEST_FILE_BYTES)
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(file, f"byte {error.start}", "bytes that are not UTF-8", "text") from None
    except OSError as error:
        raise InputError(file, "", str(error.strerror), "a readable file") from None


def read_json(path: str | os.PathLike[str], schema: str | None = None) -> dict[str, Any]:
    """Read a JSON object, and check its ``schema`` field if ``schema`` is given.

    Raises:
        InputError: If it does not parse, is not an object or has a different schema.
    """
    text = read_text(path)
    try:
        content = json.loads(text)
        if "\\u" in text:
            json.dumps(content, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise InputError(path, "", "half of a surrogate pair (\\ud800)", "characters") from None
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise InputError(path, place, f"no JSON ({error.msg})", "JSON") from None
    except (ValueError, RecursionError) as error:  # too many digits, or too deep nesting
        raise InputError(path, "", f"no JSON ({_reason(error)})", "JSON") from None
    if not isinstance(content, dict):
        raise InputError(path, "", f"a JSON {type(content).__name__}", "a JSON object")
    if schema is not None and content.get("schema") != schema:
        raise InputError(path, "schema", shown(content.get("schema")), repr(schema))
    return content


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML document.

    Raises:
        InputError: If it does not parse, or has dotted keys of more than 16 parts.
    """
    text = read_text(path)
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        expected = "keys of a few parts"
        raise InputError(path, f"line {line}", f"a key of {shown(deep[0][:40])}...", expected)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        reason, _, place = _reason(error).partition(" (at ")
        raise InputError(path, place.rstrip(")"), f"no TOML ({reason})", "TOML") from None


def check_label(file: str | os.PathLike[str], where: str, label: str) -> str:
    """Check that a name, as of a joint, has no control characters or line breaks; return it.

    Raises:
        InputError: If it has.
    """
    if not label.isprintable():
        expected = "a name without control characters and line breaks"
        raise InputError(file, where, shown(label), expected)
    return label


def _reason(error: ValueError | RecursionError) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error)


def finite_number(value: object) -> float | None:
    """``value`` as a float; None unless it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # an integer beyond the range of a float
        return None
    return number if math.isfinite(number) else None


def number_or_infinity(value: object) -> float | None:
    """``value`` as a float, ``"inf"`` and ``"-inf"`` included; None unless it is a number."""
    if value in ("inf", "-inf"):
        return float(str(value))
    return finite_number(value)


class Fields:
    """The fields of one table of a structured file, read by name and type.

    Errors name the file and the field.

    Args:
        file: The file, for messages.
        where: The table inside it, for messages; empty at the top level.
        content: The table.
    """

    def __init__(self, file: str | os.PathLike[str], where: str, content: object) -> None:
        if not isinstance(content, Mapping):
            raise InputError(file, where, shown(content), "a table of named fields")
        self.file, self.where, self.content = file, where, content

    def __contains__(self, name: str) -> bool:
        return name in self.content

    def path(self, name: str) -> str:
        """Path of field ``name`` in the file, for messages."""
        return f"{self.where}.{name}" if self.where else name

    def error(self, name: str, expected: str) -> InputError:
        """The error that field ``name`` is not as ``expected``."""
        found = shown(self.content[name]) if name in self.content else "nothing"
        return InputError(self.file, self.path(name), found, expected)

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Check that the table has no fields other than the known ones.

        Raises:
            InputError: If it has one; the message names the most similar known field.
        """
        names = list(known)
        for name in self.content:
            if name not in names:
                raise InputError(self.file, self.path(name), "an unknown key", one_of(name, names))

    def refuse_misspelt(self, known: Iterable[str]) -> None:
        """Check that no unknown field looks like a misspelling of a missing known field.

        Raises:
            InputError: If one does.
        """
        names = list(known)
        missing = [name for name in names if name not in self.content]
        for name in self.content:
            close = None if name in names else nearest(name, missing, _MISSPELT)
            if close:
                expected = f"{close} (did you mean that?)"
                raise InputError(self.file, self.path(name), "an unknown key", expected)

    def number(
        self,
        name: str,
        default: float | None = None,
        *,
        low: float = -math.inf,
        above: float = -math.inf,
        infinite: bool = False,
    ) -> float:
        """Read a number, ``>= low`` and ``> above``; ``default`` if it is absent.

        The number must be finite and plausible for the unit in its name (``units.plausible``);
        ``infinite`` also permits ``"inf"`` and ``"-inf"``.
        """
        if name not in self.content and default is not None:
            return default
        expected = "a number"
        if math.isfinite(above):
            expected += f" above {above:g}"
        elif math.isfinite(low):
            expected += f" of at least {low:g}"
        convert = number_or_infinity if infinite else finite_number
        value = convert(self.content.get(name))
        if value is None or value < low or value <= above:
            raise self.error(name, expected)
        smallest, largest, unit = plausible(name)
        if largest < abs(value) < math.inf or (above == 0 and value < smallest):
            expected += f", from {smallest:g} to {largest:g} {unit}"
            raise self.error(name, expected)
        return value

    def optional_number(
        self, name: str, *, low: float = -math.inf, above: float = -math.inf
    ) -> float | None:
        """Read a finite number, ``>= low`` and ``> above``; None if it is absent."""
        return self.number(name, low=low, above=above) if name in self.content else None

    def text(self, name: str, default: str | None = None) -> str:
        """Read a string; ``default`` if it is absent."""
        value = self.content.get(name, default)
        if not isinstance(value, str):
            raise self.error(name, "text")
        return value

    def label(self, name: str, default: str | None = None) -> str:
        """Read a name; ``default`` if it is absent."""
        return check_label(self.file, self.path(name), self.text(name, default))

    def labels(self) -> tuple[str, ...]:
        """The keys of the table, which are names."""
        return tuple(check_label(self.file, self.where, name) for name in self.content)

    def sentences(self, name: str) -> tuple[str, ...]:
        """Read a list of sentences; none if it is absent."""
        value = self.content.get(name, [])
        if not isinstance(value, list):
            raise self.error(name, "a list of sentences")
        return tuple(str(sentence) for sentence in value)

    def table(self, name: str) -> Fields:
        """Read the table ``name``; an empty one if it is absent."""
        return Fields(self.file, self.path(name), self.content.get(name, {}))

    def tables(self, name: str) -> list[Fields]:
        """Read the list of tables ``name``, at least one."""
        value = self.content.get(name)
        if not isinstance(value, list) or not value:
            raise self.error(name, f"at least one [[{name}]]")
        return [Fields(self.file, f"{self.path(name)}[{k}]", v) for k, v in enumerate(value)]
