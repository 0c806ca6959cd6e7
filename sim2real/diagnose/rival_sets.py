"""Sets of effects that recordings leave open, with what is needed to predict another recording."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import xlogy

from sim2real.arrays import Array, Integers
from sim2real.errors import InputError
from sim2real.recording import PER_INERTIA, Load, Recording, read_load
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.structured import Fields, read_json

SCHEMA = "sim2real.diagnosis/1"

_FROM_LOAD = [BASE.index("inertia_kgm2"), BASE.index("gravity_Nm")]
"""Columns that the load of a recording sets."""


@dataclass(frozen=True)
class OpenSet:
    """One set of effects that recordings leave open.

    Attributes:
        effects: The effects, without those that every servo has a little of; sorted.
        probability: Probability of the set among all sets that are listed.
    """

    effects: tuple[str, ...]
    probability: float

    def content(self) -> dict[str, Any]:
        """Effects and probability, as files state them."""
        return {"effects": list(self.effects), "probability": self.probability}


@dataclass(frozen=True)
class RivalSet(OpenSet):
    """One set of effects of a servo, fitted to the recordings.

    Attributes:
        gain: Log-likelihood above that of the plain servo.
        theta: Its parameters, shape (P,), as ``servo.parameters.COLUMNS``.
        columns: Columns of its free parameters, shape (F,).
        information: Precision of the free parameters, given the recordings and the prior, in the
            inverse of the product of their units, shape (F, F).
    """

    gain: float
    theta: Array
    columns: Integers
    information: Array

    def content(self) -> dict[str, Any]:
        """Effects, probability and parameters, as files state them."""
        parameters = {
            COLUMNS[k]: float(self.theta[k])
            for k in np.flatnonzero(self.theta).tolist()
            if k not in _FROM_LOAD
        }
        return super().content() | {"parameters": parameters}


@dataclass(frozen=True, kw_only=True)
class OpenSets:
    """The sets of effects that recordings leave open.

    Attributes:
        component: The joint or the body.
        period_s: Time between samples.
        sets: The sets, most probable first.
    """

    component: str
    period_s: float
    sets: tuple[OpenSet, ...]

    @property
    def entropy(self) -> float:
        """Entropy of the probabilities, in nats."""
        return entropy(np.array([one.probability for one in self.sets]))


def entropy(probability: Array) -> float:
    """Entropy of probabilities (M,), in nats."""
    return float(-xlogy(probability, probability).sum())


@dataclass(frozen=True, kw_only=True)
class JointRivals(OpenSets):
    """The sets of effects that recordings of one joint leave open.

    Attributes:
        load: Load of its first recording.
        noise_rad: Standard deviation of the innovations.
        autoregression: Coefficients that whiten the noise, shape (lags,).
        sets: The sets, most probable first.
    """

    load: Load
    noise_rad: float
    autoregression: Array
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


@dataclass(frozen=True)
class StatedSet:
    """A set of effects that a designed recording was made to tell from others.

    Attributes:
        effects: The effects.
        theta: Parameters of the servo with them, fitted before, shape (P,).
    """

    effects: frozenset[str]
    theta: Array


def stated_sets(recordings: Sequence[Recording], joint: str) -> tuple[StatedSet, ...]:
    """The sets of effects of a joint that recordings were designed to distinguish.

    Raises:
        InputError: If what a recording's JSON says under ``rivals`` is of another form.
    """
    return tuple(
        StatedSet(frozenset(one.sentences("effects")), _theta(one))
        for entry in design_of(recordings, joint)
        for one in entry.tables("sets")
    )


def design_of(recordings: Sequence[Recording], joint: str) -> list[Fields]:
    """What the JSON of recordings says of a joint under ``rivals``.

    Raises:
        InputError: If it is of another form.
    """
    entries = (entry for recording in recordings for entry in _stated(recording))
    return [entry for entry in entries if entry.text("component") == joint]


def _stated(recording: Recording) -> list[Fields]:
    """The entries under ``rivals`` in the JSON of a recording."""
    top = Fields(recording.file, "", recording.metadata)
    return top.tables("rivals") if "rivals" in top else []


def with_open_sets(
    recordings: Sequence[Recording], path: str | os.PathLike[str]
) -> list[Recording]:
    """The recordings, of which the last states the sets of effects that a diagnosis left open.

    Args:
        recordings: Recordings of one robot, at least one.
        path: The earlier diagnosis (diagnosis.json).

    Raises:
        InputError: If the file is no diagnosis of a servo, or of a joint that was not recorded, or
            what the last recording states itself is of another form.
    """
    *others, last = recordings
    entries = [entry.content for entry in _stated(last)]
    for rivals in rivals_of_file(path):
        if rivals.component not in last.joints:
            found, expected = rivals.component, f"one of {', '.join(last.joints)}"
            raise InputError(path, "rival_sets.component", found, expected)
        sets = [one.content() for one in rivals.sets]
        entries.append({"component": rivals.component, "sets": sets})
    stated = {"rivals": entries} if entries else {}
    return [*others, replace(last, metadata={**last.metadata, **stated})]


def rivals_of_file(path: str | os.PathLike[str]) -> tuple[JointRivals, ...]:
    """The sets of effects that a ``diagnosis.json`` leaves open; none if it lists none.

    Raises:
        InputError: If the file is no diagnosis, or was written without such sets.
    """
    top = Fields(path, "", read_json(path, SCHEMA))
    return read_rival_sets(top) if top.content.get("rival_sets") != [] else ()


def read_rival_sets(top: Fields) -> tuple[JointRivals, ...]:
    """The entries of ``rival_sets`` in ``diagnosis.json``.

    Args:
        top: The content of the file.

    Raises:
        InputError: If a field is missing or of another form.
    """
    return tuple(_joint(entry) for entry in top.tables("rival_sets"))


def _joint(entry: Fields) -> JointRivals:
    noise = entry.table("noise")
    load = PER_INERTIA
    if entry.content.get("load") is not None:
        load = read_load(entry.table("load"))
    return JointRivals(
        component=entry.text("component"),
        load=load,
        period_s=noise.number("period_s", above=0),
        noise_rad=noise.number("innovation_sd_rad", above=0),
        autoregression=numbers(noise, "autoregression"),
        sets=tuple(_set(one) for one in entry.tables("sets")),
    )


def _set(entry: Fields) -> RivalSet:
    free = entry.sentences("free")
    if unknown := [name for name in free if name not in COLUMNS]:
        raise entry.error("free", f"parameters of a servo, not {unknown[0]!r}")
    columns = np.array([COLUMNS.index(name) for name in free], dtype=np.int32)
    information = numbers(entry, "information")
    if information.shape != (columns.size, columns.size):
        raise entry.error("information", f"{columns.size} rows of {columns.size} numbers")
    return RivalSet(
        effects=entry.sentences("effects"),
        probability=entry.number("probability"),
        gain=entry.number("gain"),
        theta=_theta(entry),
        columns=columns,
        information=information,
    )


def _theta(entry: Fields) -> Array:
    """The parameter row of a set, shape (P,)."""
    parameters, theta = entry.table("parameters"), np.zeros(len(COLUMNS))
    for name in parameters.content:
        if name not in COLUMNS:
            raise entry.error("parameters", f"parameters of a servo, not {name!r}")
        theta[COLUMNS.index(name)] = parameters.number(name)
    return theta


def numbers(entry: Fields, name: str) -> Array:
    """An array of finite numbers, of which products are finite, from a list or lists in a file.

    Raises:
        InputError: If it is of another form.
    """
    try:
        values = np.array(entry.content.get(name), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not (np.abs(values) < 1e75).all():
        raise entry.error(name, "finite numbers, within 1e75")
    return values
