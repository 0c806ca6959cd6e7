"""Sets of effects that swims leave open, with what is needed to predict another swim."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.rival_sets import SCHEMA, OpenSet, OpenSets, numbers
from sim2real.structured import Fields, read_json


@dataclass(frozen=True)
class SwimSet(OpenSet):
    """One set of effects of body and camera, that of a material as ``effect.material``."""

    # its F free parameters by name, in ``sim.inference.coordinates``
    coordinates: Mapping[str, float]
    # their precision, in the inverse of the product of their units, shape (F, F)
    information: Array

    def content(self) -> dict[str, Any]:
        """Effects, probability and coordinates, as files state them."""
        return super().content() | {"coordinates": dict(self.coordinates)}


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
    sets: tuple[SwimSet, ...]  # the sets, most probable first

    def content(self) -> dict[str, Any]:
        """The field ``swim_rivals`` of ``diagnosis.json``."""
        of_noise = ("pose_sd", "pose_lag_s", "joint_sd_rad")
        noise = {name: np.asarray(getattr(self, name)).tolist() for name in of_noise}
        error = {"shares": self.shares.tolist(), "imitation": dict(self.imitation)}
        error |= {"relative": self.relative, "temperature": self.temperature}
        sets = [one.content() | {"information": one.information.tolist()} for one in self.sets]
        content = {"component": self.component, "period_s": self.period_s, "noise": noise}
        return content | {"simulator_error": error, "sets": sets}


def swim_rivals_of_file(path: str | os.PathLike[str]) -> tuple[SwimRivals, str] | None:
    """The sets of effects that a ``diagnosis.json`` of swims leaves open, and its model's file.

    The path of the enriched model is relative to the file; None for a diagnosis of a bench.

    Raises:
        InputError: If the file is no diagnosis, or a field is missing or of another form.
    """
    top = Fields(path, "", read_json(path, SCHEMA))
    if top.content.get("swim_rivals") is None:
        return None
    entry = top.table("swim_rivals")
    noise, error = entry.table("noise"), entry.table("simulator_error")
    shares, pose_sd = numbers(error, "shares"), numbers(noise, "pose_sd")
    if shares.shape != (4, 3):
        raise error.error("shares", "4 rows of 3 numbers")
    if pose_sd.shape != (3,):
        raise noise.error("pose_sd", "3 numbers")
    rivals = SwimRivals(
        component=entry.text("component"),
        period_s=entry.number("period_s", above=0.0),
        pose_sd=pose_sd,
        pose_lag_s=noise.number("pose_lag_s", low=0.0),
        joint_sd_rad=numbers(noise, "joint_sd_rad"),
        shares=shares,
        imitation=_by_name(error.table("imitation")),
        relative=error.number("relative", low=0.0),
        temperature=error.number("temperature", above=0.0),
        sets=tuple(_set(one) for one in entry.tables("sets")),
    )
    return rivals, top.text("model")


def _set(entry: Fields) -> SwimSet:
    coordinates, information = _by_name(entry.table("coordinates")), numbers(entry, "information")
    if information.shape != (len(coordinates), len(coordinates)):
        raise entry.error("information", f"{len(coordinates)} rows of as many numbers")
    probability = entry.number("probability", low=0.0)
    return SwimSet(entry.sentences("effects"), probability, coordinates, information)


def _by_name(table: Fields) -> dict[str, float]:
    return {name: table.number(name) for name in table.content}
