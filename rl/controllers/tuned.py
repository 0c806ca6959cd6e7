"""Gains that the tuning found, the controllers' defaults."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sim2real.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Gains = TypeVar("Gains", bound=DataclassInstance)

TUNED = Path(__file__).with_name("tuned.toml")
"""Written by ``benchmarks/tune_controllers.py``, which says how."""
PACES = ("fast", "middle", "frugal")
"""What was asked of the gains: the less time, the more energy."""


def tuned(name: str, kind: type[Gains], pace: str = "middle", path: Path = TUNED) -> Gains:
    """The gains under ``[name.pace]`` in ``path``.

    Raises:
        InputError: If the table or one of its values is missing or no number.
    """
    with path.open("rb") as file:
        table: dict[str, Any] = tomllib.load(file).get(name, {}).get(pace, {})
    values = {}
    for wanted in (one.name for one in fields(kind)):
        value = table.get(wanted)
        if not isinstance(value, int | float):
            raise InputError(path, f"{name}.{pace}.{wanted}", repr(value), "a number")
        values[wanted] = float(value)
    return kind(**values)
