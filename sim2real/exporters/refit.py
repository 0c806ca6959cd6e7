"""Refit of one joint without effects that a target lacks, and its error."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from sim2real.arrays import Array
from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.exporters.actuator import BEYOND_LIMIT
from sim2real.identification.fit import Fit, fit, gains, of_effects, residuals
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect, JointModel, Law, train_rotor, with_inertia
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import (
    COLUMNS,
    CURRENT_LIMIT,
    FIRST_COLUMN,
    LINE,
    SOFT,
    joint_row,
    stated,
)
from sim2real.servo.trace import Trace

STICKS, CREEPS = SOFT
"""Times in which dry friction stops the shaft, and of its creep: parameters of the motor."""
_STICK_TIME = STICKS.removeprefix("motor.")
_LONGEST_STICK_S = 1.0
_WORTH = 0.99
"""Largest relative error of a model with added friction for it to be preferred."""
_DRY = "coulomb_friction"
_LIMITS = {*LINE, CURRENT_LIMIT, BEYOND_LIMIT}
_STRENGTHS = (0.3, 1.0, 3.0)
"""Start values of dry friction, relative to its typical size."""


@dataclass(frozen=True)
class Refit:
    """Errors of one joint that was refitted without effects that the target lacks.

    Attributes:
        joint: Name of the joint.
        dropped: Names of the dropped effects.
        full_rad: RMS difference of the refitted joint from the full model.
        dropped_rad: RMS difference without refit of the other parameters.
        recorded_rad: RMS errors on a held-out recording, of the full model and of the refitted
            one; None without recordings.
        held_out: That recording.
    """

    joint: str
    dropped: tuple[str, ...]
    full_rad: float
    dropped_rad: float
    recorded_rad: tuple[float, float] | None = None
    held_out: str = ""

    def __str__(self) -> str:
        """The errors in mrad."""
        names = ", ".join(self.dropped)
        text = f"{self.joint}: refitted without {names}: {1e3 * self.full_rad:.2f} mrad RMS from "
        text += f"the full model ({1e3 * self.dropped_rad:.2f} without refit)"
        if self.recorded_rad is not None:
            full, exported = (1e3 * x for x in self.recorded_rad)
            text += (
                f"; on {self.held_out}, held out: {exported:.2f} mrad as exported, {full:.2f} of "
            )
            text += "the full model"
        return text


@dataclass(frozen=True)
class FittingData:
    """Data for the refit of a joint.

    Attributes:
        own: Predictions of its full model on the standard excitation.
        fitted: Recordings to fit, or ``own``.
        scored: Held-out recordings; empty without recordings.
        held_out: Description of the held-out part.
    """

    own: list[Trace]
    fitted: list[Trace]
    scored: list[Trace]
    held_out: str


def without(joint: JointModel, lost: Collection[str]) -> JointModel:
    """A joint without some effects, with 0 for parameters of some, and without ``motor.NAME``.

    The rotor of a gear train that is lost stays: it turns with the load.
    """
    motor = {key: x for key, x in joint.motor.items() if f"motor.{key}" not in lost}
    effects = tuple(
        replace(
            fitted,
            parameters={
                key: 0.0 if f"{fitted.effect}.{key}" in lost else value
                for key, value in fitted.parameters.items()
            },
        )
        for fitted in joint.effects
        if fitted.effect not in lost
    )
    rotor = train_rotor(joint.effects) - train_rotor(effects)
    if rotor > 0:
        effects = with_inertia(effects, rotor)
    return replace(joint, law=joint.law if motor else "pd", motor=motor, effects=effects)


def refitted(
    name: str,
    joint: JointModel,
    lost: Sequence[str],
    data: FittingData,
    *,
    dry: bool = True,
    soft: bool = False,
) -> tuple[JointModel, Refit]:
    """The joint refitted without some effects, and the errors.

    With ``dry``, dry friction is added if the joint has none and it reduces the error; with
    ``soft`` also friction that stops the shaft within a finite time, which resembles the damping of
    a dead band without its spring.

    Args:
        name: Name of the joint.
        joint: The full joint.
        lost: Effects, and losses ``motor.NAME``, to drop.
        data: Data for the fit and the errors.
        dry: Whether friction may be added.
        soft: Whether friction may be soft.
    """
    predicted, fitted, scored = data.own, data.fitted, data.scored
    load = predicted[0].load
    reduced = without(joint, lost)
    start = joint_row(reduced, load)
    effects_kept = [named(e.effect) for e in reduced.effects if named(e.effect).fitted]
    free = [*gains(start, load.inertia_kgm2)]
    free += of_effects(effects_kept, start, load.inertia_kgm2)
    free += _motor(start, reduced)
    if scored:  # the recordings may not reach the limits, as those of the full model may have
        free = [parameter for parameter in free if parameter.name not in _LIMITS]
    best = fit(fitted, start, free)
    if dry:
        best = _with_friction(fitted, best, reduced, soft=soft)
    effects = _valued(best.row, reduced.effects)
    if best.row[FIRST_COLUMN[_DRY]] > 0 and not any(e.effect == _DRY for e in effects):
        effects += _valued(best.row, [FittedEffect(_DRY, {})])
    refit = stated(best.row, PER_INERTIA if joint.per_inertia else load, effects)
    law: Law = reduced.law if reduced.motor or not refit.motor else "motor"
    refit = replace(refit, law=law, load=joint.load, inertia_kgm2=joint.inertia_kgm2)
    recorded = None
    if scored:
        full = joint_row(joint, load)
        recorded = rms(residuals(full, scored)), rms(residuals(best.row, scored))
    return refit, Refit(
        name,
        tuple(lost),
        full_rad=rms(residuals(best.row, predicted)),
        dropped_rad=rms(residuals(start, predicted)),
        recorded_rad=recorded,
        held_out=data.held_out,
    )


def _motor(row: Array, joint: JointModel) -> list[Parameter]:
    """The motor parameters of a joint, bounded to a tenth and ten times their values."""
    columns = [f"motor.{key}" for key, value in joint.motor.items() if value]
    sizes = [float(row[COLUMNS.index(column)]) for column in columns]
    return [
        Parameter(column, 0.1 * size, 10 * size, size)
        for column, size in zip(columns, sizes, strict=True)
    ]


def _with_friction(fitted: list[Trace], best: Fit, reduced: JointModel, *, soft: bool) -> Fit:
    """The fit, with added dry or soft dry friction if that reduces the error."""
    inertia = fitted[0].load.inertia_kgm2
    family = named(_DRY).family
    has_friction = bool(reduced.motor.get("coulomb_Nm"))
    has_friction |= any(named(effect.effect).family == family for effect in reduced.effects)
    candidates, stiff = [best], best
    if not has_friction:
        (dry,) = of_effects([named(_DRY)], best.row, inertia)
        size = scaled(named(_DRY).parameters[0], float(best.row[0]), inertia).typical
        stiff = _from_several(fitted, best, dry, [strength * size for strength in _STRENGTHS])
        candidates.append(stiff)
    if soft and not reduced.motor.get(_STICK_TIME):
        settles = inertia / max(float(best.row[1]), 1e-9)
        sticks = Parameter(STICKS, 0.0, _LONGEST_STICK_S, 0.5 * settles)
        softer = _from_several(fitted, stiff, sticks, [0.3 * settles, settles])
        creeps = Parameter(CREEPS, 0.0, _LONGEST_STICK_S, 0.5 * settles)
        candidates += [softer, _from_several(fitted, softer, creeps, [0.1 * settles, settles])]
    chosen = best
    for candidate in candidates[1:]:
        if rms(candidate.residuals) < _WORTH * rms(chosen.residuals):
            chosen = candidate
    return chosen


def _from_several(
    fitted: list[Trace], before: Fit, added: Parameter, sizes: Sequence[float]
) -> Fit:
    """The best fit with one more parameter, started from several values of it."""
    free = [*before.parameters, added]
    candidates = []
    for size in sizes:
        row = before.row.copy()
        row[COLUMNS.index(added.name)] = size
        candidates.append(fit(fitted, row, free, rounds=1, evaluations=15))
    nearest = min(candidates, key=lambda candidate: rms(candidate.residuals))
    return fit(fitted, nearest.row, free)


def _valued(row: Array, effects: Sequence[FittedEffect]) -> list[FittedEffect]:
    """The effects with their parameters in a row."""
    return [
        FittedEffect(
            effect.effect,
            {
                p.name: float(row[FIRST_COLUMN[effect.effect] + k])
                for k, p in enumerate(named(effect.effect).parameters)
            },
        )
        for effect in effects
    ]
