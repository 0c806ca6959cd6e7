"""Realities that agree with everything known of a robot: one draw of all that is uncertain each.

Parameters, discrepancy and noise are kept apart (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001)
425).
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.make import draw_models, noise_of, numbers_of, parameters_of
from rl.world import Noise
from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import by_twin, simulated, swim_of, with_values
from sim.twin.law import is_calibrated
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.diagnose.rival_sets import JointRivals, read_diagnosis, read_rival_sets
from sim2real.effects import BODY, CAMERA, CATALOGUE, find
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.posterior.posteriors import JointSample, read_sample
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN, stated
from sim2real.structured import Fields, read_json


@dataclass(frozen=True)
class Possible:
    """An effect of a joint or of the body, named or not, outside the rival sets of servos."""

    effect: str
    component: str
    probability: float
    mean: Mapping[str, float]
    sd: Mapping[str, float]

    @property
    def of_servo(self) -> bool:
        """Whether it is an effect of a servo, not of the body."""
        return self.effect in {effect.name for effect in CATALOGUE}

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """Its parameters, within their bounds."""
        known: Sequence[Any] = CATALOGUE if self.of_servo else BODY
        bounds = {p.name: p for p in find(known, self.effect, "diagnosis").parameters}
        out = {}
        for k, mean in self.mean.items():
            limit = bounds[k.rpartition(".")[2]]  # swims state a size for each joint, j1.torque_Nm
            out[k] = float(np.clip(rng.normal(mean, self.sd[k]), limit.low, limit.high))
        return out


@dataclass(frozen=True)
class Diagnosed:
    """What a ``diagnosis.json`` leaves open, and errors of the enriched model by signal."""

    rivals: tuple[JointRivals, ...]
    possible: tuple[Possible, ...]
    fit: Mapping[str, Mapping[str, float | None]]

    def drawn(self, model: Model, rng: np.random.Generator) -> Model:
        """The model with drawn effects, without those that its calibrated law has made up for."""
        joints = dict(model.joints)
        for joint in self.rivals:
            if joint.component in joints:
                joints[joint.component] = _servo(joints[joint.component], joint, rng)
        body = values(model)
        calibrated = is_calibrated(model.body)
        for one in self.possible:
            present = rng.random() < one.probability
            drawn = one.drawn(rng)
            if one.of_servo:
                # what the supply or the link does, it does to all joints
                for name in [one.component] if one.component in joints else list(joints):
                    others = tuple(e for e in joints[name].effects if e.effect != one.effect)
                    parts = ((k.rpartition("."), x) for k, x in drawn.items())
                    own = {k: x for (joint, _, k), x in parts if joint in ("", name)}
                    extra = (FittedEffect(one.effect, own),) if present and own else ()
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
    chosen = joint.sets[rng.choice(len(joint.sets), p=probability / probability.sum())]
    row = chosen.theta.copy()  # drawn with the signs that its fit found
    if chosen.columns.size:
        scale = np.maximum(
            np.abs(row[chosen.columns]), 1e-12
        )  # units differ by orders of magnitude
        information = chosen.information * np.outer(scale, scale)
        covariance = np.linalg.pinv(information, hermitian=True)
        step = scale * rng.multivariate_normal(np.zeros(chosen.columns.size), covariance)
        drawn = row[chosen.columns] + step
        row[chosen.columns] = np.where(drawn * row[chosen.columns] < 0, 0.0, drawn)
    row[:FIRST_EFFECT_COLUMN] = np.maximum(row[:FIRST_EFFECT_COLUMN], 0.0)
    value = dict(zip(COLUMNS, row.tolist(), strict=True))
    effects = [
        FittedEffect(one.name, {p.name: value[f"{one.name}.{p.name}"] for p in one.parameters})
        for one in (effect for effect in CATALOGUE if effect.name in chosen.effects)
    ]
    fitted = stated(row, joint.load, effects, servo.law)
    if fitted.per_inertia != servo.per_inertia:
        return servo
    return replace(fitted, latency_s=servo.latency_s, inertia_kgm2=servo.inertia_kgm2)


def read_diagnosed(path: str | os.PathLike[str]) -> Diagnosed:
    """Read ``diagnosis.json``; effects of the camera are left out.

    An effect that was not named is at most as large as the recordings could have hidden: its size
    is half of its detection limit, give or take as much; in swims, which have no such limits, that
    of the twin's error which imitates it.
    """
    top = read_diagnosis(path)

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


_BODY = ("surge", "sway", "yaw_rate")
DEVIATIONS = tuple(f"law error.{name}" for name in (*_BODY, "energy"))
"""Parameters of a draw that are relative errors of the simulated velocities and energy."""
TWIN_ERROR = Path(__file__).with_name("twin_error.json")
"""Error of energy in forecasts by the twin, learned from trials in several waters by
``benchmarks/forecast_energy.py``: the logarithm of real energy over that forecast."""
_NORMAL_90 = 1.645
"""Half of the 90 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Realities:
    """N draws of what the real robot may be: models, and the noise of camera and joints."""

    models: tuple[Model, ...]  # their models
    noise: Noise  # noise of camera and joints
    names: tuple[str, ...]  # names of the P parameters in which the draws differ
    values: Array  # their values, shape (N, P)
    law: Array  # relative errors of surge, sway, yaw rate and energy, constant in a reality, (N, 4)
    # standard deviation of what the fit leaves unexplained in surge and sway in m/s, yaw rate in
    # rad/s and joint angles in rad, shape (3 + J,)
    unexplained: Array

    def digest(self, residuals: Sequence[Array] = ()) -> str:
        """SHA-256 of the draws, and of residuals that disturb their trials."""
        found = hashlib.sha256(repr((self.names, self.noise)).encode())
        for array in (self.values, self.law, self.unexplained, *residuals):
            found.update(np.ascontiguousarray(array).tobytes())
        return found.hexdigest()


def draw_realities(
    robot: Robot,
    model: Model,
    ranges: Ranges,
    sample: JointSample,
    n: int,
    rng: np.random.Generator,
    *,
    diagnosed: Diagnosed | None = None,
) -> Realities:
    """Draw n realities, with the noise of the ranges.

    Velocities and energy of a calibrated body have the relative error of the twin; a body that was
    not calibrated has laws as different as those of the robots in ``LAW_ERROR``.
    """
    models = draw_models(model, ranges, robot, n, rng, sample)
    if diagnosed is not None:
        models = [diagnosed.drawn(one, rng) for one in models]
    models = _with_bodies(models, model, rng)
    law = np.zeros((n, 4))
    if is_calibrated(model.body):
        # the mean speed and turn are slow; sway is zero on average, what matters of it is its beat
        law[:, :3] = rng.standard_normal((n, 3)) * LAW_ERROR.shares[(0, 1, 2), (0, 1, 0)]
        energy = read_json(TWIN_ERROR)["energy"]
        law[:, 3] = np.expm1(rng.normal(energy["mean"], energy["sd"], n))
    names, table = parameters_of(models)
    varied = table.std(axis=0) > 1e-9 * np.abs(table).mean(axis=0)
    names = [name for name, one in zip(names, varied, strict=True) if one]
    table = table[:, varied]
    if law.any():
        names, table = [*names, *DEVIATIONS], np.concatenate([table, law], axis=1)
    fit = dict(model.fit)
    if diagnosed is not None:  # errors of a bench do not replace those of swims
        swims = any(signal.startswith("body.") for signal in diagnosed.fit)
        fit = {**fit, **diagnosed.fit} if swims else {**diagnosed.fit, **fit}
    joints = [joint.name for joint in robot.joints]
    noise, rest = noise_of(ranges, joints), unexplained(fit, joints)
    return Realities(tuple(models), noise, tuple(names), table, law, rest)


def _with_bodies(models: Sequence[Model], model: Model, rng: np.random.Generator) -> list[Model]:
    """Models with bodies drawn from their calibration, or from laws of other robots."""
    posterior, late = model.body.get("posterior"), np.zeros(())
    if posterior is not None:  # latencies were fitted with the body; their spread by day is added
        heads = [name.split(".")[0] for name in posterior["names"]]
        own = [k for k, head in enumerate(heads) if head in {"twin", *model.joints}]
        names = [posterior["names"][k] for k in own]
        late = np.zeros((len(models), len(names)))
        for k, name in enumerate(names):
            if name.endswith(".latency_s"):
                late[:, k] = [one.joints[name.split(".")[0]].latency_s for one in models]
        late -= late.mean(axis=0)
        mean = np.array(posterior["mean"])[own]
        fits = [model.fit.get(f"body.{name}", {}) for name in _BODY]
        pairs = [(one.get("heldout"), one.get("train")) for one in fits]
        overfit = [(held / max(train, 1e-9)) ** 2 for held, train in pairs if held and train]
        covariance = np.array(posterior["covariance"])[np.ix_(own, own)]
        covariance = covariance * max(1.0, float(np.mean(overfit or [1.0])))
        drawn = rng.multivariate_normal(mean, covariance, size=len(models))
    else:
        if is_calibrated(model.body):
            intervals = model.body.get("interval", {})
            ends = {k: v for k, v in intervals.items() if k.startswith("twin.")}
            spread = {k: (np.mean(v), np.ptp(v) / (2 * _NORMAL_90)) for k, v in ends.items()}
        else:
            fitted = {f"twin.{k}": v for k, v in model.body.get("twin", {}).items()}
            usual, unknown = LAW_ERROR.usual.items(), LAW_ERROR.unknown
            spread = {k: (fitted.get(k, v), unknown[k]) for k, v in usual if k in unknown}
        names = list(spread)
        mean, sd = np.array(list(spread.values()), dtype=np.float64).reshape(-1, 2).T
        drawn = mean + sd * rng.standard_normal((len(models), len(names)))
    drawn = np.maximum(drawn + late, 0.0)  # no coefficient of the law and no latency is negative
    rows = (dict(zip(names, map(float, row), strict=True)) for row in drawn)
    return [with_values(one, row) if row else one for one, row in zip(models, rows, strict=True)]


def unexplained(fit: Mapping[str, Mapping[str, float | None]], joints: Sequence[str]) -> Array:
    """What a fit leaves unexplained beyond noise, by held-out errors if any, shape (3 + J,)."""
    out = []
    for signal in (*(f"body.{name}" for name in _BODY), *(f"{j}.position_rad" for j in joints)):
        errors = fit.get(signal, {})
        error, noise = errors.get("heldout") or errors.get("train"), errors.get("noise")
        out.append(np.sqrt(max((error or 0.0) ** 2 - (noise or 0.0) ** 2, 0.0)))
    return np.array(out)


def read_realities(
    robot: Robot, model: Model, ranges_file: Path, n: int, seed: int,
    diagnosed: Diagnosed | None = None,
) -> Realities:  # fmt: skip
    """Draw n realities with the ranges in a file, which has a posterior sample of the model.

    Values of the model are at most one width and 5 % of themselves outside the ranges.
    """
    ranges = read_ranges(ranges_file)
    if not ranges.posterior:
        expected = "ranges of bench recordings, which sample the posterior"
        raise InputError(ranges_file, "posterior", "none", expected)
    known = numbers_of(model)
    for entry in ranges.entries:
        joint, _, tail = entry.parameter.partition(".")
        if tail == "latency_offset_s" and joint not in model.joints:
            joints = ", ".join(model.joints)
            raise InputError(ranges_file, entry.parameter, "a joint not of the model", joints)
        low, high = entry.first, entry.second
        if entry.distribution == "normal":
            low, high = (entry.first + side * _NORMAL_90 * entry.second for side in (-1, 1))
        value = known.get(entry.parameter, low)
        slack = (high - low) + 0.05 * abs(value)
        if not low - slack <= value <= high + slack:
            found = f"{low:.4g} to {high:.4g}"
            raise InputError(ranges_file, entry.parameter, found, f"the model's {value:.4g} within")
    sample = read_sample(ranges_file.with_name(ranges.posterior))
    rng = np.random.default_rng(seed)
    return draw_realities(robot, model, ranges, sample, n, rng, diagnosed=diagnosed)


def residuals_of(recordings: Sequence[Recording], model: Model, robot: Robot) -> list[Array]:
    """Measured less simulated velocities and angles of each swim, (T, 3 + J), less sensor noise."""
    out = []
    for recording in recordings:
        swim = swim_of(recording, robot)
        residual = swim.signals - simulated(swim, [model], by_twin(robot))[0]
        if not np.isfinite(residual).any():
            raise InputError(recording.file, "", "the twin diverges on it", "a swim it can follow")
        square = np.nanmean(residual**2, axis=0)
        share = 1 - np.divide(np.square(swim.noise), square, np.ones_like(square), where=square > 0)
        out.append(np.nan_to_num(residual) * np.sqrt(np.clip(share, 0.0, 1.0)))
    return out
