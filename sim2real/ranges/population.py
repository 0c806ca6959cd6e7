"""Ranges of a type of servo: what units of it, and runs of one unit, differ by."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.inference.normal import LEVEL
from sim2real.inference.variance_components import (
    Quantiles,
    VarianceComponents,
    variance_components,
)
from sim2real.model import JointModel, Model
from sim2real.ranges.entry import Range, Ranges, uniform
from sim2real.ranges.sources import parameters_of
from sim2real.servo.parameters import GAINS
from sim2real.units import unit_of

_LATENCY = "latency_s"


@dataclass(frozen=True)
class TypeParameter:
    """One parameter of a type of servo, in SI units."""

    name: str  # in ranges, ``J.kp_Nm_per_rad``
    unit: str
    units: tuple[str, ...]  # the servo that each model is of, N of them
    values: Array  # its value in each model, shape (N,)
    ends: Array  # its interval in each model, shape (N, 2)
    log: bool  # whether its logarithm is normal
    # mean over units, the geometric one if ``log``; standard deviations between units and between
    # runs of a unit, as shares of the mean if ``log``; and the distribution of a run of a new unit
    components: VarianceComponents


def population(
    models: Sequence[tuple[str, Model]], level: float = LEVEL
) -> tuple[Ranges, tuple[TypeParameter, ...]]:
    """Ranges that draw a unit of a type of servo, and the distributions that they are from.

    The logarithm of a parameter (the parameter itself where it may be 0) is normal over units and,
    about its unit, over runs; each model has an error as its interval states it. A range is the
    interval of a run of a new unit given all models, with heavy tails where units are few
    (``inference.variance_components``). Parameters count as independent.

    ``models``: name of the unit, and model, of each run; kp is brought to the firmware gain of the
    first model that states one. ``level``: probability of the intervals and of the ranges.

    Raises:
        InputError: If there are less than two models, they have no joint in common, or only some
            state gains per unit of inertia.
    """
    joints = [name for name in models[0][1].joints if all(name in m.joints for _, m in models)]
    if len(models) < 2 or not joints:
        found = f"{len(models)} of them with {len(joints)} joints in common"
        raise InputError("--population", "", found, "two models of the same joint, or more")
    gain = next((m.firmware_p_gain for _, m in models if m.firmware_p_gain), None)
    parameters: list[TypeParameter] = []
    entries: list[Range] = []
    for joint in joints:
        servos = [model.joints[joint] for _, model in models]
        if len({servo.per_inertia for servo in servos}) > 1:
            found = "gains per unit of inertia in some models, not in others"
            raise InputError("--population", f"joints.{joint}", found, "one of both in all models")
        names = [name for servo in servos for name in (*_values(servo), *servo.interval)]
        for name in dict.fromkeys(names):
            unit = unit_of(name, per_inertia=servos[0].per_inertia)
            rows = list(_rows(name, models, joint, gain))
            known = [row for row in rows if row.determined]
            if len(known) > 1:
                one = _type_parameter(f"{joint}.{name}", unit, known, level)
                units, share = list(dict.fromkeys(one.units)), f"{100 * level:g} % interval"
                source = f"{len(known)} models of {len(units)} units: {share} of a new unit"
                if len(units) == 1:
                    source = f"{len(known)} models of unit {units[0]}: {share} of a new run"
                low, _, high = one.components.new
                parameters.append(one)
                entries.append(uniform(one.name, low, high, unit, source))
            else:
                ends = [x for row in rows for x in (row.value, *row.ends) if np.isfinite(x)]
                source = f"lowest to highest end in {len(rows)} models: less than two determine it"
                entries.append(uniform(f"{joint}.{name}", min(ends), max(ends), unit, source))
    # the latency first, which ranges state for all joints together
    delays = [entry for entry in entries if entry.parameter.endswith(f".{_LATENCY}")]
    low, high = min(e.first for e in delays), max(e.second for e in delays)
    source = delays[0].source + (" of each joint, lowest to highest" if len(delays) > 1 else "")
    entries = [entry for entry in entries if entry not in delays]
    entries.insert(0, uniform("command_latency_s", low, high, "s", source))
    ranges = Ranges(tuple(entries), notes=_notes(models, gain), interval_level=level)
    return ranges, tuple(parameters)


@dataclass(frozen=True)
class _Row:
    """One parameter in one model: its unit, value, interval, standard deviation of its error."""

    unit: str
    value: float
    ends: tuple[float, float]
    halves: float  # standard deviations from the value to an end
    by_prior: bool

    @property
    def determined(self) -> bool:
        """Whether the recordings, and not only a prior, bound it."""
        return bool(np.isfinite(self.ends).all()) and not self.by_prior

    def sd(self, log: bool) -> float:
        """Standard deviation of the error, of the logarithm if ``log``."""
        low, value, high = self.ends[0], self.value, self.ends[1]
        if log:
            low, value, high = np.log([low, value, high])
        return float(max(high - value, value - low) / self.halves)


def _values(servo: JointModel) -> dict[str, float]:
    return {**parameters_of(servo), _LATENCY: servo.latency_s}


def _rows(
    name: str, models: Sequence[tuple[str, Model]], joint: str, gain: float | None
) -> Iterator[_Row]:
    """A parameter of the models that state it, kp at the firmware gain ``gain``."""
    for unit, model in models:
        servo, halves = model.joints[joint], float(ndtri(0.5 + model.interval_level / 2))
        value = _values(servo).get(name, 0.0)  # a loss of 0 has an interval only
        ratio = 1.0
        if name == GAINS[0] and gain and model.firmware_p_gain:
            ratio = gain / model.firmware_p_gain
        low, high = servo.interval.get(name, (value, value))
        ends = (ratio * min(low, value), ratio * max(high, value))
        if name in servo.interval or name in _values(servo):
            yield _Row(unit, ratio * value, ends, halves, name in servo.by_prior)


def _type_parameter(name: str, unit: str, rows: Sequence[_Row], level: float) -> TypeParameter:
    """The distribution of one parameter over units."""
    values, ends = np.array([row.value for row in rows]), np.array([row.ends for row in rows])
    log = bool((ends > 0).all())
    sd = np.array([row.sd(log) for row in rows])
    units = tuple(row.unit for row in rows)
    found = variance_components(np.log(values) if log else values, sd, units, level=level)
    if log:
        found = replace(found, mean=_each(math.exp, found.mean), new=_each(math.exp, found.new))
    elif (ends >= 0).all():
        least = partial(max, 0.0)
        found = replace(found, mean=_each(least, found.mean), new=_each(least, found.new))
    return TypeParameter(name, unit, units, values, ends, log, found)


def _each(function: Callable[[float], float], ends: Quantiles) -> Quantiles:
    low, middle, high = map(function, ends)
    return low, middle, high


def _notes(models: Sequence[tuple[str, Model]], gain: float | None) -> tuple[str, ...]:
    units = list(dict.fromkeys(unit for unit, _ in models))
    notes = []
    if len(units) == 1:
        notes.append(f"all models are of {units[0]}: what other units differ by is not known")
    elif len(units) == len(models):
        notes.append("each unit has one model: the spread between units includes that between runs")
    if len(units) == 2:  # a new one has a distribution with very heavy tails
        notes.append(f"{len(units)} units hardly tell their spread: ranges are wide; add a unit")
    gains = {model.firmware_p_gain for _, model in models}
    if gain is not None and len(gains) > 1:
        unknown = "; models that state none are taken to be at it" if None in gains else ""
        notes.append(f"kp is that of the firmware gain {gain:g} and in proportion to it{unknown}")
    return tuple(notes)


def by_unit(population: Sequence[Any] | Mapping[str, Sequence[Any]]) -> list[tuple[str, Any]]:
    """Every model or its file (a list may have ``UNIT=FILE``), with the name of its unit."""
    if isinstance(population, Mapping):
        return [(unit, model) for unit, models in population.items() for model in models]
    named: list[tuple[str, Any]] = []
    for number, given in enumerate(population):
        unit, equals, file = str(given).partition("=") if isinstance(given, str) else ("", "", "")
        name = Path(given).stem if isinstance(given, str | os.PathLike) else f"unit {number + 1}"
        named.append((unit, file) if equals else (name, given))
    return named
