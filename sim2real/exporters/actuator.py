"""The identified actuator in terms common to simulators, and lists of what a target lacks."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sim2real.errors import InputError
from sim2real.model import LAWS, JointModel, Model
from sim2real.robot import Joint, Robot
from sim2real.servo.parameters import TRAINS, joint_row

SATURATION = "torque_saturation"
BEYOND_LIMIT = f"{SATURATION}.free_damping"
"""Damping that acts beyond a limit of the current."""
_ROTOR = "rotor_inertia_kgm2"

MOTOR_TERMS = (
    (_ROTOR, "unmodelled_inertia", "inertia_kgm2"),
    ("coulomb_Nm", "coulomb_friction", "torque_Nm"),
)
"""Parameters of the law ``motor`` that an effect of the catalogue also has."""

LACKS = {
    "gravity_load": "add the weight to the link",
    "sensor_offset": "add it to the observation",
    "sensor_gain": "scale the observation",
    "encoder_quantization": "round the observation",
    "packet_loss": "omit actions in the environment",
}
"""Why a target lacks effects that no refit replaces, where it has no reason of its own."""


@dataclass(frozen=True)
class Actuator:
    """One servo: a drive with a delay, its shaft, and further effects.

    The torque of the drive is ``clip(kp (command - position) - kd velocity, -limit, limit) -
    back_emf velocity``; the linear law has neither limit nor back-EMF.
    """

    joint: str
    kp: float  # proportional gain, N m/rad
    kd: float  # derivative gain inside the drive's limit, N m s/rad
    latency: float  # time from sending a set-point to its effect, s
    inertia: float  # inertia of the load on the output shaft, kg m2
    # damping outside the limit, N m s/rad; 0 with the law ``pd``. With ``motor`` it is the slope of
    # the torque-speed line, and ``kd`` the remaining gain, negative where the line damps more than
    # the servo does
    back_emf: float = 0.0
    # largest torque of the drive in N m, None if no limit was identified
    limit: float | None = None
    # torque of the horizontal pendulum of the load, N m; it hangs down at position 0
    gravity: float = 0.0
    per_inertia: bool = False  # the load was not known: gains are per kg m2 and ``inertia`` is 1
    # parameters of the other effects by name, in the catalogue's units; with a limit that is the
    # motor's own also ``torque_saturation``
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # remaining parameters of the law ``motor``
    motor: Mapping[str, float] = field(default_factory=dict)
    sheet: Joint | None = None  # limits and data sheet of the joint, if a robot was given

    def value(self, effect: str, parameter: str) -> float:
        """A parameter of an effect, 0 if the joint does not have it."""
        return self.effects.get(effect, {}).get(parameter, 0.0)

    @property
    def train_rotor(self) -> float:
        """Inertia of the rotor in kg m2 that a gear train states; 0 where none does."""
        return self.value("backlash", _ROTOR) or self.value("compliance", _ROTOR)

    @property
    def beyond_load(self) -> float:
        """Inertia in kg m2 beyond that of the stated load, see ``parameters.beyond_load``."""
        return self.value("unmodelled_inertia", "inertia_kgm2") + self.train_rotor

    @property
    def armature(self) -> float:
        """Inertia that the stated load leaves out, kg m2; 0 where it is negative."""
        return max(self.beyond_load, 0.0)

    @property
    def friction(self) -> float:
        """Dry friction, N m."""
        return self.value("coulomb_friction", "torque_Nm")

    @property
    def current_limit(self) -> float | None:
        """Limit of the torque at any speed in N m, below that of the drive; None without."""
        return self.effects.get(SATURATION, {}).get("limit_Nm")

    @property
    def largest_torque(self) -> float:
        """Largest torque at any speed, N m; braking adds the back-EMF to the stall torque."""
        braking = 2 * (self.limit or 0.0)
        return braking if self.current_limit is None else min(self.current_limit, braking)

    @property
    def damping_beyond(self) -> float:
        """Damping beyond the limit of the torque at any speed, N m s/rad."""
        return self.value(SATURATION, "free_damping") * (self.kd + self.back_emf)

    @property
    def unlimited_damping(self) -> float:
        """Damping that a limit of the drive leaves, N m s/rad; without a limit all of it."""
        return self.kd + self.back_emf if self.limit is None else self.back_emf

    @property
    def passive_damping(self) -> float:
        """Damping of the joint in N m s/rad: that of the back-EMF, at most the whole."""
        return max(min(self.back_emf, self.kd + self.back_emf), 0.0)

    @property
    def stall_torque(self) -> float | None:
        """Identified torque limit, else that of the data sheet, N m."""
        if self.limit is not None:
            return self.limit
        return self.sheet.servo.max_torque_Nm if self.sheet else None

    @property
    def no_load_speed(self) -> float | None:
        """Identified no-load speed, else that of the data sheet, rad/s."""
        if self.limit is not None and self.back_emf > 0:
            return self.limit / self.back_emf
        return self.sheet.servo.no_load_speed_rad_s if self.sheet else None

    def stop(self, shortest_s: float = 0.0) -> tuple[float, float]:
        """Time constant, at least ``shortest_s``, and impedance of friction that stops the shaft.

        Those of MuJoCo's soft constraint: with impedance d and time constant T the shaft stops in
        ``T d / 2`` and creeps with the time constant ``T (1 - d) / 2``. Source: MuJoCo's
        documentation, Computation, Constraint model, where the former is 1 / b.
        """
        stick, creep = (self.motor.get(name, 0.0) for name in ("stick_time_s", "creep_time_s"))
        if not stick:
            return shortest_s, RIGID
        impedance = min(max(stick / (stick + creep), 0.0001), RIGID)
        return max(2 * stick / impedance, shortest_s), impedance


RIGID = 0.9999
"""Largest impedance of a constraint in MuJoCo."""


@dataclass(frozen=True)
class LeftOut:
    """A part of the model that the target does not express, or only partly."""

    component: str
    what: str
    why: str

    def __str__(self) -> str:
        return f"{self.component}: {self.what}: {self.why}"


@dataclass(frozen=True)
class Export:
    """A text for another simulator, and what it does not express (also listed in the text)."""

    text: str
    left_out: tuple[LeftOut, ...]
    # of servos: ``compared`` and ``refitted`` joints, and ``agreement`` where the simulator was run
    errors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    beside: Mapping[str, str] = field(default_factory=dict)  # further texts by ending of their file

    def files(self, out: Path) -> dict[Path, str]:
        """The texts by the files that they are written to: ``out``, and those beside it."""
        return {out: self.text} | {out.with_suffix(end): x for end, x in self.beside.items()}

    def __str__(self) -> str:
        """What is not expressed, and the errors, one line each."""
        title = ["not expressed there (the file says so too):"] if self.left_out else []
        lines = [f"  {line}" for line in self.left_out]
        return "\n".join([*title, *lines, *(str(x) for rows in self.errors.values() for x in rows)])


def actuators(model: Model, robot: Robot | None = None) -> tuple[Actuator, ...]:
    """The servos of a model, in its order; limits that were not identified are the robot's.

    ``InputError`` if the model has no joint, the robot lacks a joint of the model, a law is
    unknown, or as of ``joint_row``.
    """
    if not model.joints:
        raise InputError("model", "joints", "none", "at least one identified joint")
    sheets = {joint.name: joint for joint in robot.joints} if robot else {}
    if robot and (lacking := [name for name in model.joints if name not in sheets]):
        expected = f"the model's joint {lacking[0]} among them"
        raise InputError(robot.path or robot.name, "joints", ", ".join(sheets), expected)
    return tuple(actuator(name, one, sheets.get(name)) for name, one in model.joints.items())


def actuator(name: str, joint: JointModel, sheet: Joint | None = None) -> Actuator:
    """One servo; other laws of the drive become kd, limit and back-EMF, which all targets have."""
    if joint.law not in LAWS:
        expected = f"one of {', '.join(LAWS)}"
        raise InputError("model", f"joints.{name}.law", repr(joint.law), expected)
    joint_row(joint, joint.load, f"model, {name}", alone=False)  # checks names and signs
    motor = {key: value for key, value in joint.motor.items() if value}
    effects = {e.effect: dict(e.parameters) for e in joint.effects if any(e.parameters.values())}
    trains = [e for e in TRAINS if effects.get(e, {}).get(_ROTOR)]
    for key, effect, parameter in MOTOR_TERMS:
        if key in motor:
            if key == _ROTOR and trains:  # both are inertia of the rotor
                effect, parameter = trains[0], _ROTOR
            values = effects.setdefault(effect, {})
            values[parameter] = values.get(parameter, 0.0) + motor.pop(key)
    limit, speed = motor.pop("stall_torque_Nm", None), motor.pop("no_load_speed_rad_s", None)
    if limit is not None:
        back_emf = limit / speed if speed else joint.kd_Nms_per_rad
    else:
        saturation = effects.pop(SATURATION, {})
        limit = saturation.get("limit_Nm")
        back_emf = saturation.get("free_damping", 0.0) * joint.kd_Nms_per_rad
    load = None if joint.per_inertia else joint.load
    return Actuator(
        joint=name,
        kp=joint.kp_Nm_per_rad,
        kd=joint.kd_Nms_per_rad - back_emf,
        back_emf=back_emf,
        latency=joint.latency_s,
        inertia=load.inertia_kgm2 if load else joint.inertia_kgm2,
        gravity=load.gravity_Nm if load else 0.0,
        limit=limit,
        per_inertia=joint.per_inertia,
        effects=effects,
        motor=motor,
        sheet=sheet,
    )


def limit_effects(joint: JointModel) -> set[str]:
    """The effect that every target expresses as the limit of the drive, if the motor has none."""
    return set() if joint.motor.get("stall_torque_Nm") else {SATURATION, BEYOND_LIMIT}


def listed(effect: str, values: Mapping[str, float]) -> str:
    """An effect with its parameters that are not 0."""
    return f"{effect} ({', '.join(f'{name} = {x:.6g}' for name, x in values.items() if x)})"


def left_out(
    servo: Actuator, target: str, has: Iterable[str], lacks: Mapping[str, str]
) -> list[LeftOut]:
    """What a target with these effects and reasons (beside ``LACKS``) does not express.

    Losses of the motor that it lacks are not in the model: `nearest` replaces them.
    """
    lines = []
    if servo.per_inertia:
        why = "the load was not known, so gains and torques are per kg m2 of inertia on the shaft"
        lines.append(LeftOut(servo.joint, "unit of the gains", why))
    for effect, values in servo.effects.items():
        if effect not in has:
            why = (LACKS | dict(lacks)).get(effect, f"{target} has no equivalent")
            lines.append(LeftOut(servo.joint, listed(effect, values), why))
    return lines


def limit_with_back_emf(servo: Actuator, damping: str) -> tuple[Actuator, list[LeftOut]]:
    """The actuator with its back-EMF inside the limit where its controller reduces the damping."""
    if servo.kd >= 0:
        return servo, []
    why = f"{damping} cannot be negative: the limit applies to the sum of drive and back-EMF"
    moved = replace(servo, kd=servo.kd + servo.back_emf, back_emf=0.0)
    return moved, [LeftOut(servo.joint, "a drive that clips before the back-EMF", why)]


def shared_left_out(model: Model) -> list[LeftOut]:
    """Effects on supply, link and body, which the actuator of one joint cannot express."""
    why = "it belongs to no single joint, and predict does not include it either"
    active = [fitted for fitted in model.effects if any(fitted.parameters.values())]
    shared = [LeftOut("robot", fitted.effect, why) for fitted in active]
    if any(model.body.values()):
        shared.append(LeftOut("robot", "body", "only the actuators are exported"))
    return shared


def comment(lines: Sequence[str], mark: str = "# ") -> str:
    """Lines as comments of a program; line breaks within a line are replaced by spaces."""
    return "".join(f"{mark}{' '.join(line.splitlines())}".rstrip() + "\n" for line in lines)


def head(lines: Sequence[LeftOut], what: str = "Actuators identified") -> list[str]:
    """Lines for the head of an exported file: what it is, and what it does not express."""
    title = f"{what} by sim2real; SI units, radians."
    if not lines:
        return [title, "Everything that was identified is expressed."]
    return [title, "Not expressed here:", *(f"  {line}" for line in lines)]
