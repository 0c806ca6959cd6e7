"""One joint fitted again without effects that a target lacks, and what that costs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.identification.fit import Fit, fit, gains, of_effects, residuals
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect, JointModel, Law
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, SOFT, joint_row, stated
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

STICKS = SOFT[0]
"""Time in which dry friction stops the shaft."""
_STICK_TIME = STICKS.removeprefix("motor.")
_LONGEST_STICK_S = 1.0
_WORTH = 0.99
"""Share of the error that a model with added friction may leave, for it to be preferred."""
_DRY = "coulomb_friction"
_STRENGTHS = (0.3, 1.0, 3.0)
"""Sizes from which dry friction starts, in typical ones."""


@dataclass(frozen=True)
class Refit:
    """One joint that was fitted again without what the target lacks.

    Attributes:
        joint: Its name.
        dropped: What is not in it any more, by name.
        full_rad: RMS difference of the refitted joint from the full model.
        dropped_rad: The same of the full model with the effects merely dropped.
        recorded_rad: RMS errors on a recording that the refit did not see, of the full model and
            of the refitted one; None without recordings.
        held_out: That recording.
    """

    joint: str
    dropped: tuple[str, ...]
    full_rad: float
    dropped_rad: float
    recorded_rad: tuple[float, float] | None = None
    held_out: str = ""

    def __str__(self) -> str:
        """What the refit costs, in mrad."""
        names = ", ".join(self.dropped)
        text = f"{self.joint}: refitted without {names}: {1e3 * self.full_rad:.2f} mrad RMS from "
        text += f"the full model ({1e3 * self.dropped_rad:.2f} had it only been dropped)"
        if self.recorded_rad is not None:
            full, now = (1e3 * x for x in self.recorded_rad)
            text += f"; on {self.held_out}, held out: {now:.2f} mrad as exported, {full:.2f} of "
            text += "the full model"
        return text


@dataclass(frozen=True)
class FittingData:
    """What a joint is fitted to.

    Attributes:
        own: What its full model predicts on the standard excitation.
        fitted: Recordings to fit, or ``own``.
        scored: Those held out; none where there is no recording.
        held_out: What is held out, in words.
    """

    own: list[Trace]
    fitted: list[Trace]
    scored: list[Trace]
    held_out: str


def without(joint: JointModel, lost: Collection[str]) -> JointModel:
    """A joint without some effects, and losses ``motor.NAME`` of its motor."""
    motor = {key: x for key, x in joint.motor.items() if f"motor.{key}" not in lost}
    effects = tuple(fitted for fitted in joint.effects if fitted.effect not in lost)
    return replace(joint, motor=motor, effects=effects)


def refitted(
    name: str, joint: JointModel, lost: Sequence[str], data: FittingData, *, soft: bool = False
) -> tuple[JointModel, Refit]:
    """The joint fitted again without some effects, and what that costs.

    Dry friction stands in for them where the joint has none and that comes nearer, and with
    ``soft`` friction that stops the shaft in a time of its own: without a spring a dead band's
    damping does just that.

    Args:
        name: Name of the joint.
        joint: The full joint.
        lost: Effects, and losses ``motor.NAME``, that it may not have.
        data: What to fit, and what to score.
        soft: Whether friction may be soft.
    """
    own, fitted, scored = data.own, data.fitted, data.scored
    load = own[0].load
    bare = without(joint, lost)
    start = joint_row(bare, load)
    kept = [named(e.effect) for e in bare.effects if named(e.effect).fitted]
    free = [*gains(start, load.inertia_kgm2)]
    free += of_effects(kept, start, load.inertia_kgm2)
    free += _motor(start, bare)
    best = fit(fitted, start, free)
    best = _with_friction(fitted, best, bare, soft=soft)
    effects = _valued(best.row, bare.effects)
    if best.row[FIRST_COLUMN[_DRY]] > 0 and not any(e.effect == _DRY for e in effects):
        effects += _valued(best.row, [FittedEffect(_DRY, {})])
    new = stated(best.row, PER_INERTIA if joint.per_inertia else load, effects)
    law: Law = "motor" if new.motor else joint.law
    new = replace(new, law=law, load=joint.load, inertia_kgm2=joint.inertia_kgm2)
    recorded = None
    if scored:
        full = joint_row(joint, load)
        recorded = rms(residuals(full, scored)), rms(residuals(best.row, scored))
    return new, Refit(
        name,
        tuple(lost),
        full_rad=rms(residuals(best.row, own)),
        dropped_rad=rms(residuals(start, own)),
        recorded_rad=recorded,
        held_out=data.held_out,
    )


def _motor(row: Array, joint: JointModel) -> list[Parameter]:
    """The motor's parameters that a joint has, free within a tenth and ten times."""
    columns = [f"motor.{key}" for key, value in joint.motor.items() if value]
    sizes = [float(row[COLUMNS.index(column)]) for column in columns]
    return [
        Parameter(column, 0.1 * size, 10 * size, size)
        for column, size in zip(columns, sizes, strict=True)
    ]


def _with_friction(fitted: list[Trace], best: Fit, bare: JointModel, *, soft: bool) -> Fit:
    """The fit, with dry friction or soft dry friction as well where that comes nearer."""
    inertia = fitted[0].load.inertia_kgm2
    family = named(_DRY).family
    rubs = bool(bare.motor.get("coulomb_Nm"))
    rubs |= any(named(effect.effect).family == family for effect in bare.effects)
    candidates, stiff = [best], best
    if not rubs:
        (dry,) = of_effects([named(_DRY)], best.row, inertia)
        size = scaled(named(_DRY).parameters[0], float(best.row[0]), inertia).typical
        stiff = _from_several(fitted, best, dry, [strength * size for strength in _STRENGTHS])
        candidates.append(stiff)
    if soft and not bare.motor.get(_STICK_TIME):
        settles = inertia / max(float(best.row[1]), 1e-9)
        sticks = Parameter(STICKS, 0.0, _LONGEST_STICK_S, 0.5 * settles)
        candidates.append(_from_several(fitted, stiff, sticks, [0.3 * settles, settles]))
    chosen = best
    for candidate in candidates[1:]:
        if rms(candidate.residuals) < _WORTH * rms(chosen.residuals):
            chosen = candidate
    return chosen


def _from_several(
    fitted: list[Trace], before: Fit, added: Parameter, sizes: Sequence[float]
) -> Fit:
    """The fit with one parameter more, the best of those that start from these sizes of it."""
    free = [*before.parameters, added]
    tried = []
    for size in sizes:
        row = before.row.copy()
        row[COLUMNS.index(added.name)] = size
        tried.append(fit(fitted, row, free, rounds=1, evaluations=15))
    nearest = min(tried, key=lambda each: rms(each.residuals))
    return fit(fitted, nearest.row, free)


def _valued(row: Array, effects: Sequence[FittedEffect]) -> list[FittedEffect]:
    """The effects with the parameters that a row gives them."""
    return [
        FittedEffect(
            given.effect,
            {
                p.name: float(row[FIRST_COLUMN[given.effect] + k])
                for k, p in enumerate(named(given.effect).parameters)
            },
        )
        for given in effects
    ]
