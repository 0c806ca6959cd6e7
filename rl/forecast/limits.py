"""Limits that a policy is to keep, as ``time_s<=6`` or ``time_s<=6@0.95``."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from rl.forecast.figures import FIGURES
from sim2real.arrays import Array
from sim2real.errors import InputError


@dataclass(frozen=True)
class Limit:
    """A limit of a figure.

    Attributes:
        figure: Name of the figure.
        above: Whether the figure must be at least the value, else at most.
        value: The value, in the figure's unit.
        share: Share of the trials that must keep it; None for the next trial.
    """

    figure: str
    above: bool
    value: float
    share: float | None = None

    def kept(self, values: Array) -> Array:
        """1 where values (N, T) keep the limit, else 0."""
        return np.asarray(values >= self.value if self.above else values <= self.value, np.float64)

    def __str__(self) -> str:
        """As on the command line."""
        suffix = "" if self.share is None else f"@{self.share:g}"
        return f"{self.figure}{'>=' if self.above else '<='}{self.value:g}{suffix}"


def limit_of(text: str) -> Limit:
    """A limit from its text; ``time`` and ``path`` stand for ``time_s`` and ``path_m``.

    Raises:
        InputError: If it is none.
    """
    match = re.fullmatch(r"(\w+)\s*(<=|>=)\s*([-+.\deE]+)(?:@([.\d]+))?", text.strip())
    expected = f"FIGURE<=VALUE or FIGURE>=VALUE@SHARE, with one of {', '.join(FIGURES)}"
    if match is None:
        raise InputError("forecast", "limit", repr(text), expected)
    name = {"time": "time_s", "path": "path_m"}.get(match[1], match[1])
    try:
        value, share = float(match[3]), None if match[4] is None else float(match[4])
    except ValueError:
        raise InputError("forecast", "limit", repr(text), expected) from None
    if name not in FIGURES or not (share is None or 0 < share <= 1):
        raise InputError("forecast", "limit", repr(text), expected)
    return Limit(name, match[2] == ">=", value, share)
