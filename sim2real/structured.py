"""Read JSON and TOML files and their fields, and archives of arrays; errors have one line.

Only regular files are read: a pipe or a device may have no end. Archives are read within a stated
size and without pickled objects.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim2real.errors import InputError, nearest, one_of, shown
from sim2real.units import plausible

if TYPE_CHECKING:
    from numpy.typing import NDArray

LARGEST_FILE_BYTES = 16 * 2**20
LARGEST_STREAM_BYTES = 2**40
"""Largest video or bag, which is not read as a whole."""
_LARGEST_ARCHIVE_BYTES = 2**30
_DEEP_KEY = re.compile(
    r"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){16,}"""
)
"""A dotted key of more than 16 parts: tables so deep take the parser the square of their depth."""
_MISSPELT = 0.8
"""Similarity above which an unknown key counts as a misspelling of a known one."""


def check_size(path: Path, largest: int, advice: str = "") -> None:
    """Raise InputError, without reading, unless ``path`` is a regular file of ``largest`` bytes."""
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
    if found.st_size > largest:
        expected = f"at most {largest // 2**20} MiB{advice}"
        raise InputError(path, "", f"{found.st_size // 2**20} MiB", expected)


def read_text(path: str | os.PathLike[str]) -> str:
    """Read the text of a small file in UTF-8."""
    file = Path(path)
    check_size(file, LARGEST_FILE_BYTES)
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(file, f"byte {error.start}", "bytes that are not UTF-8", "text") from None
    except OSError as error:
        raise InputError(file, "", str(error.strerror), "a readable file") from None


def read_json(path: str | os.PathLike[str], schema: str | None = None) -> dict[str, Any]:
    """Read a JSON object, and check its ``schema`` field if ``schema`` is given."""
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
        raise InputError(path, "", f"no JSON ({reason(error)})", "JSON") from None
    if not isinstance(content, dict):
        raise InputError(path, "", f"a JSON {type(content).__name__}", "a JSON object")
    if schema is not None and content.get("schema") != schema:
        raise InputError(path, "schema", shown(content.get("schema")), repr(schema))
    return content


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML document without dotted keys of more than 16 parts."""
    text = read_text(path)
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        expected = "keys of a few parts"
        raise InputError(path, f"line {line}", f"a key of {shown(deep[0][:40])}...", expected)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        why, _, place = reason(error).partition(" (at ")
        raise InputError(path, place.rstrip(")"), f"no TOML ({why})", "TOML") from None


def check_label(file: str | os.PathLike[str], where: str, label: str) -> str:
    """Raise InputError if a name, as of a joint, has control characters; return it."""
    if not label.isprintable():
        expected = "a name without control characters and line breaks"
        raise InputError(file, where, shown(label), expected)
    return label


def reason(error: Exception) -> str:
    """First line of an error's message, or its type if it has none."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return str(error).strip().partition("\n")[0] or type(error).__name__


def read_members(
    path: str | os.PathLike[str], expected: str, *, what: str, largest: int = _LARGEST_ARCHIVE_BYTES
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of a zip archive's members, in all at most ``largest`` bytes."""
    file = Path(path)
    if file.is_dir() or not file.exists():
        raise InputError(file, "", "no file", expected)
    check_size(file, _LARGEST_ARCHIVE_BYTES)
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > largest:
                most = f"at most {largest / 2**20:.0f} MiB"
                raise InputError(file, "", f"{size / 2**20:.0f} MiB when unpacked", most)
            if len({entry.filename for entry in entries}) < len(entries):
                raise InputError(file, "", "two members of one name", expected)
            for entry in entries:
                with archive.open(entry) as stream:
                    # a limit, as the size stated in an archive may be wrong
                    yield entry.filename, stream.read(entry.file_size)
    except InputError:
        raise
    except Exception as error:  # damaged archives raise exceptions of many kinds
        raise InputError(file, "", f"no {what} ({reason(error)})", expected) from None


def read_arrays(
    path: str | os.PathLike[str],
    expected: str,
    *,
    what: str = "arrays",
    largest: int = _LARGEST_ARCHIVE_BYTES,
) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file by name: real numbers, truth values or text."""
    import numpy as np

    arrays = {}
    for name, content in read_members(path, expected, what=what, largest=largest):
        try:
            array = np.lib.format.read_array(BytesIO(content), allow_pickle=False)
            if array.dtype.kind not in "biufU":
                raise ValueError(f"an array of {array.dtype}")
        except Exception as error:  # as above
            raise InputError(path, name, f"no {what} ({reason(error)})", expected) from None
        arrays[name.removesuffix(".npy")] = array
    return arrays


def finite_number(value: object, *, infinite: bool = False) -> float | None:
    """``value`` as a float; None unless it is a finite number, or ``infinite`` and ``"inf"``."""
    if infinite and value in ("inf", "-inf"):
        return float(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= sys.float_info.max else None


class Fields:
    """The fields of the table ``where`` of a structured ``file``, read by name and type."""

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

    def refuse_unknown(self, known: Iterable[str], *, misspelt: bool = False) -> None:
        """Raise InputError for unknown fields, with ``misspelt`` only for misspelt ones."""
        names = list(known)
        missing = [name for name in names if name not in self.content]
        for name in (name for name in self.content if name not in names):
            expected = one_of(name, names)
            if misspelt:
                close = nearest(name, missing, _MISSPELT)
                expected = f"{close} (did you mean that?)" if close else ""
            if expected:
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
        least = f" of at least {low:g}" if math.isfinite(low) else ""
        expected = "a number" + (f" above {above:g}" if math.isfinite(above) else least)
        value = finite_number(self.content.get(name), infinite=infinite)
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

    def all_numbers(self, **limits: Any) -> dict[str, float]:  # noqa: ANN401 - of ``number``
        """Read all fields of the table as numbers, by name."""
        return {name: self.number(name, **limits) for name in self.content}

    def numbers(
        self, name: str, expected: str, size: int | None = None, *, low: float = -math.inf
    ) -> list[float]:
        """Read a list of finite numbers, ``>= low``; ``expected`` describes it in the error."""
        value = self.content.get(name)
        entries = value if isinstance(value, list) else [None]
        numbers = [x for x in map(finite_number, entries) if x is not None and x >= low]
        if len(numbers) != len(entries) or size not in (None, len(numbers)):
            raise self.error(name, expected)
        return numbers

    def flag(self, name: str) -> bool:
        """Read true or false; false if it is absent."""
        value = self.content.get(name, False)
        if not isinstance(value, bool):
            raise self.error(name, "true or false")
        return value

    def choice(self, name: str, known: Sequence[str], default: str | None = None) -> str:
        """Read one of the ``known`` texts; ``default`` if it is absent."""
        value = self.text(name, default)
        if value not in known:
            raise self.error(name, f"one of {', '.join(known)}")
        return value

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
