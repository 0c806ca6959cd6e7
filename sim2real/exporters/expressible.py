"""The nearest model that a target can express: missing effects are dropped, the rest refitted.

Gains that were fitted together with an effect are wrong without it: without its dead band, for
example, a servo is too stiff. A joint with effects (or losses of the motor) that a target lacks is
therefore refitted without them, to recordings, or without recordings to the predictions of the full
model on a standard excitation.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from sim2real.effects import named
from sim2real.exporters.actuator import MOTOR_TERMS, LeftOut
from sim2real.exporters.excitation import excitation
from sim2real.exporters.refit import STICKS, FittingData, Refit, refitted, without
from sim2real.identification.fit import residuals
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import LINE, joint_row
from sim2real.servo.trace import Trace, split, traces

NEGLIGIBLE_RAD = 1e-4
"""RMS change of the motion below which an effect is dropped without being listed: a fifteenth of a
count of a 12-bit encoder."""
_LINE = {name.removeprefix("motor.") for name in LINE}


@dataclass(frozen=True)
class Expressible:
    """A model that a target expresses.

    Attributes:
        model: The model.
        dropped: Parts of the full model that it lacks, for the head of an exported file.
        refits: Errors of the refitted joints.
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
    """The model without the effects that a target lacks, with its other parameters refitted.

    Effects that no other parameter can replace are kept, and the target lists them: those drawn
    for each set-point, errors of the angle sensor that depend only on the angle, and corrections
    of the load, which belongs to the link of the robot.

    Args:
        model: The fitted model.
        expressed: Names of the effects of a joint that the target expresses, and ``motor.NAME`` of
            the losses of its motor; the torque-speed line is always expressed.
        recordings: Recordings to refit to; the last is held out, or the last quarter of a single
            one. If no recording moves a joint, the predictions of the model are used.
        robot: Source of the limits of the standard excitation.

    Raises:
        InputError: If the model has an unknown effect.
    """
    joints, dropped, refits = dict(model.joints), [], []
    for name, joint in model.joints.items():
        lost = _lost(joint, expressed(joint))
        if not lost:
            continue
        data = fitting_data(name, joint, recordings, robot)
        relevant = {effect for effect in lost if _moves(data.own, joint, effect) > NEGLIGIBLE_RAD}
        joints[name] = without(joint, lost - relevant)
        if not (replaced := sorted(effect for effect in relevant if _replaceable(effect))):
            continue
        soft = STICKS in expressed(joint)
        joints[name], cost = refitted(name, joints[name], replaced, data, soft=soft)
        refits.append(cost)
        why = "the other parameters were refitted to compensate for it; do not add it"
        dropped += [LeftOut(name, _shown(joint, effect), why) for effect in replaced]
    return Expressible(replace(model, joints=joints), tuple(dropped), tuple(refits))


def fitting_data(
    name: str, joint: JointModel, recordings: Sequence[Recording], robot: Robot | None
) -> FittingData:
    """Data to refit a joint to: recordings in which it moves, else predictions of its model."""
    sheet = robot.joint(name) if robot else None
    reach = 0.9 * min(abs(x) for x in sheet.limits_rad) if sheet else None
    predicted = excitation(joint, name, reach)
    data = _on_load(traces(recordings, name), joint)
    return FittingData(predicted, *(split(data, None) if data else (predicted, [], "")))


def _on_load(data: Sequence[Trace], joint: JointModel) -> list[Trace]:
    """The traces with the load that the gains of the model refer to."""
    if joint.per_inertia:
        return [replace(trace, load=PER_INERTIA) for trace in data]
    load = joint.load
    return [
        replace(trace, load=load) if trace.load is PER_INERTIA and load else trace for trace in data
    ]


def _lost(joint: JointModel, has: Collection[str]) -> set[str]:
    """What the target lacks: effects that can be fitted, and ``motor.NAME`` for losses."""
    effects = {
        fitted.effect
        for fitted in joint.effects
        if fitted.effect not in has and named(fitted.effect).fitted
    }
    terms = {key: effect for key, effect, _ in MOTOR_TERMS}
    losses = {key for key, value in joint.motor.items() if value and key not in _LINE}
    return effects | {f"motor.{key}" for key in losses if terms.get(key, f"motor.{key}") not in has}


def _replaceable(name: str) -> bool:
    """Whether other parameters of the servo may replace an effect or a loss of the motor."""
    if name.startswith("motor."):
        return True
    effect = named(name)
    return not effect.load and not (effect.site == "sensor" and effect.steady)


def _shown(joint: JointModel, effect: str) -> str:
    if effect.startswith("motor."):
        return f"{effect} ({joint.motor[effect.removeprefix('motor.')]:.6g})"
    values = next(fitted.parameters for fitted in joint.effects if fitted.effect == effect)
    return f"{effect} ({', '.join(f'{n} = {x:.6g}' for n, x in values.items() if x)})"


def _moves(predicted: Sequence[Trace], joint: JointModel, effect: str) -> float:
    """RMS change of the motion by one effect, rad."""
    load = predicted[0].load
    return rms(residuals(joint_row(without(joint, {effect}), load), predicted))
