"""The nearest model that a target can express: missing effects are dropped, the rest refitted.

Gains that were fitted together with an effect are wrong without it: without its dead band, for
example, a servo is too stiff. A joint with effects (or losses of the motor) that a target lacks is
therefore refitted without them, to recordings, or without recordings to the predictions of the full
model on a standard excitation. Of several such models, the plain servo without any effect among
them, the one with the smallest error on these data is exported.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from sim2real.effects import named
from sim2real.exporters.actuator import BEYOND_LIMIT, MOTOR_TERMS, SATURATION, LeftOut
from sim2real.exporters.excitation import excitation
from sim2real.exporters.refit import STICKS, FittingData, Refit, refitted, without
from sim2real.identification.search import errors_of
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import LINE, joint_row
from sim2real.servo.trace import Trace, split, traces

NEGLIGIBLE_RAD = 1e-4
"""RMS change of the motion below which an effect is dropped without being listed: a fifteenth of a
count of a 12-bit encoder."""
_BETTER = 0.99
"""Largest error of a model with fewer effects, relative to the others, for it to be preferred."""
_LINE = {name.removeprefix("motor.") for name in LINE}
Which = Literal["nearest", "effects", "plain"]
"""Models that can be chosen: the one with the smaller error, with effects, or without any."""


@dataclass(frozen=True)
class Compared:
    """Errors of a joint as exported and of the alternative, with effects and without any.

    Attributes:
        joint: Name of the joint.
        plain: Whether the plain servo is exported.
        effects_rad: RMS error with the effects that the target expresses.
        plain_rad: RMS error of the plain servo.
        what: What both were compared with.
    """

    joint: str
    plain: bool
    effects_rad: float
    plain_rad: float
    what: str

    def __str__(self) -> str:
        """The errors in mrad, and how to export the other model."""
        effects, plain = (f"{1e3 * x:.2f} mrad RMS" for x in (self.effects_rad, self.plain_rad))
        text = f"{self.joint}: {effects} from {self.what} with its effects, "
        text += f"{plain} as a plain servo"
        exported, other = (
            ("plain servo", "effects") if self.plain else ("servo with effects", "plain")
        )
        return f"{text}: the {exported} is exported (--which {other} for the other)"


@dataclass(frozen=True)
class Expressible:
    """A model that a target expresses.

    Attributes:
        model: The model.
        dropped: Parts of the full model that it lacks, for the head of an exported file.
        refits: Errors of the refitted joints.
        compared: Errors of joints with effects, and of the plain servo.
    """

    model: Model
    dropped: tuple[LeftOut, ...]
    refits: tuple[Refit, ...]
    compared: tuple[Compared, ...] = ()


@dataclass(frozen=True)
class _Exported:
    """A joint that a target expresses, and what it lacks of the full one."""

    joint: JointModel
    dropped: tuple[LeftOut, ...] = ()
    refits: tuple[Refit, ...] = ()


def rollout_error(joint: JointModel, name: str, data: Sequence[Trace]) -> float:
    """RMS difference of a joint's law from the used samples of traces, rad."""
    return rms(errors_of(joint_row(joint, data[0].load, where=name), data))


def expressible(
    model: Model,
    expressed: Callable[[JointModel], Collection[str]],
    recordings: Sequence[Recording] = (),
    robot: Robot | None = None,
    *,
    which: Which = "nearest",
    rough: Collection[str] = (),
    costly: Collection[str] = (),
    error: Callable[[JointModel, str, Sequence[Trace]], float] = rollout_error,
) -> Expressible:
    """The model without the effects that a target lacks, with its other parameters refitted.

    Effects that no other parameter can replace are kept, and the target lists them: those drawn
    for each set-point, errors of the angle sensor that depend only on the angle, and corrections
    of the load, which belongs to the link of the robot.

    Args:
        model: The fitted model.
        expressed: Names of the effects of a joint that the target expresses, and ``motor.NAME`` of
            the losses of its motor; the torque-speed line is always expressed. A target with this
            line and a current limit, but not the damping beyond it, has ``torque_saturation``
            without ``BEYOND_LIMIT``.
        recordings: Recordings to refit to; the last is held out, or the last quarter of a single
            one. If no recording moves a joint, the predictions of the model are used.
        robot: Source of the limits of the standard excitation.
        which: Whether to export a joint with effects, as a plain servo, or as whichever has the
            smaller error on all these data, held-out ones included.
        rough: Effects that the target expresses but simulates inaccurately, which are dropped if
            the error is smaller without them.
        costly: Limits that make the target's model more complex beside a torque-speed line, which
            are dropped, and listed, if no motion reaches them.
        error: RMS error in rad of a joint of this name on traces, in the target.

    Raises:
        InputError: If the model has an unknown effect.
    """
    joints = dict(model.joints)
    dropped: list[LeftOut] = []
    refits: list[Refit] = []
    compared: list[Compared] = []
    for name, joint in model.joints.items():
        has, lost = expressed(joint), _lost(joint, expressed(joint))
        if not lost and not any(_replaceable(fitted.effect) for fitted in joint.effects):
            continue
        data = fitting_data(name, joint, recordings, robot)
        candidates = _candidates(name, joint, lost, data, rough, costly, soft=STICKS in has)
        best, found = _best(name, candidates, data, error, which)
        joints[name] = best.joint
        dropped += best.dropped
        refits += best.refits
        compared += found
    return Expressible(
        replace(model, joints=joints), tuple(dropped), tuple(refits), tuple(compared)
    )


def _candidates(
    name: str,
    joint: JointModel,
    lost: set[str],
    data: FittingData,
    rough: Collection[str],
    costly: Collection[str],
    *,
    soft: bool,
) -> dict[str, Callable[[], _Exported]]:
    """Models that the target expresses: ``plain`` without effects, if that is another one."""
    effects = {fitted.effect for fitted in joint.effects}
    line = {name for name in LINE if joint.motor.get(name.removeprefix("motor."))}
    drops = {"as far as expressed": lost}
    saturation = {SATURATION, BEYOND_LIMIT}
    if lost & saturation and line:  # a target with one limit may have that of the current
        drops["current limit"] = lost - saturation | line
    if effects & set(rough):
        drops["without rough effects"] = lost | effects & set(rough)
    drops["plain"] = lost | {effect for effect in effects if _replaceable(effect)}
    still = {
        part
        for part in drops["plain"].union(*drops.values())
        if part not in line and _moves(data, joint, part) < NEGLIGIBLE_RAD
    }
    unreached = still & set(costly) if line else set()
    drops = {kind: dropped | unreached for kind, dropped in drops.items()}
    kinds: dict[frozenset[str], str] = {}
    for kind, dropped in drops.items():
        kinds.setdefault(frozenset(dropped - still), kind)
    return {
        kind: partial(
            _without,
            name,
            joint,
            key,
            drops[kind] & still,
            still,
            partial(refitted, data=data, dry=kind != "plain", soft=soft),
        )
        for key, kind in kinds.items()
    }


def _without(
    name: str,
    joint: JointModel,
    parts: Collection[str],
    lost: Collection[str],
    still: Collection[str],
    refit: Callable[[str, JointModel, Sequence[str]], tuple[JointModel, Refit]],
) -> _Exported:
    """A joint without some parts, refitted if other parameters may replace them.

    Parts that hardly move it, ``still``, are dropped before a refit, else only those ``lost``.
    """
    lines = []
    if SATURATION in lost and joint.motor.get("stall_torque_Nm"):
        why = "no motion of the recordings or the standard excitation reaches it"
        lines.append(LeftOut(name, _shown(joint, SATURATION), why))
    if not (replaced := sorted(part for part in parts if _replaceable(part))):
        return _Exported(without(joint, lost), tuple(lines))
    servo, cost = refit(name, without(joint, still), replaced)
    why = "the other parameters were refitted to compensate for it; do not add it"
    lines += [LeftOut(name, _shown(joint, part), why) for part in replaced]
    return _Exported(servo, tuple(lines), (cost,))


def _best(
    name: str,
    candidates: Mapping[str, Callable[[], _Exported]],
    data: FittingData,
    error: Callable[[JointModel, str, Sequence[Trace]], float],
    which: Which,
) -> tuple[_Exported, list[Compared]]:
    """The candidate with the smallest error, and the comparison with the plain servo."""
    made: dict[str, _Exported] = {}
    errors: dict[str, float] = {}
    for kind, make in candidates.items():
        made[kind] = make()
        if len(candidates) == 1:
            return made[kind], []
        errors[kind] = error(made[kind].joint, name, [*data.fitted, *data.scored])
        if errors[kind] < NEGLIGIBLE_RAD and which != "plain":
            return made[kind], []
    best, *others = (kind for kind in candidates if kind != "plain")
    for kind in others:
        best = kind if errors[kind] < _BETTER * errors[best] else best
    if "plain" not in candidates:
        return made[best], []
    plain = which == "plain" or (which == "nearest" and errors["plain"] < _BETTER * errors[best])
    what = "the recordings" if data.scored else "the full model"
    compared = Compared(name, plain, errors[best], errors["plain"], what)
    return made["plain" if plain else best], [compared]


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
    """What the target lacks: fitted effects, ``BEYOND_LIMIT``, and ``motor.NAME`` for losses."""
    effects = {
        fitted.effect
        for fitted in joint.effects
        if fitted.effect not in has and named(fitted.effect).fitted
    }
    if joint.motor.get("stall_torque_Nm") and SATURATION in has and BEYOND_LIMIT not in has:
        beyond = (e.parameters.get("free_damping") for e in joint.effects if e.effect == SATURATION)
        effects |= {BEYOND_LIMIT} if any(beyond) else set()
    terms = {key: effect for key, effect, _ in MOTOR_TERMS}
    losses = {key for key, value in joint.motor.items() if value and key not in _LINE}
    return effects | {f"motor.{key}" for key in losses if terms.get(key, f"motor.{key}") not in has}


def _replaceable(name: str) -> bool:
    """Whether other parameters of the servo may replace an effect or a loss of the motor."""
    if name.startswith("motor.") or name == BEYOND_LIMIT:
        return True
    effect = named(name)
    return effect.fitted and not effect.load and not (effect.site == "sensor" and effect.steady)


def _shown(joint: JointModel, effect: str) -> str:
    if effect.startswith("motor."):
        return f"{effect} ({joint.motor[effect.removeprefix('motor.')]:.6g})"
    if effect == BEYOND_LIMIT:
        return f"{effect}, damping beyond the limit"
    values = next(fitted.parameters for fitted in joint.effects if fitted.effect == effect)
    return f"{effect} ({', '.join(f'{n} = {x:.6g}' for n, x in values.items() if x)})"


def _moves(data: FittingData, joint: JointModel, part: str) -> float:
    """RMS change of the predicted motion by one effect or loss, rad: the larger of two sets.

    They are the standard excitation and the recordings.
    """
    load, changes = data.own[0].load, []
    for motions in (data.own, [*data.fitted, *data.scored] if data.scored else []):
        rows = (joint_row(one, load) for one in (joint, without(joint, {part})))
        full, reduced = (errors_of(row, motions) for row in rows)
        changes.append(rms([a - b for a, b in zip(full, reduced, strict=True)]) if full else 0.0)
    return max(changes)
