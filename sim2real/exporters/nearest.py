"""The nearest model that a target can express: missing effects are dropped, the rest refitted.

Gains that were fitted together with an effect are wrong without it: without its dead band, for
example, a servo is too stiff. A joint with effects (or losses of the motor) that a target lacks is
therefore refitted, to recordings or to predictions of the full model on a standard excitation. Of
several such models, the plain servo among them, the one with the smallest error is exported.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.exporters.actuator import BEYOND_LIMIT, MOTOR_TERMS, SATURATION, LeftOut, listed
from sim2real.identification.priors import gains, of_effects
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import errors_of, fit
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect, JointModel, Model, train_rotor, with_inertia
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import COLUMNS, CURRENT_LIMIT, LINE, SOFT, joint_row, stated
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import Trace, split, traces

SECONDS, REACH_RAD = 15.0, 0.6
"""Length of the standard excitation, and its largest set-point."""
NEGLIGIBLE_RAD = 1e-4
"""RMS change of the motion below which an effect is dropped without being listed: a fifteenth of a
count of a 12-bit encoder."""
BETTER = 0.99
"""Largest error of a model, relative to that of another, for it to be preferred."""
_DRY, _PLAIN = "coulomb_friction", "plain"
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
    # of the full model and of the refitted one on a held-out recording; None without recordings
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
    """RMS errors of a joint with the effects that the target expresses, and without any."""

    joint: str
    plain: bool  # whether the plain servo is exported
    effects_rad: float
    plain_rad: float
    what: str  # what both were compared with

    def __str__(self) -> str:
        """The errors in mrad, and how to export the other model."""
        effects, plain = (f"{1e3 * x:.2f} mrad RMS" for x in (self.effects_rad, self.plain_rad))
        names = ("plain servo", "effects") if self.plain else ("servo with effects", "plain")
        text = f"{self.joint}: {effects} from {self.what} with its effects, {plain} as a plain "
        return f"{text}servo: the {names[0]} is exported (--which {names[1]} for the other)"


@dataclass(frozen=True)
class Nearest:
    """A model that a target expresses, and parts of the full model that it lacks."""

    model: Model
    dropped: tuple[LeftOut, ...] = ()
    refits: tuple[Refit, ...] = ()
    compared: tuple[Compared, ...] = ()


@dataclass(frozen=True)
class FittingData:
    """Data for the refit of a joint."""

    own: list[Trace]  # predictions of its full model on the standard excitation
    fitted: list[Trace]  # recordings to fit, or ``own``
    scored: list[Trace]  # held-out recordings; empty without recordings
    held_out: str  # description of the held-out part


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
    load, which belongs to the link of the robot.

    ``expressed`` are effects of a joint, and ``motor.NAME``, beside the torque-speed line; a target
    with a current limit but not the damping beyond it has ``torque_saturation`` without
    ``BEYOND_LIMIT``. The last recording is held out, or the last quarter of a single one; without
    motion of a joint the predictions of the model are used. ``rough`` effects are simulated
    inaccurately and dropped if the error is smaller without them, ``costly`` limits beside a
    torque-speed line if no motion reaches them. ``InputError`` if the model has an unknown effect.
    """
    joints, found = dict(model.joints), Nearest(model)
    saturation = {SATURATION, BEYOND_LIMIT}
    for name, joint in model.joints.items():
        has = expressed(joint)
        lost = _lost(joint, has)
        every = lost | {e.effect for e in joint.effects if _replaceable(e.effect)}
        if not every:
            continue
        data = fitting_data(name, joint, recordings, robot)
        line = {key for key in LINE if joint.motor.get(key.removeprefix("motor."))}
        still = {x for x in every - line if _moves(data, joint, x) < NEGLIGIBLE_RAD}
        drops = {"as far as expressed": lost}
        if lost & saturation and line:  # a target with one limit may have that of the current
            drops["current limit"] = lost - saturation | line
        drops |= {"without rough effects": lost | every & set(rough), _PLAIN: every}
        different: dict[frozenset[str], str] = {}
        for kind, dropped in drops.items():
            different.setdefault(frozenset(dropped - still), kind)
        unreached = still & set(costly) if line else set()
        drops = {kind: drops[kind] | unreached for kind in different.values()}
        one = _Task(name, joint, data, still, SOFT[0] in has).best(drops, which, error)
        joints |= one.model.joints
        lines, refits = found.dropped + one.dropped, found.refits + one.refits
        found = Nearest(model, lines, refits, found.compared + one.compared)
    return replace(found, model=replace(model, joints=joints))


@dataclass(frozen=True)
class _Task:
    """A joint whose nearest model is looked for."""

    name: str
    joint: JointModel
    data: FittingData
    still: set[str]  # parts that hardly move it
    # whether friction of the target stops the shaft within a finite time, as a dead band damps
    soft: bool

    def best(self, drops: dict[str, set[str]], which: Which, error: Error) -> Nearest:
        """The model with the smallest error, and the comparison with the plain servo."""
        made: dict[str, Nearest] = {}
        errors: dict[str, float] = {}
        for kind, dropped in drops.items():
            made[kind] = self.without(dropped, dry=kind != _PLAIN)
            if len(drops) == 1:
                return made[kind]
            (servo,) = made[kind].model.joints.values()
            errors[kind] = error(servo, self.name, self.data.fitted + self.data.scored)
            if errors[kind] < NEGLIGIBLE_RAD and which != _PLAIN:
                return made[kind]
        best, *others = (kind for kind in drops if kind != _PLAIN)
        for kind in others:
            best = kind if errors[kind] < BETTER * errors[best] else best
        if _PLAIN not in drops:
            return made[best]
        plain = which == "plain" or (which == "nearest" and errors[_PLAIN] < BETTER * errors[best])
        what = "the recordings" if self.data.scored else "the full model"
        compared = Compared(self.name, plain, errors[best], errors[_PLAIN], what)
        return replace(made[_PLAIN if plain else best], compared=(compared,))

    def without(self, dropped: set[str], *, dry: bool) -> Nearest:
        """A joint without some parts; the rotor of a lost gear train turns with the load."""
        joint, data, lines = self.joint, self.data, list[LeftOut]()
        if SATURATION in dropped & self.still and joint.motor.get("stall_torque_Nm"):
            why = "no motion of the recordings or the standard excitation reaches it"
            lines.append(LeftOut(self.name, _shown(joint, SATURATION), why))
        replaced = sorted(part for part in dropped - self.still if _replaceable(part))
        if not replaced:
            servo = without(joint, dropped & self.still)
            return Nearest(Model({self.name: servo}), tuple(lines))
        why = "the other parameters were refitted to compensate for it; do not add it"
        lines += [LeftOut(self.name, _shown(joint, part), why) for part in replaced]
        moving, load = without(joint, self.still), data.own[0].load
        reduced = without(moving, replaced)
        row = self._refitted(reduced, dropped, dry=dry).row
        value = dict(zip(COLUMNS, row.tolist(), strict=True))
        names = dict.fromkeys(effect.effect for effect in reduced.effects)
        names |= {_DRY: None} if value[f"{_DRY}.torque_Nm"] > 0 else {}
        effects = [
            FittedEffect(name, {p.name: value[f"{name}.{p.name}"] for p in named(name).parameters})
            for name in names
        ]
        servo = stated(row, PER_INERTIA if joint.per_inertia else load, effects)
        servo = replace(servo, load=joint.load, inertia_kgm2=joint.inertia_kgm2)
        full, start = joint_row(moving, load), joint_row(reduced, load)
        recorded = None
        if data.scored:
            recorded = rms(errors_of(full, data.scored)), rms(errors_of(row, data.scored))
        full_rad, dropped_rad = (rms(errors_of(x, data.own)) for x in (row, start))
        cost = Refit(self.name, tuple(replaced), full_rad, dropped_rad, recorded, data.held_out)
        return Nearest(Model({self.name: servo}), tuple(lines), (cost,))

    def _refitted(self, joint: JointModel, lost: set[str], *, dry: bool) -> Fit:
        """A joint fitted to the data, with ``dry`` also with further friction if that is better."""
        data, load = self.data, self.data.own[0].load
        start = joint_row(joint, load)
        kept = [named(e.effect) for e in joint.effects if named(e.effect).fitted]
        free = [*gains(load.inertia_kgm2), *of_effects(kept, start, load.inertia_kgm2)]
        for key in (key for key, value in joint.motor.items() if value):
            size = float(start[COLUMNS.index(f"motor.{key}")])
            free.append(Parameter(f"motor.{key}", 0.1 * size, 10 * size, size))
        # the recordings may not reach the limits, as those of the full model may
        fixed = {*lost, *((*LINE, CURRENT_LIMIT, BEYOND_LIMIT) if data.scored else ())}
        free = [p for p in free if p.name not in fixed]
        best = fit(ServoProblem(data.fitted, start, tuple(free)), start[None], first=40)
        stages: list[tuple[Parameter, list[float]]] = []
        families = {named(fitted.effect).family for fitted in joint.effects}
        friction = named(_DRY)
        if dry and friction.family not in families and not joint.motor.get("coulomb_Nm"):
            (added,) = of_effects([friction], best.row, load.inertia_kgm2)
            size = scaled(friction.parameters[0], float(best.row[0]), load.inertia_kgm2).typical
            stages.append((added, [0.3 * size, size, 3 * size]))
        if dry and self.soft and not joint.motor.get("stick_time_s"):
            settles = load.inertia_kgm2 / max(float(best.row[1]), 1e-9)
            for name, least in zip(SOFT, (0.3, 0.1), strict=True):
                added = Parameter(name, 0.0, 1.0, 0.5 * settles)
                stages.append((added, [least * settles, settles]))
        candidate = best
        for added, sizes in stages:
            rows = np.tile(candidate.row, (len(sizes), 1))
            rows[:, COLUMNS.index(added.name)] = sizes
            parameters = (*candidate.parameters, added)
            candidate = fit(ServoProblem(data.fitted, candidate.row, parameters), rows, first=40)
            if rms(candidate.residuals) < BETTER * rms(best.residuals):
                best = candidate
        return best


def without(joint: JointModel, lost: Collection[str]) -> JointModel:
    """A joint without some parts; the rotor of a lost gear train turns with the load."""
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


def _shown(joint: JointModel, part: str) -> str:
    if part == BEYOND_LIMIT:
        return f"{part}, damping beyond the limit"
    if part.startswith("motor."):
        return f"{part} ({joint.motor[part.removeprefix('motor.')]:.6g})"
    return listed(part, next(e.parameters for e in joint.effects if e.effect == part))


def _moves(data: FittingData, joint: JointModel, part: str) -> float:
    """RMS change in rad by one part, the larger of standard excitation and recordings."""
    rows = [joint_row(one, data.own[0].load) for one in (joint, without(joint, {part}))]
    changes = []
    for motions in (data.own, data.fitted + data.scored) if data.scored else (data.own,):
        full, reduced = (errors_of(row, motions) for row in rows)
        changes.append(rms([a - b for a, b in zip(full, reduced, strict=True)]))
    return max(changes)


def fitting_data(
    name: str, joint: JointModel, recordings: Sequence[Recording], robot: Robot | None
) -> FittingData:
    """Data to refit a joint to: recordings in which it moves, else predictions of its model."""
    sheet = robot.joint(name) if robot else None
    reach = 0.9 * min(abs(x) for x in sheet.limits_rad) if sheet else REACH_RAD
    own = excitation(joint, name, min(reach, REACH_RAD))
    # the load that the gains of the model refer to, or that of the model where none is stated
    data = traces(recordings, name)
    if load := PER_INERTIA if joint.per_inertia else joint.load:
        own_loads = not joint.per_inertia
        data = [
            x if own_loads and x.load is not PER_INERTIA else replace(x, load=load) for x in data
        ]
    return FittingData(own, *(split(data, None) if data else (own, [], "")))


def excitation(joint: JointModel, name: str, reach_rad: float = REACH_RAD) -> list[Trace]:
    """Predictions of a joint on steps, a chirp of 0.1 to 2.5 Hz and a triangle, as traces."""
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
