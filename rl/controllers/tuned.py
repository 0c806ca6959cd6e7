"""Tuned gains, the defaults of the controllers."""

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
"""Written by ``benchmarks/tune_controllers.py``."""
PACES = ("fast", "middle", "frugal")
"""Trade-offs of the tuning, from little time and much energy to the opposite."""


def tuned(name: str, kind: type[Gains], pace: str = "middle", path: Path = TUNED) -> Gains:
    """The gains under ``[name.pace]`` in ``path``.

    Raises:
        InputError: If the table is missing, or a value is missing or not a number.
    """
    with path.open("rb") as file:
        table: dict[str, Any] = tomllib.load(file).get(name, {}).get(pace, {})
    values = {}
    for field in (one.name for one in fields(kind)):
        value = table.get(field)
        if not isinstance(value, int | float):
            raise InputError(path, f"{name}.{pace}.{field}", repr(value), "a number")
        values[field] = float(value)
    return kind(**values)
