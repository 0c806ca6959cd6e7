"""Tuned gains, the defaults of the controllers."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from sim2real.structured import Fields, read_toml

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
        InputError: If the file cannot be read, or a value is missing or not a plausible number.
    """
    table = Fields(path, "", read_toml(path)).table(name).table(pace)
    return kind(**{field.name: table.number(field.name) for field in fields(kind)})
