"""Sets of effects that recordings leave open: what they predict, and what became of them.

Sets of the effects of a joint, and, from swims, of body and camera, as ``diagnosis.json`` has them.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim2real.arrays import Array, Integers
from sim2real.effects import plain
from sim2real.errors import InputError
from sim2real.recording import PER_INERTIA, Load, Recording, read_load
from sim2real.servo.parameters import COLUMNS
from sim2real.structured import Fields, read_json

SCHEMA = "sim2real.diagnosis/1"
SEPARATED = 0.9
"""Probability from which two sets of effects count as distinguished."""
StatedSet = tuple[frozenset[str], Array]
"""Effects that a recording was designed to tell from others, and the servo (P,) with them."""


@dataclass(frozen=True)
class OpenSet:
    """One set of effects that recordings leave open."""

    effects: tuple[str, ...]  # the effects, without those that every servo has a little of; sorted
    probability: float  # probability of the set among all sets that are listed

    def content(self) -> dict[str, Any]:
        """Effects and probability, as files state them."""
        return {"effects": list(self.effects), "probability": self.probability}


@dataclass(frozen=True)
class RivalSet(OpenSet):
    """One set of effects of a servo, fitted to the recordings."""

    gain: float  # log-likelihood above that of the plain servo
    theta: Array  # its parameters, shape (P,), as ``servo.parameters.COLUMNS``
    columns: Integers  # columns of its free parameters, shape (F,)
    # precision of the free parameters, given the recordings and the prior, in the inverse of the
    # product of their units, shape (F, F)
    information: Array

    def content(self) -> dict[str, Any]:
        """Effects, probability and parameters, without the load that a recording states."""
        values = zip(COLUMNS, self.theta.tolist(), strict=True)
        own = {name: x for k, (name, x) in enumerate(values) if x and k not in (3, 4)}
        return super().content() | {"parameters": own}


@dataclass(frozen=True)
class SwimSet(OpenSet):
    """One set of effects of body and camera, that of a material as ``effect.material``."""

    # its F free parameters by name, in ``sim.inference.coordinates``
    coordinates: Mapping[str, float]
    information: Array  # their precision, in the inverse of the product of their units, (F, F)

    def content(self) -> dict[str, Any]:
        """Effects, probability and coordinates, as files state them."""
        return super().content() | {"coordinates": dict(self.coordinates)}


@dataclass(frozen=True, kw_only=True)
class OpenSets:
    """The sets of effects that recordings leave open, most probable first."""

    component: str  # the joint or the body
    period_s: float  # time between samples
    sets: tuple[OpenSet, ...]  # the sets


@dataclass(frozen=True, kw_only=True)
class JointRivals(OpenSets):
    """The sets of effects that recordings of one joint leave open."""

    load: Load  # load of its first recording
    noise_rad: float  # standard deviation of the innovations
    autoregression: Array  # coefficients that whiten the noise, shape (lags,)
    sets: tuple[RivalSet, ...]

    def content(self) -> dict[str, Any]:
        """The entry of ``rival_sets`` in ``diagnosis.json``."""
        return {
            "component": self.component,
            "load": None if self.load is PER_INERTIA else vars(self.load),
            "noise": {
                "innovation_sd_rad": self.noise_rad,
                "period_s": self.period_s,
                "autoregression": self.autoregression.tolist(),
            },
            "sets": [
                one.content()
                | {
                    "gain": one.gain,
                    "free": [COLUMNS[k] for k in one.columns],
                    "information": one.information.tolist(),
                }
                for one in self.sets
            ],
        }


@dataclass(frozen=True, kw_only=True)
class SwimRivals(OpenSets):
    """The sets of effects that swims of one robot leave open."""

    pose_sd: Array  # standard deviation of the noise of x, y (m) and heading (rad), shape (3,)
    pose_lag_s: float  # time constant of a filter of that noise; 0 without a filter
    joint_sd_rad: Array  # standard deviation of the noise of each joint's angle, shape (J,)
    # error of the simulator as a share of a signal's size, by signal (surge, sway, yaw rate,
    # joints) and frequency band (slow, beat, fast), shape (4, 3)
    shares: Array
    # by coordinate, the standard deviation between swims of the size that this error imitates
    imitation: Mapping[str, float]
    relative: float  # standard deviation between swims of an effect's size, relative to the size
    temperature: float  # factor by which evidence is divided in the probabilities of the sets
    sets: tuple[SwimSet, ...]

    def content(self) -> dict[str, Any]:
        """The field ``swim_rivals`` of ``diagnosis.json``."""
        return {
            "component": self.component,
            "period_s": self.period_s,
            "noise": {
                "pose_sd": self.pose_sd.tolist(),
                "pose_lag_s": self.pose_lag_s,
                "joint_sd_rad": self.joint_sd_rad.tolist(),
            },
            "simulator_error": {
                "shares": self.shares.tolist(),
                "imitation": dict(self.imitation),
                "relative": self.relative,
                "temperature": self.temperature,
            },
            "sets": [x.content() | {"information": x.information.tolist()} for x in self.sets],
        }


def stated_sets(recordings: Sequence[Recording], joint: str) -> tuple[StatedSet, ...]:
    """The sets of effects of a joint that recordings were designed to distinguish.

    InputError if what a recording's JSON says under ``rivals`` is of another form.
    """
    return tuple(
        (frozenset(one.sentences("effects")), _theta(one))
        for entry in design_of(recordings, joint)
        for one in entry.tables("sets")
    )


def design_of(recordings: Sequence[Recording], joint: str | None = None) -> list[Fields]:
    """What the JSON of recordings says under ``rivals``, of a joint or of all; or InputError."""
    tops = (Fields(recording.file, "", recording.metadata) for recording in recordings)
    entries = [entry for top in tops if "rivals" in top for entry in top.tables("rivals")]
    return [entry for entry in entries if joint is None or entry.text("component") == joint]


def with_open_sets(
    recordings: Sequence[Recording], path: str | os.PathLike[str]
) -> list[Recording]:
    """The recordings, of which the last states the sets of effects that a diagnosis left open.

    InputError if the file is no diagnosis of a servo, or of a joint that was not recorded, or what
    the last recording states itself is of another form.
    """
    *others, last = recordings
    entries = [entry.content for entry in design_of([last])]
    for rivals in read_rival_sets(read_diagnosis(path)):
        if rivals.component not in last.joints:
            found, expected = rivals.component, f"one of {', '.join(last.joints)}"
            raise InputError(path, "rival_sets.component", found, expected)
        sets = [one.content() for one in rivals.sets]
        entries.append({"component": rivals.component, "sets": sets})
    stated = {"rivals": entries} if entries else {}
    return [*others, replace(last, metadata={**last.metadata, **stated})]


def read_diagnosis(path: str | os.PathLike[str]) -> Fields:
    """The content of a ``diagnosis.json``; InputError if the file is none."""
    return Fields(path, "", read_json(path, SCHEMA))


def read_rival_sets(diagnosis: Fields) -> tuple[JointRivals, ...]:
    """By joint the sets of effects that a diagnosis leaves open; none if it lists none.

    InputError if a field is missing or of another form.
    """
    rivals, listed = list[JointRivals](), diagnosis.content.get("rival_sets") != []
    for entry in diagnosis.tables("rival_sets") if listed else ():
        noise, sets = entry.table("noise"), []
        for one in entry.tables("sets"):
            free = one.sentences("free")
            if unknown := [name for name in free if name not in COLUMNS]:
                raise one.error("free", f"parameters of a servo, not {unknown[0]!r}")
            columns = np.array([COLUMNS.index(name) for name in free], dtype=np.int32)
            information = _numbers(one, "information", len(free), len(free))
            likely = one.sentences("effects"), one.number("probability"), one.number("gain")
            sets.append(RivalSet(*likely, _theta(one), columns, information))
        known = entry.content.get("load") is not None
        joint = JointRivals(
            component=entry.text("component"),
            load=read_load(entry.table("load")) if known else PER_INERTIA,
            period_s=noise.number("period_s", above=0),
            noise_rad=noise.number("innovation_sd_rad", above=0),
            autoregression=_numbers(noise, "autoregression"),
            sets=tuple(sets),
        )
        rivals.append(joint)
    return tuple(rivals)


def _theta(entry: Fields) -> Array:
    """The parameter row of a set, shape (P,)."""
    parameters, theta = entry.table("parameters"), np.zeros(len(COLUMNS))
    for name in parameters.content:
        if name not in COLUMNS:
            raise entry.error("parameters", f"parameters of a servo, not {name!r}")
        theta[COLUMNS.index(name)] = parameters.number(name)
    return theta


def read_swim_rivals(diagnosis: Fields) -> SwimRivals:
    """The sets of effects of a diagnosis of swims; InputError if one is of another form."""

    def by_name(table: Fields) -> dict[str, float]:
        return {name: table.number(name) for name in table.content}

    entry, sets = diagnosis.table("swim_rivals"), []
    noise, error = entry.table("noise"), entry.table("simulator_error")
    for one in entry.tables("sets"):
        coordinates = by_name(one.table("coordinates"))
        information = _numbers(one, "information", len(coordinates), len(coordinates))
        probability = one.number("probability", low=0.0)
        sets.append(SwimSet(one.sentences("effects"), probability, coordinates, information))
    return SwimRivals(
        component=entry.text("component"),
        period_s=entry.number("period_s", above=0.0),
        pose_sd=_numbers(noise, "pose_sd", 3),
        pose_lag_s=noise.number("pose_lag_s", low=0.0),
        joint_sd_rad=_numbers(noise, "joint_sd_rad"),
        shares=_numbers(error, "shares", 4, 3),
        imitation=by_name(error.table("imitation")),
        relative=error.number("relative", low=0.0),
        temperature=error.number("temperature", above=0.0),
        sets=tuple(sets),
    )


def _numbers(entry: Fields, name: str, *shape: int) -> Array:
    """An array of finite numbers, of which products are finite, from a list or lists in a file."""
    try:
        values = np.array(entry.content.get(name), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not (np.abs(values) < 1e75).all():
        raise entry.error(name, "finite numbers, within 1e75")
    if shape and values.shape != shape:
        rows = f"{shape[0]} rows of " if len(shape) > 1 else ""
        raise entry.error(name, f"{rows}{shape[-1]} numbers")
    return values


def in_words(effects: tuple[str, ...], other: tuple[str, ...] = ()) -> str:
    """The effects of a set that another set lacks."""
    return " and ".join(plain(effect) for effect in effects if effect not in other)


def task(first: tuple[str, ...], second: tuple[str, ...]) -> str:
    """How two sets differ, as a clause without a subject."""
    here, there = in_words(first, second), in_words(second, first)
    if here and there:
        return f"separate {here} from {there}"
    return f"show whether there is {here or there}"


@dataclass(frozen=True)
class Separation:
    """Two sets of effects that a recording was to distinguish."""

    component: str  # the joint
    first: tuple[str, ...]  # effects of one set
    second: tuple[str, ...]  # effects of the other
    expected: float  # expected probability that the evidence favours the true one of both
    # probability of the more probable one, given that one of them is there; None if the recordings
    # rule out both
    found: float | None
    favoured: tuple[str, ...]  # effects of that one

    def __str__(self) -> str:
        """What was expected, and what was found, in one sentence."""
        stated = f"{self.component}: expected to {task(self.first, self.second)}"
        stated += f" with {self.expected:.2f}"
        if self.found is None:
            return f"{stated}; both are ruled out."
        if self.found < SEPARATED:
            return f"{stated}; still open, {self.found:.2f}."
        other = self.second if self.favoured == self.first else self.first
        there = in_words(self.favoured, other) or "no " + in_words(other, self.favoured)
        return f"{stated}; found {there}, {self.found:.2f}."


def separations(
    component: str, stated: Iterable[Fields], probability: Mapping[tuple[str, ...], float]
) -> tuple[Separation, ...]:
    """Expectation and outcome of what recordings were designed to distinguish in a component.

    ``stated`` is what their JSON says of it, see ``design_of``; ``probability`` that of the sets of
    effects, given all recordings. InputError if a statement is of another form.
    """
    found = []
    for pair in (p for entry in stated if "pairs" in entry for p in entry.tables("pairs")[:6]):
        first, second = (tuple(pair.sentences(name)) for name in ("first", "second"))
        weights = []
        for own, other in ((first, second), (second, first)):
            # The sets that have what one has more than the other, and no converse.
            needed, excluded = set(own) - set(other), set(other) - set(own)
            has = (e for e in probability if needed.issubset(e) and excluded.isdisjoint(e))
            weights.append(sum(probability[e] for e in has))
        share = max(weights) / sum(weights) if sum(weights) > 1e-3 else None
        favoured = first if weights[0] >= weights[1] else second
        expected = pair.number("expected")
        found.append(Separation(component, first, second, expected, share, favoured))
    return tuple(found)
