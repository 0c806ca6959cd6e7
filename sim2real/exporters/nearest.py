"""The nearest model that a target can express: missing effects are dropped, the rest refitted.

Gains that were fitted together with an effect are wrong without it: without its dead band, for
example, a servo is too stiff. A joint with effects (or losses of the motor) that a target lacks is
therefore refitted without them, to recordings, or without recordings to the predictions of the full
model on a standard excitation. Of several such models, the plain servo without any effect among
them, the one with the smallest error on these data is exported.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from sim2real.effects import named
from sim2real.exporters.actuator import BEYOND_LIMIT, MOTOR_TERMS, SATURATION, LeftOut
from sim2real.exporters.refit import BETTER, STICKS, FittingData, fitting_data, refitted, without
from sim2real.identification.search import errors_of
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import LINE, joint_row
from sim2real.servo.trace import Trace

NEGLIGIBLE_RAD = 1e-4
"""RMS change of the motion below which an effect is dropped without being listed: a fifteenth of a
count of a 12-bit encoder."""
_PLAIN = "plain"
Which = Literal["nearest", "effects", "plain"]
"""Models that can be chosen: the one with the smaller error, with effects, or without any."""
Error = Callable[[JointModel, str, Sequence[Trace]], float]
"""RMS error in rad of a joint of this name on traces, in a target."""


@dataclass(frozen=True)
class Refit:
    """Errors of one joint that was refitted without effects that the target lacks."""

    joint: str
    dropped: tuple[str, ...]  # names of the dropped effects
    full_rad: float  # RMS difference of the refitted joint from the full model
    dropped_rad: float  # RMS difference without refit of the other parameters
    # RMS errors on a held-out recording, of the full model and of the refitted one; None without
    # recordings
    recorded_rad: tuple[float, float] | None = None
    held_out: str = ""  # that recording

    def __str__(self) -> str:
        """The errors in mrad."""
        names = ", ".join(self.dropped)
        text = f"{self.joint}: refitted without {names}: {1e3 * self.full_rad:.2f} mrad RMS from "
        text += f"the full model ({1e3 * self.dropped_rad:.2f} without refit)"
        if self.recorded_rad is not None:
            full, exported = (1e3 * x for x in self.recorded_rad)
            text += f"; on {self.held_out}, held out: {exported:.2f} mrad as exported, "
            text += f"{full:.2f} of the full model"
        return text


@dataclass(frozen=True)
class Compared:
    """Errors of a joint as exported and of the alternative, with effects and without any."""

    joint: str
    plain: bool  # whether the plain servo is exported
    effects_rad: float  # RMS error with the effects that the target expresses
    plain_rad: float  # RMS error of the plain servo
    what: str  # what both were compared with

    def __str__(self) -> str:
        """The errors in mrad, and how to export the other model."""
        effects, plain = (f"{1e3 * x:.2f} mrad RMS" for x in (self.effects_rad, self.plain_rad))
        names = ("plain servo", "effects") if self.plain else ("servo with effects", "plain")
        text = f"{self.joint}: {effects} from {self.what} with its effects, {plain} as a plain "
        return f"{text}servo: the {names[0]} is exported (--which {names[1]} for the other)"


@dataclass(frozen=True)
class Nearest:
    """A model that a target expresses."""

    model: Model
    # parts of the full model that it lacks, for the head of an exported file
    dropped: tuple[LeftOut, ...]
    refits: tuple[Refit, ...]  # errors of the refitted joints
    compared: tuple[Compared, ...] = ()  # errors of joints with effects, and of the plain servo


@dataclass(frozen=True)
class _Reduced:
    """A joint that a target expresses, and what it lacks of the full one."""

    joint: JointModel
    dropped: Sequence[LeftOut]
    refit: Refit | None = None


def rollout_error(joint: JointModel, name: str, data: Sequence[Trace]) -> float:
    """RMS difference of a joint's law from the used samples of traces, rad."""
    return rms(errors_of(joint_row(joint, data[0].load, where=name), data))


def nearest(
    model: Model,
    expressed: Callable[[JointModel], Collection[str]],
    recordings: Sequence[Recording] = (),
    robot: Robot | None = None,
    *,
    which: Which = "nearest",
    rough: Collection[str] = (),
    costly: Collection[str] = (),
    error: Error = rollout_error,
) -> Nearest:
    """The model without the effects that a target lacks, with its other parameters refitted.

    Effects that no other parameter can replace are kept, and the target lists them: those drawn for
    each set-point, errors of the angle sensor that depend only on the angle, and corrections of the
    load, which belongs to the link of the robot. ``InputError`` if the model has an unknown effect.

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
        error: RMS error in the target.
    """
    joints = dict(model.joints)
    dropped: list[LeftOut] = []
    refits: list[Refit] = []
    compared: list[Compared] = []
    for name, joint in model.joints.items():
        has = expressed(joint)
        lost = _lost(joint, has)
        if not lost and not any(_replaceable(fitted.effect) for fitted in joint.effects):
            continue
        data = fitting_data(name, joint, recordings, robot)
        drops, still = _drops(joint, lost, data, rough, costly)
        soft = STICKS in has
        best, others = _best(name, joint, drops, still, data, error, which, soft=soft)
        joints[name] = best.joint
        dropped += best.dropped
        refits += [best.refit] if best.refit else []
        compared += others
    return Nearest(replace(model, joints=joints), tuple(dropped), tuple(refits), tuple(compared))


def _drops(
    joint: JointModel,
    lost: set[str],
    data: FittingData,
    rough: Collection[str],
    costly: Collection[str],
) -> tuple[dict[str, set[str]], set[str]]:
    """Parts that models which the target expresses lack, and those that hardly move the joint.

    The last model is ``plain``, without effects, if that is another one.
    """
    effects = {fitted.effect for fitted in joint.effects}
    line = {name for name in LINE if joint.motor.get(name.removeprefix("motor."))}
    drops = {"as far as expressed": lost}
    saturation = {SATURATION, BEYOND_LIMIT}
    if lost & saturation and line:  # a target with one limit may have that of the current
        drops["current limit"] = lost - saturation | line
    if effects & set(rough):
        drops["without rough effects"] = lost | effects & set(rough)
    drops[_PLAIN] = lost | {effect for effect in effects if _replaceable(effect)}
    parts = set().union(*drops.values()) - line
    still = {part for part in parts if _moves(data, joint, part) < NEGLIGIBLE_RAD}
    unreached = still & set(costly) if line else set()
    different: dict[frozenset[str], str] = {}
    for kind, dropped in drops.items():
        different.setdefault(frozenset(dropped - still), kind)
    return {kind: drops[kind] | unreached for kind in different.values()}, still


def _best(
    name: str,
    joint: JointModel,
    drops: dict[str, set[str]],
    still: set[str],
    data: FittingData,
    error: Error,
    which: Which,
    *,
    soft: bool,
) -> tuple[_Reduced, list[Compared]]:
    """The joint with the smallest error, and the comparison with the plain servo."""
    made: dict[str, _Reduced] = {}
    errors: dict[str, float] = {}
    for kind, dropped in drops.items():
        made[kind] = _without(name, joint, dropped, still, data, dry=kind != _PLAIN, soft=soft)
        if len(drops) == 1:
            return made[kind], []
        errors[kind] = error(made[kind].joint, name, [*data.fitted, *data.scored])
        if errors[kind] < NEGLIGIBLE_RAD and which != _PLAIN:
            return made[kind], []
    best, *others = (kind for kind in drops if kind != _PLAIN)
    for kind in others:
        best = kind if errors[kind] < BETTER * errors[best] else best
    if _PLAIN not in drops:
        return made[best], []
    plain = which == "plain" or (which == "nearest" and errors[_PLAIN] < BETTER * errors[best])
    what = "the recordings" if data.scored else "the full model"
    compared = Compared(name, plain, errors[best], errors[_PLAIN], what)
    return made[_PLAIN if plain else best], [compared]


def _without(
    name: str,
    joint: JointModel,
    dropped: set[str],
    still: set[str],
    data: FittingData,
    *,
    dry: bool,
    soft: bool,
) -> _Reduced:
    """A joint without some parts, refitted if other parameters may replace them.

    Parts that hardly move it, ``still``, are dropped before a refit.
    """
    lines = []
    if SATURATION in dropped & still and joint.motor.get("stall_torque_Nm"):
        why = "no motion of the recordings or the standard excitation reaches it"
        lines.append(LeftOut(name, _shown(joint, SATURATION), why))
    replaced = sorted(part for part in dropped - still if _replaceable(part))
    if not replaced:
        return _Reduced(without(joint, dropped & still), lines)
    why = "the other parameters were refitted to compensate for it; do not add it"
    lines += [LeftOut(name, _shown(joint, part), why) for part in replaced]
    moving = without(joint, still)
    servo, start, best = refitted(moving, replaced, data, dry=dry, soft=soft)
    recorded = None
    if data.scored:
        full = joint_row(moving, data.own[0].load)
        recorded = rms(errors_of(full, data.scored)), rms(errors_of(best, data.scored))
    full_rad, dropped_rad = (rms(errors_of(row, data.own)) for row in (best, start))
    cost = Refit(name, tuple(replaced), full_rad, dropped_rad, recorded, data.held_out)
    return _Reduced(servo, lines, cost)


def _lost(joint: JointModel, has: Collection[str]) -> set[str]:
    """What the target lacks: fitted effects, ``BEYOND_LIMIT``, and ``motor.NAME`` for losses."""
    lost = {e.effect for e in joint.effects if e.effect not in has and named(e.effect).fitted}
    if joint.motor.get("stall_torque_Nm") and SATURATION in has and BEYOND_LIMIT not in has:
        beyond = (e.parameters.get("free_damping") for e in joint.effects if e.effect == SATURATION)
        lost |= {BEYOND_LIMIT} if any(beyond) else set()
    terms = {f"motor.{key}": effect for key, effect, _ in MOTOR_TERMS}
    losses = {f"motor.{key}" for key, value in joint.motor.items() if value} - {*LINE}
    return lost | {loss for loss in losses if terms.get(loss, loss) not in has}


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
