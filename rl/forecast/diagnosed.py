"""Effects of a diagnosis, drawn with the probabilities that it gives them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import with_values
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.diagnose.rival_sets import SCHEMA, JointRivals, RivalSet, read_rival_sets
from sim2real.effects import BODY, CAMERA, CATALOGUE, find
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN, stated
from sim2real.structured import Fields, read_json


@dataclass(frozen=True)
class Possible:
    """An effect outside the rival sets of servos: named, or considered and not named.

    The component is a joint, or a part of the body; ``mean`` and ``sd`` are of its parameters.
    """

    effect: str
    component: str
    probability: float
    mean: Mapping[str, float]
    sd: Mapping[str, float]

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """Its parameters, within their bounds."""
        effect = find([*CATALOGUE, *BODY], self.effect, "diagnosis")
        bounds = {p.name: p for p in effect.parameters}
        return {
            k: float(np.clip(rng.normal(mean, self.sd[k]), bounds[k].low, bounds[k].high))
            for k, mean in self.mean.items()
        }


@dataclass(frozen=True)
class Diagnosed:
    """What a ``diagnosis.json`` leaves open, and errors of the enriched model by signal.

    Sets of effects of servos, with gains and their precision, are rivals; all other effects are
    possible.
    """

    rivals: tuple[JointRivals, ...]
    possible: tuple[Possible, ...]
    fit: Mapping[str, Mapping[str, float | None]]

    def drawn(self, model: Model, rng: np.random.Generator) -> Model:
        """The model with a set of effects for each diagnosed joint, and effects of the body.

        A calibrated law has made up for effects that its model lacks, so they are not added to it.
        """
        joints = dict(model.joints)
        for joint in self.rivals:
            if joint.component in joints:
                joints[joint.component] = _servo(joints[joint.component], joint, rng)
        body = values(model)
        calibrated = "twin" in model.body
        for one in self.possible:
            present = rng.random() < one.probability
            drawn = one.drawn(rng)
            if one.effect in {effect.name for effect in CATALOGUE}:
                # what the supply or the link does, it does to all joints
                for name in [one.component] if one.component in joints else list(joints):
                    others = tuple(e for e in joints[name].effects if e.effect != one.effect)
                    extra = (FittedEffect(one.effect, drawn),) if present else ()
                    joints[name] = replace(joints[name], effects=others + extra)
            else:
                effect = find(BODY, one.effect, "diagnosis")
                place = f"{effect.name}.{one.component}" if effect.by_material else effect.name
                if calibrated and not any(k.startswith(f"{place}.") for k in body):
                    continue
                body = {k: x for k, x in body.items() if not k.startswith(f"{place}.")}
                if present:
                    body |= {f"{place}.{k}": x for k, x in drawn.items()}
        bare = replace(model, joints=joints, body={**model.body, "effects": []})
        return with_values(bare, body)


def _servo(servo: JointModel, joint: JointRivals, rng: np.random.Generator) -> JointModel:
    """A servo with one of its sets of effects; latency and load stay the model's."""
    probability = np.array([one.probability for one in joint.sets])
    one = joint.sets[rng.choice(len(joint.sets), p=probability / probability.sum())]
    row = _row(one, rng)
    effects = []
    for effect in CATALOGUE:
        if effect.name in one.effects:
            first = COLUMNS.index(f"{effect.name}.{effect.parameters[0].name}")
            named = zip(effect.parameters, row[first : first + len(effect.parameters)], strict=True)
            effects.append(FittedEffect(effect.name, {p.name: float(x) for p, x in named}))
    fitted = stated(row, joint.load, effects, servo.law)
    if fitted.per_inertia != servo.per_inertia:
        return servo
    return replace(fitted, latency_s=servo.latency_s, inertia_kgm2=servo.inertia_kgm2)


def _row(one: RivalSet, rng: np.random.Generator) -> Array:
    """A draw of the parameters of a set, with the signs that its fit found, shape (P,)."""
    row = one.theta.copy()
    if one.columns.size:
        scale = np.maximum(np.abs(row[one.columns]), 1e-12)  # units differ by orders of magnitude
        information = one.information * np.outer(scale, scale)
        covariance = np.linalg.pinv(information, hermitian=True)
        step = scale * rng.multivariate_normal(np.zeros(one.columns.size), covariance)
        drawn = row[one.columns] + step
        row[one.columns] = np.where(drawn * row[one.columns] < 0, 0.0, drawn)
    row[:FIRST_EFFECT_COLUMN] = np.maximum(row[:FIRST_EFFECT_COLUMN], 0.0)
    return row


def read_diagnosed(path: str | os.PathLike[str]) -> Diagnosed:
    """Read ``diagnosis.json``.

    An effect that was considered and not named is at most as large as the recordings could have
    hidden: its size is half of its detection limit, give or take as much; in swims, which have no
    such limits, that of the twin's error which imitates it. Effects of the camera are left out.

    Raises:
        InputError: If the file is no diagnosis.
    """
    top = Fields(path, "", read_json(path, SCHEMA))

    def entries(key: str) -> list[Fields]:
        return top.tables(key) if top.content.get(key) else []

    rivals = read_rival_sets(top) if top.content.get("rival_sets") else ()
    left_out = {joint.component for joint in rivals}, {effect.name for effect in CAMERA}
    limits = {}
    for entry in entries("detection_limits"):
        sizes = entry.table("smallest")
        known = {k: sizes.number(k) for k, x in sizes.content.items() if x is not None}
        limits[entry.text("effect"), entry.text("component")] = known
    possible = []
    for key in ("effects", "negligible", "rivals"):
        for entry in entries(key):
            effect, component = entry.text("effect"), entry.text("component")
            if component in left_out[0] or effect in left_out[1]:
                continue
            if key != "rivals":
                fields = entry.table("parameters")
                mean = {k: fields.table(k).number("mean") for k in fields.content}
                sd = {k: fields.table(k).number("sd", low=0) for k in fields.content}
            elif limits:
                sd = mean = {k: x / 2 for k, x in limits.get((effect, component), {}).items()}
            else:
                sizes_of = {name.split(".", 1)[1]: x for name, x in LAW_ERROR.imitated.items()
                            if name.startswith(f"{effect}.")}  # fmt: skip
                mean, sd = dict.fromkeys(sizes_of, 0.0), sizes_of
            if mean:
                probability = entry.number("probability", low=0)
                possible.append(Possible(effect, component, probability, mean, sd))
    fit = top.table("fit").table("enriched").content
    return Diagnosed(rivals, tuple(possible), {k: dict(v) for k, v in fit.items()})
