"""One command of the command line, and its options, from the signatures of functions."""

import argparse
import ast
import inspect
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from textwrap import dedent
from typing import Any, NamedTuple, TypeVar

from sim2real.errors import InputError

N = TypeVar("N", int, float)
Verb = Callable[..., Any]

_FILES = {"Recorded": "RECORDING", "Robot": "TOML", "Model": "MODEL", "File": "FILE"}
_NUMBERS: dict[str, type] = {"int": int, "float": float}
_PATHS = ("FILE", "FOLDER", "CSV", "TOML", "MODEL", "PNG", "RECORDING", "PICTURE")
_TYPES: dict[str, type] = {"N": int, "X": float, **dict.fromkeys(_PATHS, Path)}
"""Type of an option by the name of its value; text by default."""
_ENTRIES = {
    "columns": "OURS=THEIRS", "effects": "EFFECT", "inertia": "J=KGM2", "joint": "JOINT",
    "joints": "JOINT", "pendulum": "J=KG,M", "units": "UNIT",
}  # fmt: skip
"""An entry of a list of text by the name of the argument; NAME of others."""
_LINE = re.compile(r"(?P<name>\S+?)(?: (?P<value>\S+?)(?P<count>[?+&]|\*\d)?)?(?P<needed>!?)"
                   r"(?: = (?P<default>\S+))?: (?P<help>.*)")  # fmt: skip


VIEWS = """
--rerun FILE: file of all signals to write, for Rerun (FILE.rrd)
--mcap FILE: file of all signals to write, for Foxglove (FILE.mcap)
"""


EXECUTOR = """
--executor local|ray: one process per run, on this machine or on a Ray cluster (default: {})
--jobs N: runs at the same time (default: one per GPU)
--address ADDRESS: address of the Ray cluster, HOST:PORT (default: a local one)
--retries N = 2: times that a failed run is repeated
"""
"""Options of ``where_jobs_run``; format it with what is done by default."""


class Command(NamedTuple):
    """One command, with the options of texts (``add_options``) and of verbs (``add_verb``)."""

    module: str
    """Imported when it runs; its ``run(options)``, or the function after a colon, returns the exit
    status, and may set ``options.result``, which ``--json`` prints if no JSON file is written."""
    options: Sequence[str | Verb]
    example: str  # of a call, without the name
    resumes: bool = False  # whether the same call resumes after an interrupt
    leave_out: Collection[str] = ()  # arguments of verbs that are no options
    types: Mapping[str, Callable[[str], object]] = {}  # of options, other than from their text

    def add(self, parser: argparse.ArgumentParser) -> None:
        """Add its options to a parser."""
        for some in self.options:
            if isinstance(some, str):
                add_options(parser, some)
            else:
                add_verb(parser, some, leave_out=self.leave_out)
        for action in parser._actions:
            action.type = self.types.get(action.dest, action.type)


def add_options(command: argparse.ArgumentParser, text: str) -> None:
    """Add an option for each line of a text, ``--name VALUE = default: help``.

    ``VALUE`` says the type (``FILE``, ``N`` or ``X`` for whole and other numbers, ``a|b`` for
    choices); without one the option is a flag. ``VALUE!`` is required, ``VALUE+`` takes one or
    more, ``VALUE*4`` four, ``VALUE?`` an optional argument, ``VALUE&`` may be given repeatedly. A
    name without dashes is an argument. Indented lines continue the one above.
    """
    for line in re.sub(r"\n +", " ", text.strip()).splitlines():
        found = _LINE.fullmatch(line)
        assert found is not None, line
        name, value, count = found["name"], found["value"], found["count"]
        if value is None:
            command.add_argument(name, action="store_true", help=found["help"])
            continue
        kind, default = _TYPES.get(value, str), found["default"]
        options: dict[str, Any] = {"help": found["help"], "type": kind}
        options |= {"choices": value.split("|")} if "|" in value else {"metavar": value}
        if count == "&":
            options["action"] = "append"
        elif count:
            options["nargs"] = int(count[1:]) if count[0] == "*" else count
        options |= {"required": True} if found["needed"] else {}
        if default is not None:
            options["default"] = [*map(kind, default.split(","))] if count else kind(default)
            options["help"] += f" (default {default.replace(',', ' ') if count else default})"
        command.add_argument(name, **options)


def add_verb(
    command: argparse.ArgumentParser, verb: Verb, *, leave_out: Collection[str] = ()
) -> None:
    """Add an option for each argument of a verb that the parser lacks and that is not left out.

    The annotation, a string, determines the type of an option, the default whether it is required,
    and the entry under ``Args`` of the docstring is its help. What the verb is applied to, if it
    comes first, has no option name.
    """
    described, there = described_arguments(verb), {action.dest for action in command._actions}
    for place, (name, parameter) in enumerate(inspect.signature(verb).parameters.items()):
        if name in there or name in leave_out:
            continue
        options = _options(name, str(parameter.annotation), parameter.default)
        options["help"] = _help(described[name], parameter.default)
        if place == 0 and name in ("recordings", "source", "policies"):
            options.pop("required", None)
            command.add_argument(name, **options)
        else:
            command.add_argument(f"--{name.replace('_', '-')}", **options)


def arguments_of(verb: Verb, options: argparse.Namespace, **other: Any) -> dict[str, Any]:  # noqa: ANN401
    """Arguments of a verb from the parsed options; ``other`` overrides or completes them."""
    parsed = vars(options)
    names = inspect.signature(verb).parameters
    return {name: parsed[name] for name in names if name in parsed} | other


def described_arguments(verb: Verb) -> dict[str, str]:
    """The text of each argument in a docstring in Google's style, on one line."""
    text = inspect.getdoc(verb)
    if text is None:  # python -OO leaves it out of the function, but not of the source
        (definition,) = ast.parse(dedent(inspect.getsource(verb))).body
        text = ast.get_docstring(definition) if isinstance(definition, ast.FunctionDef) else None
    block = re.split(r"\n\n?\S", (text or "").partition("Args:\n")[2], maxsplit=1)[0]
    entries = re.split(r"^ {4}(\w+): ", block, flags=re.M)[1:]
    return {
        name: " ".join(entry.split()).replace("``", "")
        for name, entry in zip(entries[::2], entries[1::2], strict=True)
    }


def _options(name: str, annotation: str, default: object) -> dict[str, Any]:
    """Keyword arguments of ``add_argument`` for an annotation."""
    required = {"required": True} if default is inspect.Parameter.empty else {"default": default}
    kind = annotation.removesuffix(" | None").split(" | ")[0]
    if kind == "bool":
        return {"action": "store_true"}
    if kind in _FILES:
        count = "+" if default is inspect.Parameter.empty else "*"
        several = {"nargs": count} if kind == "Recorded" else {}
        return {"type": Path, "metavar": _FILES[kind], **several, **required}
    if kind == "Sequence[str]":
        return {"nargs": "+", "metavar": _ENTRIES.get(name, "NAME"), **required}
    if kind.startswith("Literal["):
        return {"choices": tuple(re.findall(r"['\"](\w+)['\"]", kind)), **required}
    return {"type": _NUMBERS.get(kind, str), **required}


def _help(text: str, default: object) -> str:
    """The entry of the docstring, with the default if it is informative."""
    acronym = text[1:2].isupper()
    lowered = (text[:1] if acronym else text[:1].lower()) + text[1:].removesuffix(".")
    stated = default not in (None, False, (), inspect.Parameter.empty)
    shown = f"{default:g}" if isinstance(default, float) else str(default)
    return (lowered + (f" (default {shown})" if stated else "")).replace("%", "%%")


def where_jobs_run(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of ``run_jobs`` from ``EXECUTOR``; a job on a device other than cpu has a GPU."""
    return {
        "executor": options.executor,
        "at_once": options.jobs,
        "address": options.address,
        "gpus": 0 if getattr(options, "device", "cpu") == "cpu" else 1,
        "retries": options.retries,
    }


def numbers(
    option: str,
    text: str,
    kind: Callable[[str], N],
    expected: str,
    *,
    count: int | None = None,
    positive: bool = False,
) -> list[N]:
    """Finite numbers of type ``kind``, commas between, ``count`` or any of them, or InputError."""
    try:
        found = [kind(part) for part in text.split(",")]
    except ValueError:
        found = []
    right = len(found) == (count or len(found)) and all(map(math.isfinite, found))
    if not found or not right or (positive and min(found) <= 0):
        raise InputError(option, "", repr(text), expected)
    return found
