"""Exceptions for invalid input and missing libraries, checks that raise them, and findings."""

import difflib
import importlib
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Integral, Real
from os import PathLike
from typing import Any, Literal, Self

_LONGEST_SHOWN = 80  # characters of a value in a message
_EXTRAS = {
    "report": {"matplotlib": "Matplotlib", "jinja2": "Jinja", "markupsafe": "Jinja"},
    "ros": {"rosbags": "rosbags"},
    "sim": {"PIL": "Pillow", "av": "PyAV"},
    "rl": {
        "torch": "PyTorch", "stable_baselines3": "Stable-Baselines3", "gymnasium": "Gymnasium",
    },
    "tensorboard": {"tensorboard": "TensorBoard"},
    "render": {"moviepy": "MoviePy", "pygame": "pygame"},
    "hardware": {"serial": "pyserial", "cv2": "OpenCV"},
    "arviz": {"arviz": "ArviZ"},
    "completion": {"shtab": "shtab"},
    "onnx": {"onnx": "package onnx"},
    "mujoco": {"mujoco": "MuJoCo"},
    "casadi": {"casadi": "CasADi"},
    "lerobot": {"pyarrow": "pyarrow"},
    "arm": {"pinocchio": "Pinocchio"},
    "view": {"rerun": "rerun-sdk", "mcap": "mcap"},
    "cluster": {"ray": "Ray"},
}  # fmt: skip
"""Names of optional libraries by extra and module."""
_LIBRARIES = {
    module: (title, extra) for extra, names in _EXTRAS.items() for module, title in names.items()
}


class InputError(Exception):
    """Invalid input, with a message of one line: place, what was found, what was expected.

    The command line prints ``str(error)`` and exits with status 2. ``where`` is the row, field or
    column in the file or recording; empty for all of it.
    """

    def __init__(self, file: str | PathLike[str], where: str, found: str, expected: str) -> None:
        self.file, self.where, self.found, self.expected = str(file), where, found, expected
        place = f"{file}: {where}" if where else f"{file}"
        super().__init__(" ".join(f"{place}: found {found}, expected {expected}".splitlines()))

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, str, str]]:
        """Pickle the four arguments, so that the error can be passed between processes."""
        return type(self), (self.file, self.where, self.found, self.expected)


@dataclass(frozen=True)
class RecordingFinding:
    """A finding about a recording; of an error with the arguments of the exception."""

    text: str  # one sentence
    severity: Literal["note", "warning", "error"] = "note"
    """``"note"`` if it is merely unusual; ``"warning"`` if numbers that are fitted to the recording
    may be wrong, and are shown with it; ``"error"`` if they would be, and nothing is fitted."""
    where: str = ""
    found: str = ""
    expected: str = ""


def check_choice(call: str, argument: str, value: object, choices: Iterable[str]) -> None:
    """Raise InputError unless ``value``, an argument of ``call``, is one of ``choices``."""
    names = list(choices)
    if isinstance(value, str) and value in names:
        return
    raise InputError(call, argument, shown(value), one_of(value, names))


def check_whole(call: str, argument: str, value: object, least: int = 0) -> None:
    """Raise InputError unless ``value``, such as a seed, is whole and at least ``least``."""
    whole = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
    if not whole:
        raise InputError(call, argument, shown(value), f"a whole number of at least {least}")


def check_positive(
    call: str, argument: str, value: object, below: float = math.inf, kind: str = "above 0"
) -> None:
    """Raise InputError unless ``value`` is a number above 0 and ``below`` a limit."""
    number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else 0.0
    if not 0 < number < below:
        raise InputError(call, argument, shown(value), f"a number {kind}")


def names_of(call: str, argument: str, value: str | Sequence[str]) -> list[str]:
    """A list of names without duplicates, from a list or a single name."""
    listed = [value] if isinstance(value, str) else list(value)
    for entry in listed:
        if not isinstance(entry, str):
            raise InputError(call, argument, shown(entry), "a name or a list of names")
    return list(dict.fromkeys(listed))


def one_of(name: object, known: Sequence[str]) -> str:
    """What a message expects instead of ``name``: one of the known names, and the most similar."""
    close = nearest(name, known) if isinstance(name, str) else None
    return f"one of {', '.join(known)}" + (f" (did you mean {close}?)" if close else "")


def nearest(name: str, known: Iterable[str], similarity: float = 0.6) -> str | None:
    """The known name most similar to ``name``, ignoring case; None if none is similar enough."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=similarity)
    return by_lower[close[0]] if close else None


def shown(value: object) -> str:
    """``repr(value)``, shortened for a message of one line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, or too deep nesting
        return f"a huge {type(value).__name__}"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


class MissingLibrary(InputError, ModuleNotFoundError):
    """An optional library is not installed; the message has the command that installs it."""

    def __init__(self, place: str, module: str) -> None:
        title, extra = _LIBRARIES[module]
        super().__init__(place, "", f"no {title}", f"it installed: {install_command(extra)}")
        self.name = module

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.file, self.name)


def install_command(extra: str) -> str:
    """The command that installs an extra of this package: its wheel's, and that of a clone."""
    return f"pip install 'sim2real[{extra}]' (in a clone: pip install -e '.[{extra}]')"


def missing_library(error: ModuleNotFoundError, place: str = "") -> MissingLibrary | None:
    """The failed import of an optional library as an error of one line; None for other imports."""
    if isinstance(error, MissingLibrary):
        return error
    module = (error.name or "").partition(".")[0]
    return MissingLibrary(place or module, module) if module in _LIBRARIES else None


@contextmanager
def optional(place: str) -> Iterator[None]:
    """Context of imports of optional libraries, which the option or command ``place`` needs."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_library(error, place)
        if missing is None:
            raise
        raise missing from None


@contextmanager
def if_installed(what: str) -> Iterator[None]:
    """Context that makes ``what``, as ``"plots"``, or prints which optional library it needs."""
    try:
        with optional(what):
            yield
    except MissingLibrary as missing:
        title, extra = _LIBRARIES[str(missing.name)]
        print(f"no {what}: {title} is not installed; {install_command(extra)}", file=sys.stderr)


def library(module: str, place: str) -> Any:  # noqa: ANN401 - a module
    """Import an optional library, or raise MissingLibrary."""
    with optional(place):
        return importlib.import_module(module)
