"""The simulators and formats that actuators are exported to, and what each expresses."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.exporters.actuator import (
    SATURATION,
    Actuator,
    Export,
    LeftOut,
    actuators,
    comment,
    head,
    left_out,
    limit_effects,
    limit_with_back_emf,
    shared_left_out,
)
from sim2real.exporters.casadi_function import HAS as CASADI
from sim2real.exporters.casadi_function import casadi_c_text, casadi_text
from sim2real.exporters.mujoco import HAS, expressed, mujoco, xml_text
from sim2real.exporters.mujoco_bench import Agreement, mujoco_export
from sim2real.exporters.nearest import Which, excitation, nearest, rollout_error
from sim2real.exporters.python_texts import (
    PLAY,
    bam_text,
    genesis_text,
    isaaclab_text,
    mjlab_text,
    newton_text,
    numbers,
    usd_text,
)
from sim2real.model import JointModel, Model
from sim2real.output import finite_json
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import SOFT

FRICTION_AND_ROTOR = ("coulomb_friction", "unmodelled_inertia")
"""Effects that every target expresses."""
STEPS = ("fractions of a step of the latency", "a delay is a whole number of physics steps")
INERTIA_ONLY = "the link here has inertia only"
JITTER = "part of latency_jitter"
EACH_STEP = "the delay is drawn at each physics step, not for each set-point"

Lines = Sequence[LeftOut]
Text = Callable[[Sequence[Actuator], Robot | None, Lines], str]


def _of_the_link(servo: Actuator) -> list[LeftOut]:
    """Inertia that a target with an armature leaves to the link."""
    lines, load = [], f"inertia of the load ({servo.inertia:.6g} kg m2)"
    if servo.beyond_load < 0:
        why = "an armature cannot be negative; subtract it from the link's inertia"
        lines.append(LeftOut(servo.joint, "unmodelled_inertia", why))
    return [*lines, LeftOut(servo.joint, load, "it belongs to the link")]


@dataclass(frozen=True)
class Target:
    """A simulator or format that actuators are exported to."""

    name: str  # in sentences
    text: Text  # of servos, the robot or None as source of limits, and lines to be listed
    has: Sequence[str] = FRICTION_AND_ROTOR  # effects of the catalogue, ``motor.NAME``
    # of ``latency`` and effects that it expresses in part: what it lacks, and why
    partly: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    lacks: Mapping[str, str] = field(default_factory=dict)  # why it lacks an effect, see `LACKS`
    damping: str = ""  # name of a drive's damping, if it is apart from the back-EMF
    also: Callable[[Actuator], list[LeftOut]] = _of_the_link  # what else it lacks
    beside: Mapping[str, Text] = field(default_factory=dict)  # further files by their ending

    def expressed(self, joint: JointModel) -> set[str]:
        """What it expresses of one joint, with the limit of its drive."""
        return {*self.has, *limit_effects(joint)}

    def write(self, model: Model, robot: Robot | None = None, dropped: Lines = ()) -> Export:
        """The text of a model's actuators; ``dropped`` are parts to be listed as well."""
        servos: list[Actuator] = []
        lines: list[LeftOut] = []
        for servo in actuators(model, robot):
            if self.damping:
                servo, moved = limit_with_back_emf(servo, self.damping)
                lines += moved
            servos.append(servo)
            lines += left_out(servo, self.name, self.has, self.lacks)
            values = {"latency": servo.latency, **servo.effects}
            for part, (what, why) in self.partly.items():
                if values.get(part):
                    lines.append(LeftOut(servo.joint, what.format(values[part]), why))
            lines += self.also(servo)
        lines += [*dropped, *shared_left_out(model)]
        beside = {ending: text(servos, robot, lines) for ending, text in self.beside.items()}
        return Export(self.text(servos, robot, lines), tuple(lines), beside=beside)


class MuJoCo:
    """MuJoCo, whose file has a bench for each joint, as a target."""

    has, expressed, write = HAS, staticmethod(expressed), staticmethod(mujoco)
    partly: Mapping[str, tuple[str, str]] = {}


def _python(text: Callable[[Sequence[Actuator]], str]) -> Text:
    """Text of a program, below comments on what it does not express."""
    return lambda servos, _, lines: comment(head(lines)) + text(servos)


def _urdf_text(servos: Sequence[Actuator], robot: Robot | None, lines: Lines) -> str:
    """A URDF (http://wiki.ros.org/urdf/XML) with one link on each joint; see the README here."""
    root = Element("robot", name=robot.name if robot else "sim2real")
    SubElement(root, "link", name="bench")
    for servo in servos:
        kind = "revolute" if servo.sheet else "continuous"  # without limits, of which it needs all
        joint = SubElement(root, "joint", name=servo.joint, type=kind)
        SubElement(joint, "parent", link="bench")
        SubElement(joint, "child", link=f"{servo.joint}_link")
        SubElement(joint, "axis", xyz="0 1 0")
        losses = numbers(damping=servo.passive_damping, friction=servo.friction)
        SubElement(joint, "dynamics", losses)
        if servo.sheet is not None:
            low, high = servo.sheet.limits_rad
            effort, velocity = servo.stall_torque, servo.no_load_speed
            limits = numbers(lower=low, upper=high, effort=effort, velocity=velocity)
            SubElement(joint, "limit", limits)
        inertial = SubElement(SubElement(root, "link", name=f"{servo.joint}_link"), "inertial")
        SubElement(inertial, "mass", value="0.1")
        moment = servo.inertia + servo.beyond_load
        terms = numbers(ixx=moment, iyy=moment, izz=moment, ixy=0.0, ixz=0.0, iyz=0.0)
        SubElement(inertial, "inertia", terms)
    return f'<?xml version="1.0"?>\n{xml_text(root, lines)}'


def _not_in_urdf(servo: Actuator) -> list[LeftOut]:
    damping = servo.passive_damping
    kd = servo.kd + servo.back_emf - damping
    there = "a URDF has no controller; set it there"
    beside = f"{there}, in addition to the damping of {damping:.6g} N m s/rad in the joint"
    limit = servo.limit if servo.limit is not None and servo.sheet is None else 0.0
    clipped = damping if servo.back_emf > damping else 0.0
    limits = "a URDF has it only with limits of angle and speed, which a robot file contains"
    below = "only below the limit of the drive; at the limit the damping is "
    below += f"{servo.back_emf:.6g} N m s/rad"
    added = "a URDF has no armature: it is added to the inertia of the link here; do so for yours"
    rows = (
        ("kp", servo.kp, "N m/rad", there),
        ("kd", kd if abs(kd) > 1e-9 * damping else 0.0, "N m s/rad", beside if damping else there),
        ("latency", servo.latency, "s", there),
        ("torque limit", limit, "N m", limits),
        ("damping", clipped, "N m s/rad", below),
        ("pendulum", servo.gravity, "N m", INERTIA_ONLY),
        ("unmodelled_inertia", servo.beyond_load, "kg m2", added),
    )
    return [
        LeftOut(servo.joint, f"{name} ({value:.6g} {unit})", why)
        for name, value, unit, why in rows
        if value
    ]


def _not_in_bam(servo: Actuator) -> list[LeftOut]:
    lines = _of_the_link(servo)
    if servo.limit and servo.back_emf > 0 and abs(servo.kd) > 1e-9 * servo.back_emf:
        what = f"damping in the drive ({servo.kd:.6g} N m s/rad)"
        why = "the drive is proportional: it is added to the back-EMF, at the limit as well"
        lines.append(LeftOut(servo.joint, what, why))
    slow = servo.motor.get("stribeck_speed_rad_s", 0.0)
    if slow and servo.value("stribeck_friction", "velocity_rad_s") not in (0.0, slow):
        what, why = f"motor.stribeck_speed_rad_s ({slow:.6g})", "all friction falls at the one of "
        lines.append(LeftOut(servo.joint, what, why + "stribeck_friction"))
    return lines


LAW = (
    "torque = clip(kp (command(t - latency) - position) - kd velocity, -limit, limit)"
    " - back_emf velocity"
)


def _json_text(servos: Sequence[Actuator], _: Robot | None, lines: Lines) -> str:
    """JSON with all identified parameters of the joints, and the law as a formula."""
    joints: dict[str, dict[str, Any]] = {}
    for servo in servos:
        joints[servo.joint] = {
            "kp_Nm_per_rad": servo.kp,
            "kd_Nms_per_rad": servo.kd,
            "back_emf_Nms_per_rad": servo.back_emf,
            "limit_Nm": servo.limit,
            "latency_s": servo.latency,
            "inertia_kgm2": servo.inertia,
            "gravity_Nm": servo.gravity,
            "per_inertia": servo.per_inertia,
            "motor": servo.motor,
            "effects": [{"effect": n, "parameters": values} for n, values in servo.effects.items()],
        }
        if servo.sheet is not None:
            sheet = vars(servo.sheet.servo)
            joints[servo.joint]["limits_rad"] = list(servo.sheet.limits_rad)
            joints[servo.joint]["data_sheet"] = {n: sheet[n] for n in sheet if n != "where"}
    content = {"schema": "sim2real.actuators/1", "law": LAW, "joints": joints}
    content["not_expressed"] = [str(line) for line in lines]
    return json.dumps(finite_json(content), indent=2, allow_nan=False) + "\n"


TARGETS: Mapping[str, Target | MuJoCo] = {
    "mujoco": MuJoCo(),
    "isaaclab": Target(
        "Isaac Lab",
        _python(isaaclab_text),
        (*FRICTION_AND_ROTOR, "latency_jitter", "stribeck_friction", SATURATION),
        {
            "latency": STEPS,
            "latency_jitter": (JITTER, "the delay is drawn at a reset, not for each set-point"),
            "stribeck_friction": (
                "velocity_rad_s of stribeck_friction", "friction drops as soon as the joint moves",
            ),
        },
    ),
    "isaaclab-bam": Target(
        "Isaac Lab's DriveBam",
        _python(bam_text),
        (
            *FRICTION_AND_ROTOR, "backlash", "latency_jitter", "stribeck_friction", SATURATION,
            "voltage_sag", "motor.motor_friction", "motor.load_friction",
            *(f"motor.stribeck_{n}" for n in ("motor_friction", "load_friction", "speed_rad_s")),
        ),
        {
            "latency": STEPS,
            "latency_jitter": (JITTER, EACH_STEP),
            "backlash": (
                f"a hinge {PLAY.format('JOINT')} with play of {{0[gap_rad]:.6g}} rad",
                "add it to the asset, between the joint's link and what that turns",
            ),
            "voltage_sag": (
                "part of voltage_sag", "it follows the torque of the step before, back-EMF included"
            ),
        },
        also=_not_in_bam,
    ),
    "mjlab": Target(
        "mjlab",
        _python(mjlab_text),
        (*FRICTION_AND_ROTOR, "latency_jitter", *SOFT),
        {"latency": STEPS, "latency_jitter": (JITTER, EACH_STEP)},
        damping="damping",
    ),
    "newton": Target(
        "Newton",
        _python(newton_text),
        (*FRICTION_AND_ROTOR, *SOFT, SATURATION),
        {"latency": STEPS},
        {"latency_jitter": "a delay is constant"},
    ),
    "usd": Target(
        "Newton",
        lambda servos, _, lines: usd_text(servos, comment(head(lines))),
        (*FRICTION_AND_ROTOR, *SOFT, SATURATION),
        {"latency": STEPS},
        {"gravity_load": f"{INERTIA_ONLY}; add the weight to your link"},
        also=lambda servo: [],
    ),
    "genesis": Target(
        "Genesis",
        _python(genesis_text),
        partly={"latency": (
            "latency ({:.6g} s)", "position control has no delay; delay the set-points by this time"
        )},
    ),
    "casadi": Target(
        "CasADi", casadi_text, CASADI,
        {"latency": (
            "latency ({:.6g} s)", "set-points are those in force; delay yours by this time"
        )},
        also=lambda servo: [], beside={".c": casadi_c_text},
    ),
    "urdf": Target(
        "URDF", _urdf_text, lacks={"gravity_load": f"{INERTIA_ONLY}; add the weight to your link"},
        also=_not_in_urdf,
    ),
    "json": Target(
        "JSON", _json_text, [e.name for e in CATALOGUE], also=lambda servo: []
    ),
}  # fmt: skip
"""By the name that ``export-servo --to`` takes."""


def export_servos(
    model: Model, to: str, recordings: Sequence[Recording], robot: Robot | None, which: Which
) -> Export:
    """The model's actuators for ``to``, refitted without effects that it lacks (``nearest``)."""
    for recording in recordings:
        if not set(recording.joints) & set(model.joints):
            found = f"joints {', '.join(recording.joints)}"
            raise InputError(recording.file, "joints", found, f"one of {', '.join(model.joints)}")
    target = TARGETS[to]
    if to == "json":  # which has everything
        return target.write(model, robot)
    differences: Sequence[Agreement | Cost]
    if to == "mujoco":
        export, fitted, differences = mujoco_export(model, recordings, robot, which)
    else:
        fitted = nearest(model, target.expressed, recordings, robot, which=which)
        export = target.write(fitted.model, robot, fitted.dropped)
        whole, proportional = target.partly.get("latency") is STEPS, to == "isaaclab-bam"
        differences = costs(fitted.model, whole_steps=whole, proportional=proportional)
    errors = {"compared": fitted.compared, "refitted": fitted.refits, "agreement": differences}
    return replace(export, errors=errors)


@dataclass(frozen=True)
class Cost:
    """RMS differences from the exported model on standard steps, a chirp and a triangle."""

    joint: str
    what: str
    errors_rad: Mapping[str, float]  # by time step, or of all

    def __str__(self) -> str:
        """The differences in mrad."""
        errors = (f"{1e3 * error:.2f} mrad RMS{at}" for at, error in self.errors_rad.items())
        return f"{self.joint}: {self.what}: {', '.join(errors)}"


def costs(model: Model, *, whole_steps: bool, proportional: bool) -> tuple[Cost, ...]:
    """The cost of delays that are whole physics steps, and of a drive without damping of its own.

    That damping is then the motor's, and the no-load speed the stall torque over the damping.
    """
    found = []
    for name, joint in model.joints.items():
        data, latency, kd = excitation(joint, name), joint.latency_s, joint.kd_Nms_per_rad
        motor, changes = joint.motor, dict[str, dict[str, JointModel]]()
        if whole_steps and latency > 0:
            steps = {s: round(latency / s) * s for s in (0.001, 0.002, 0.005)}
            changes[f"delay of {1e3 * latency:.1f} ms as whole physics steps"] = {
                f" at {1e3 * s:g} ms": replace(joint, latency_s=x) for s, x in steps.items()
            }
        stall = motor.get("stall_torque_Nm", 0.0)
        if proportional and stall * motor.get("no_load_speed_rad_s", 0.0) * kd > 0:
            line = {**motor, "no_load_speed_rad_s": stall / kd}
            changes["damping of the drive added to the back-EMF"] = {"": replace(joint, motor=line)}
        for what, changed in changes.items():
            errors = {at: rollout_error(one, name, data) for at, one in changed.items()}
            found.append(Cost(name, what, errors))
    return tuple(found)
