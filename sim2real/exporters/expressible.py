"""The nearest model that a target can express: what it lacks is dropped, the rest fitted again.

Gains that were fitted beside an effect are wrong without it: a dead band, dropped from a model,
leaves a servo that is too stiff. So a joint whose effects (or losses of the motor) a target lacks
is refitted without them, to recordings, or to what the full model predicts on a standard
excitation where there are none.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.exporters.actuator import MOTOR_TERMS, LeftOut
from sim2real.exporters.excitation import excitation
from sim2real.identification.fit import Fit, fit, gains, of_effects, residuals
from sim2real.inference.holdout import rms
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, joint_row, stated
from sim2real.servo.trace import Trace, split, traces

Array = NDArray[np.float64]

NEGLIGIBLE_RAD = 1e-4
"""Change of the motion, RMS, below which an effect is dropped without mention: a fifteenth of a
count of a 12-bit encoder."""
_WORTH = 0.99
"""Share of the error that a model with added dry friction may leave, for it to be preferred."""
_DRY = "coulomb_friction"
_DRIVE = ("stall_torque_Nm", "no_load_speed_rad_s")
_KEPT_MOTOR = {*_DRIVE, *(key for key, _, _ in MOTOR_TERMS)}
"""Parameters of the law ``motor`` that every target expresses, if it expresses their effects."""
_STRENGTHS = (0.3, 1.0, 3.0)


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
class Expressible:
    """A model that a target expresses.

    Attributes:
        model: The model.
        dropped: What it lacks of the full one, for the head of an exported file.
        refits: What that costs, joint by joint.
    """

    model: Model
    dropped: tuple[LeftOut, ...]
    refits: tuple[Refit, ...]


def expressible(
    model: Model,
    expressed: Callable[[JointModel], Collection[str]],
    recordings: Sequence[Recording] = (),
    robot: Robot | None = None,
) -> Expressible:
    """The model without the effects that a target lacks, its other parameters fitted again.

    Effects that no other parameter can stand in for stay, and the target lists them: those drawn
    anew for each set-point, errors of the angle sensor that depend on the angle alone, and what
    makes up for a load, which belongs to the robot's link.

    Args:
        model: The fitted model.
        expressed: Names of the effects of a joint that the target expresses.
        recordings: What to refit to; the last is held out, of a lone one its last quarter. The
            model's own predictions where none of them moves a joint.
        robot: Its limits bound the standard excitation.

    Raises:
        InputError: If the model has an effect that the catalogue lacks.
    """
    joints, dropped, refits = dict(model.joints), [], []
    for name, joint in model.joints.items():
        lost = _lost(joint, expressed(joint))
        if not lost:
            continue
        data = fitting_data(name, joint, recordings, robot)
        matter = {what for what in lost if _moves(data.own, joint, what) > NEGLIGIBLE_RAD}
        joints[name] = _without(joint, lost - matter)
        if not (stood_for := sorted(what for what in matter if _replaceable(what))):
            continue
        joints[name], cost = _refitted(name, joints[name], stood_for, data)
        refits.append(cost)
        why = "the other parameters were refitted to stand in for it; do not add it"
        dropped += [LeftOut(name, _shown(joint, what), why) for what in stood_for]
    return Expressible(replace(model, joints=joints), tuple(dropped), tuple(refits))


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


def fitting_data(
    name: str, joint: JointModel, recordings: Sequence[Recording], robot: Robot | None
) -> FittingData:
    """What a joint is fitted to: recordings in which it moves, else its own predictions."""
    sheet = robot.joint(name) if robot else None
    reach = 0.9 * min(abs(x) for x in sheet.limits_rad) if sheet else None
    own = excitation(joint, name, reach)
    data = _on_load(traces(recordings, name), joint)
    return FittingData(own, *(split(data, None) if data else (own, [], "")))


def _on_load(data: Sequence[Trace], joint: JointModel) -> list[Trace]:
    """The traces on loads that the model's gains are meant for."""
    if joint.per_inertia:
        return [replace(trace, load=PER_INERTIA) for trace in data]
    known = joint.load
    return [
        replace(trace, load=known) if trace.load is PER_INERTIA and known else trace
        for trace in data
    ]


def _lost(joint: JointModel, has: Collection[str]) -> set[str]:
    """What the target lacks: effects that a fit can follow, and ``motor.NAME`` for losses."""
    effects = {
        fitted.effect
        for fitted in joint.effects
        if fitted.effect not in has and named(fitted.effect).fitted
    }
    terms = {key: effect for key, effect, _ in MOTOR_TERMS}
    losses = {
        f"motor.{key}"
        for key, value in joint.motor.items()
        if value and (terms[key] not in has if key in terms else key not in _KEPT_MOTOR)
    }
    return effects | losses


def _replaceable(what: str) -> bool:
    """Whether other parameters of the servo may stand in for an effect or a loss of the motor."""
    if what.startswith("motor."):
        return True
    effect = named(what)
    return not effect.load and not (effect.site == "sensor" and effect.steady)


def _without(joint: JointModel, lost: Collection[str]) -> JointModel:
    motor = {key: x for key, x in joint.motor.items() if f"motor.{key}" not in lost}
    effects = tuple(fitted for fitted in joint.effects if fitted.effect not in lost)
    return replace(joint, motor=motor, effects=effects)


def _shown(joint: JointModel, what: str) -> str:
    if what.startswith("motor."):
        return f"{what} ({joint.motor[what.removeprefix('motor.')]:.6g})"
    values = next(fitted.parameters for fitted in joint.effects if fitted.effect == what)
    return f"{what} ({', '.join(f'{n} = {x:.6g}' for n, x in values.items() if x)})"


def _moves(own: Sequence[Trace], joint: JointModel, what: str) -> float:
    """RMS by which one effect changes the motion, rad."""
    load = own[0].load
    return rms(residuals(joint_row(_without(joint, {what}), load), own))


def _refitted(
    name: str, joint: JointModel, lost: Sequence[str], data: FittingData
) -> tuple[JointModel, Refit]:
    """The joint fitted again without some effects, and what that costs."""
    own, fitted, scored = data.own, data.fitted, data.scored
    load = own[0].load
    bare = _without(joint, lost)
    start = joint_row(bare, load)
    kept = [named(e.effect) for e in bare.effects if named(e.effect).fitted]
    free = [*gains(start, load.inertia_kgm2)]
    free += of_effects(kept, start, load.inertia_kgm2)
    free += _drive(start, bare)
    best = fit(fitted, start, free)
    if not any(effect.family == named(_DRY).family for effect in kept):
        best = _with_dry_friction(fitted, best, free)
    rubs = best.row[FIRST_COLUMN[_DRY]] > 0
    effects = list(_valued(best.row, bare.effects))
    if rubs and not any(e.effect == _DRY for e in bare.effects):
        (only,) = (p.name for p in named(_DRY).parameters)
        effects.append(FittedEffect(_DRY, {only: float(best.row[FIRST_COLUMN[_DRY]])}))
    new = stated(best.row, PER_INERTIA if joint.per_inertia else load, effects)
    new = replace(new, law=joint.law, load=joint.load, inertia_kgm2=joint.inertia_kgm2)
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


def _drive(row: Array, joint: JointModel) -> list[Parameter]:
    """The motor's line and its own friction and rotor, free where the joint has them."""
    names = [key for key in (*_DRIVE, *(key for key, _, _ in MOTOR_TERMS)) if joint.motor.get(key)]
    columns = [f"motor.{key}" for key in names]
    sizes = [float(row[COLUMNS.index(column)]) for column in columns]
    return [
        Parameter(column, 0.1 * size, 10 * size, size)
        for column, size in zip(columns, sizes, strict=True)
    ]


def _with_dry_friction(fitted: list[Trace], best: Fit, free: list[Parameter]) -> Fit:
    """The fit with dry friction as well, where that comes nearer: it stands in for most losses."""
    inertia = fitted[0].load.inertia_kgm2
    (dry,) = of_effects([named(_DRY)], best.row, inertia)
    size = scaled(named(_DRY).parameters[0], float(best.row[0]), inertia).typical
    more = []
    for strength in _STRENGTHS:
        row = best.row.copy()
        row[FIRST_COLUMN[_DRY]] = strength * size
        more.append(fit(fitted, row, [*free, dry], rounds=1, evaluations=15))
    nearest = min(more, key=lambda each: rms(each.residuals))
    nearest = fit(fitted, nearest.row, [*free, dry])
    return nearest if rms(nearest.residuals) < _WORTH * rms(best.residuals) else best


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
