"""Options of a command derived from its verb: names, defaults and help."""

from __future__ import annotations

import argparse
import ast
import inspect
import re
from collections.abc import Callable, Collection
from pathlib import Path
from textwrap import dedent
from typing import Any

Verb = Callable[..., Any]

_COMMON = ("seed",)
"""Arguments that every command has (``sim2real.cli``)."""
_FILES = {"Recorded": "RECORDING", "Robot": "TOML", "Model": "MODEL", "File": "FILE"}
_NUMBERS: dict[str, type] = {"int": int, "float": float}
_METAVARS = {"float": "X", "str": "NAME"}


def add_verb(
    command: argparse.ArgumentParser,
    verb: Verb,
    *,
    positional: Collection[str] = ("recordings",),
    leave_out: Collection[str] = (),
) -> None:
    """Add an option for each argument of a verb.

    The annotation determines the type of an option, the default whether it is required, and the
    entry under ``Args`` of the docstring is its help.

    Args:
        command: The parser to add to.
        verb: A function whose annotations are strings (``from __future__ import annotations``).
        positional: Arguments without an option name.
        leave_out: Arguments that the command sets itself.
    """
    described = described_arguments(verb)
    for name, parameter in inspect.signature(verb).parameters.items():
        if name in _COMMON or name in leave_out:
            continue
        options = _options(str(parameter.annotation), parameter.default)
        options["help"] = _help(described[name], parameter.default)
        if name in positional:
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
    text = inspect.getdoc(verb) or _docstring(verb)
    _, _, block = text.partition("Args:\n")
    block = re.split(r"\n\n?\S", block, maxsplit=1)[0]
    entries = re.split(r"^ {4}(\w+): ", block, flags=re.M)[1:]
    return {
        name: " ".join(entry.split()).replace("``", "")
        for name, entry in zip(entries[::2], entries[1::2], strict=True)
    }


def _docstring(verb: Verb) -> str:
    """The docstring in the source, which ``python -OO`` leaves out of the function."""
    (definition,) = ast.parse(dedent(inspect.getsource(verb))).body
    return ast.get_docstring(definition) or "" if isinstance(definition, ast.FunctionDef) else ""


def _options(annotation: str, default: object) -> dict[str, Any]:
    """Keyword arguments of ``add_argument`` for an annotation."""
    required = {"required": True} if default is inspect.Parameter.empty else {"default": default}
    kind = annotation.removesuffix(" | None").split(" | ")[0]
    if kind == "bool":
        return {"action": "store_true"}
    if kind in _FILES:
        several = {"nargs": "+"} if kind == "Recorded" else {}
        return {"type": Path, "metavar": _FILES[kind], **several, **required}
    if kind == "Sequence[str]":
        return {"nargs": "+", "metavar": "NAME", **required}
    if kind.startswith("Literal["):
        return {"choices": tuple(re.findall(r"['\"](\w+)['\"]", kind)), **required}
    return {"type": _NUMBERS.get(kind, str), "metavar": _METAVARS.get(kind, "N"), **required}


def _help(text: str, default: object) -> str:
    """The entry of the docstring, with the default if it is informative."""
    acronym = text[1:2].isupper()
    lowered = (text[:1] if acronym else text[:1].lower()) + text[1:].removesuffix(".")
    stated = default not in (None, False, (), inspect.Parameter.empty)
    shown = f"{default:g}" if isinstance(default, float) else str(default)
    return (lowered + (f" (default {shown})" if stated else "")).replace("%", "%%")
