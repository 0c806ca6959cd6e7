"""Refit of one joint without effects that a target lacks, and the data for it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.exporters.actuator import BEYOND_LIMIT
from sim2real.identification.priors import gains, of_effects
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import fit
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect, JointModel, train_rotor, with_inertia
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import (
    COLUMNS,
    CURRENT_LIMIT,
    FIRST_COLUMN,
    LINE,
    SOFT,
    joint_row,
    stated,
)
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import Trace, split, traces

SECONDS, REACH_RAD = 15.0, 0.6
"""Length of the standard excitation, and its largest set-point."""
BETTER = 0.99
"""Largest error of a model, relative to that of another, for it to be preferred."""
STICKS, CREEPS = SOFT
"""Times in which dry friction stops the shaft, and of its creep: parameters of the motor."""
_LONGEST_STICK_S = 1.0
_DRY = "coulomb_friction"


@dataclass(frozen=True)
class FittingData:
    """Data for the refit of a joint."""

    own: list[Trace]  # predictions of its full model on the standard excitation
    fitted: list[Trace]  # recordings to fit, or ``own``
    scored: list[Trace]  # held-out recordings; empty without recordings
    held_out: str  # description of the held-out part


def without(joint: JointModel, lost: Collection[str]) -> JointModel:
    """A joint without some effects, with 0 for parameters of some, and without ``motor.NAME``.

    The rotor of a gear train that is lost stays: it turns with the load.
    """
    motor = {key: x for key, x in joint.motor.items() if f"motor.{key}" not in lost}
    effects = tuple(
        FittedEffect(
            name, {n: 0.0 if f"{name}.{n}" in lost else x for n, x in fitted.parameters.items()}
        )
        for fitted in joint.effects
        if (name := fitted.effect) not in lost
    )
    rotor = train_rotor(joint.effects) - train_rotor(effects)
    if rotor > 0:
        effects = with_inertia(effects, rotor)
    return replace(joint, law=joint.law if motor else "pd", motor=motor, effects=effects)


def refitted(
    joint: JointModel, lost: Collection[str], data: FittingData, *, dry: bool, soft: bool
) -> tuple[JointModel, Array, Array]:
    """The joint refitted without some effects, and its parameters before and after, (P,).

    With ``dry``, dry friction is added if the joint has none and it reduces the error; with
    ``soft`` also friction that stops the shaft within a finite time, which resembles the damping of
    a dead band without its spring.
    """
    load = data.own[0].load
    reduced = without(joint, lost)
    start = joint_row(reduced, load)
    kept = [named(e.effect) for e in reduced.effects if named(e.effect).fitted]
    free = [*gains(load.inertia_kgm2), *of_effects(kept, start, load.inertia_kgm2)]
    for key in (key for key, value in reduced.motor.items() if value):
        size = float(start[COLUMNS.index(f"motor.{key}")])
        free.append(Parameter(f"motor.{key}", 0.1 * size, 10 * size, size))
    if data.scored:  # the recordings may not reach the limits, as those of the full model may have
        free = [p for p in free if p.name not in {*LINE, CURRENT_LIMIT, BEYOND_LIMIT}]
    best = fit(ServoProblem(data.fitted, start, tuple(free)), start[None], first=40)
    if dry:
        best = _with_friction(data.fitted, best, reduced, soft=soft)
    names = [effect.effect for effect in reduced.effects]
    if best.row[FIRST_COLUMN[_DRY]] > 0 and _DRY not in names:
        names.append(_DRY)
    effects = [FittedEffect(name, _values(best.row, name)) for name in names]
    servo = stated(best.row, PER_INERTIA if joint.per_inertia else load, effects)
    law = reduced.law if reduced.motor or not servo.motor else "motor"
    servo = replace(servo, law=law, load=joint.load, inertia_kgm2=joint.inertia_kgm2)
    return servo, start, best.row


def _values(row: Array, effect: str) -> dict[str, float]:
    """The parameters of an effect in a row (P,)."""
    first = FIRST_COLUMN[effect]
    return {p.name: float(row[first + k]) for k, p in enumerate(named(effect).parameters)}


def _with_friction(fitted: list[Trace], best: Fit, reduced: JointModel, *, soft: bool) -> Fit:
    """The fit, with added dry or soft dry friction if that reduces the error."""
    inertia, effect = fitted[0].load.inertia_kgm2, named(_DRY)
    families = {named(fitted.effect).family for fitted in reduced.effects}
    candidates, stiff = [best], best
    if effect.family not in families and not reduced.motor.get("coulomb_Nm"):
        (dry,) = of_effects([effect], best.row, inertia)
        size = scaled(effect.parameters[0], float(best.row[0]), inertia).typical
        stiff = _from_several(fitted, best, dry, [0.3 * size, size, 3 * size])
        candidates.append(stiff)
    if soft and not reduced.motor.get(STICKS.removeprefix("motor.")):
        settles = inertia / max(float(best.row[1]), 1e-9)
        sticks = Parameter(STICKS, 0.0, _LONGEST_STICK_S, 0.5 * settles)
        softer = _from_several(fitted, stiff, sticks, [0.3 * settles, settles])
        creeps = Parameter(CREEPS, 0.0, _LONGEST_STICK_S, 0.5 * settles)
        candidates += [softer, _from_several(fitted, softer, creeps, [0.1 * settles, settles])]
    chosen = best
    for candidate in candidates[1:]:
        if rms(candidate.residuals) < BETTER * rms(chosen.residuals):
            chosen = candidate
    return chosen


def _from_several(
    fitted: list[Trace], before: Fit, added: Parameter, sizes: Sequence[float]
) -> Fit:
    """The best fit with one more parameter, started from several values of it."""
    rows = np.tile(before.row, (len(sizes), 1))
    rows[:, COLUMNS.index(added.name)] = sizes
    return fit(ServoProblem(fitted, before.row, (*before.parameters, added)), rows, first=40)


def fitting_data(
    name: str, joint: JointModel, recordings: Sequence[Recording], robot: Robot | None
) -> FittingData:
    """Data to refit a joint to: recordings in which it moves, else predictions of its model."""
    sheet = robot.joint(name) if robot else None
    reach = 0.9 * min(abs(x) for x in sheet.limits_rad) if sheet else REACH_RAD
    own = excitation(joint, name, min(reach, REACH_RAD))
    data = traces(recordings, name)
    if joint.per_inertia:  # the load that the gains of the model refer to
        data = [replace(trace, load=PER_INERTIA) for trace in data]
    elif joint.load:
        data = [
            replace(trace, load=joint.load) if trace.load is PER_INERTIA else trace
            for trace in data
        ]
    return FittingData(own, *(split(data, None) if data else (own, [], "")))


def excitation(joint: JointModel, name: str, reach_rad: float = REACH_RAD) -> list[Trace]:
    """Predictions of a joint's model on standard commands, as noiseless traces.

    The commands are random steps, a chirp from 0.1 to 2.5 Hz and a slow triangle wave.

    Args:
        joint: The fitted joint.
        name: Its name.
        reach_rad: Largest set-point.
    """
    t = 0.01 * np.arange(round(SECONDS / 0.01), dtype=np.float64)
    rng = np.random.default_rng(20240)
    moves = 0.5 + np.cumsum(rng.uniform(0.3, 0.9, 50))
    levels = np.concatenate([[0.0], rng.uniform(-reach_rad, reach_rad, 50)])
    s = np.maximum(t - 0.5, 0.0)
    sweep = 0.1 * s + 0.5 * (2.5 - 0.1) / s[-1] * s**2
    signals = {
        "steps": levels[np.searchsorted(moves, t, side="right")],
        "chirp": 0.6 * reach_rad * np.sin(2 * np.pi * sweep),
        "triangle": reach_rad * ((2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.3 * s))),
    }
    load = PER_INERTIA if joint.per_inertia else joint.load or Load(joint.inertia_kgm2)
    row = joint_row(joint, load, where=f"model, {name}")
    used = np.ones(t.size, dtype=bool)
    return [
        Trace(kind, f"standard {kind}", t, sent, rollout(row[None], t, sent)[0], load, used)
        for kind, sent in signals.items()
    ]
