"""One randomization range, and the file of them, ``ranges.json``."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from sim2real.display import NotebookDisplay
from sim2real.inference.normal import LEVEL
from sim2real.output import write_json
from sim2real.structured import Fields, read_json

SCHEMA = "sim2real.ranges/1"
_ALL_DIGITS = 17
"""Significant digits with which different numbers are always printed differently."""

Period = Literal["episode", "step"]
_NUMBERS = {"uniform": ("low", "high"), "normal": ("mean", "sd")}
"""Names of both numbers of a distribution in files."""


@dataclass(frozen=True)
class Range:
    """Randomization range of one parameter.

    Names: ``command_latency_s`` (all joints), ``J.latency_offset_s`` (deviation of joint J),
    ``J.kp_Nm_per_rad``, ``J.motor.PARAMETER``, ``J.EFFECT.PARAMETER``, ``J.position_noise_rad``,
    ``body.position_noise_m``, ``body.yaw_noise_rad``, ``body.normalised_density.LINK``,
    ``body.EFFECT.PARAMETER``, ``EFFECT.PARAMETER`` (supply and link).

    Attributes:
        parameter: Name of the parameter.
        distribution: Uniform between ``first`` and ``second``, or normal with mean ``first`` and
            standard deviation ``second``.
        first, second: See ``distribution``; SI units.
        unit: Unit of both; empty for a dimensionless number.
        period: Whether it is drawn once per ``episode`` or at every ``step``.
        source: Description of the recordings and quantiles that it is derived from.
    """

    parameter: str
    distribution: Literal["uniform", "normal"]
    first: float
    second: float
    unit: str
    period: Period
    source: str

    @property
    def constant(self) -> bool:
        """Whether all draws are equal, because the uncertainty is not known."""
        return self.distribution == "uniform" and self.first == self.second

    def numbers(self, digits: int) -> str:
        """Low and high, or mean and standard deviation, without the unit.

        With so many significant digits, or more if both ends would be printed alike.
        """
        if self.constant:
            return f"{self.first:.{digits}g}"
        if self.distribution == "normal":
            return f"{self.first:.{digits}g} ± {self.second:.{digits}g}"
        while f"{self.first:.{digits}g}" == f"{self.second:.{digits}g}" and digits < _ALL_DIGITS:
            digits += 1
        return f"{self.first:.{digits}g} to {self.second:.{digits}g}"

    def content(self) -> dict[str, Any]:
        """The entry in ``ranges.json``."""
        first, second = _NUMBERS[self.distribution]
        own = {k: v for k, v in vars(self).items() if k not in ("first", "second")}
        return {**own, first: self.first, second: self.second}


def uniform(
    parameter: str, low: float, high: float, unit: str, source: str, period: Period = "episode"
) -> Range:
    """A range between two ends."""
    return Range(parameter, "uniform", float(low), float(high), unit, period, source)


def normal(
    parameter: str, mean: float, sd: float, unit: str, source: str, period: Period = "episode"
) -> Range:
    """A range about a mean."""
    return Range(parameter, "normal", float(mean), float(sd), unit, period, source)


@dataclass(frozen=True)
class Ranges(NotebookDisplay):
    """The randomization ranges of a robot."""

    entries: Sequence[Range]
    posterior: str = ""  # file of the joint sample, relative to that of the ranges
    notes: Sequence[str] = ()  # one sentence each
    provenance: Mapping[str, Any] = field(default_factory=dict)
    interval_level: float = LEVEL  # probability of the intervals of the posteriors

    def named(self, parameter: str) -> Range | None:
        """The range of a parameter, or None."""
        return next((entry for entry in self.entries if entry.parameter == parameter), None)


def write_ranges(ranges: Ranges, path: str | os.PathLike[str]) -> None:
    """Write ``ranges.json``."""
    content = {"schema": SCHEMA, **vars(ranges), "posterior": ranges.posterior or None}
    del content["entries"]
    write_json(path, content | {"ranges": [entry.content() for entry in ranges.entries]})


def read_ranges(path: str | os.PathLike[str]) -> Ranges:
    """Read ``ranges.json``."""
    top, entries = Fields(path, "", read_json(path, SCHEMA)), list[Range]()
    for fields in top.tables("ranges"):
        period: Any = fields.choice("period", get_args(Period))
        kind: Any = fields.choice("distribution", tuple(_NUMBERS))
        first, second = _NUMBERS[kind]
        low = fields.number(first)
        high = fields.number(second, low=low if kind == "uniform" else 0)
        name, unit = fields.text("parameter"), fields.text("unit", "")
        entries.append(Range(name, kind, low, high, unit, period, fields.text("source", "")))
    return Ranges(
        entries=tuple(entries),
        posterior=top.text("posterior") if top.content.get("posterior") else "",
        notes=top.sentences("notes"),
        provenance=top.table("provenance").content,
        interval_level=top.number("interval_level", LEVEL, above=0),
    )
