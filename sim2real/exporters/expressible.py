"""The nearest model that a target can express: what it lacks is dropped, the rest fitted again.

Gains that were fitted beside an effect are wrong without it: a dead band, dropped from a model,
leaves a servo that is too stiff. So a joint whose effects (or losses of the motor) a target lacks
is refitted without them, to recordings, or to what the full model predicts on a standard
excitation where there are none.
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
"""Change of the motion, RMS, below which an effect is dropped without mention: a fifteenth of a
count of a 12-bit encoder."""
_LINE = {name.removeprefix("motor.") for name in LINE}


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
        expressed: Names of the effects of a joint that the target expresses, and ``motor.NAME`` of
            the losses of its motor; the torque-speed line is taken for granted.
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
        joints[name] = without(joint, lost - matter)
        if not (stood_for := sorted(what for what in matter if _replaceable(what))):
            continue
        soft = STICKS in expressed(joint)
        joints[name], cost = refitted(name, joints[name], stood_for, data, soft=soft)
        refits.append(cost)
        why = "the other parameters were refitted to stand in for it; do not add it"
        dropped += [LeftOut(name, _shown(joint, what), why) for what in stood_for]
    return Expressible(replace(model, joints=joints), tuple(dropped), tuple(refits))


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
    losses = {key for key, value in joint.motor.items() if value and key not in _LINE}
    return effects | {f"motor.{key}" for key in losses if terms.get(key, f"motor.{key}") not in has}


def _replaceable(what: str) -> bool:
    """Whether other parameters of the servo may stand in for an effect or a loss of the motor."""
    if what.startswith("motor."):
        return True
    effect = named(what)
    return not effect.load and not (effect.site == "sensor" and effect.steady)


def _shown(joint: JointModel, what: str) -> str:
    if what.startswith("motor."):
        return f"{what} ({joint.motor[what.removeprefix('motor.')]:.6g})"
    values = next(fitted.parameters for fitted in joint.effects if fitted.effect == what)
    return f"{what} ({', '.join(f'{n} = {x:.6g}' for n, x in values.items() if x)})"


def _moves(own: Sequence[Trace], joint: JointModel, what: str) -> float:
    """RMS by which one effect changes the motion, rad."""
    load = own[0].load
    return rms(residuals(joint_row(without(joint, {what}), load), own))
