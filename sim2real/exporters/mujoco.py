"""The identified actuators as a MuJoCo model (MJCF): a bench with each joint on a shaft of its own.

Joint attributes and the ``<actuator>`` section carry over to a robot's own model; the bodies are
the load that the recordings were made with. Terms: https://mujoco.readthedocs.io, XML reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from sim2real.exporters.actuator import (
    Actuator,
    Export,
    LeftOut,
    actuators,
    left_out,
    listed,
    shared_left_out,
)
from sim2real.model import JointModel, Model
from sim2real.recording import GRAVITY_M_S2
from sim2real.robot import Robot
from sim2real.servo.parameters import SOFT

TIMESTEP_S = 0.00025
SHAFT_SHARE = 1 / 500  # of the inertia that stands on the motor's side of a spring

HAS = (
    "asymmetric_friction",
    "cogging",
    "command_filter",
    "compliance",
    "coulomb_friction",
    "gravity_load",
    "integral_action",
    "presliding_friction",
    "quadratic_drag",
    "rate_limit",
    "sensor_gain",
    "sensor_offset",
    "stribeck_friction",
    "unmodelled_inertia",
)
"""Effects of the catalogue that an MJCF file expresses."""

LACKS = {
    "torque_saturation": "the motor's own limit is the actuator's forcerange",
    "backlash": "a loose body within stops crosses the play otherwise where torques are small",
    "load_friction": "MuJoCo's frictionloss is a constant torque",
    "torque_asymmetry": "an actuator has one gain for both directions",
    "sensor_eccentricity": "add a wave of the angle to the observation",
    "deadband": "an actuator's bias is linear in the angle",
    "punch": "an actuator's bias is linear in the angle",
    "acceleration_limit": "its slewmax limits the speed of a set-point only",
    "encoder_quantization": "sensors are continuous; round the reading",
    "sensor_filter": "sensors have no dynamics; filter the reading",
    "latency_jitter": "a delay is constant; delay each set-point by a time of its own",
    "packet_loss": "it is up to the program that sets ctrl to leave set-points out",
    "clock_drift": "a delay is constant",
    "thermal_derating": "gains do not change while it runs",
    "supply_droop": "gains do not change while it runs",
    "voltage_sag": "a gain does not depend on the torque",
}


def expressed(joint: JointModel) -> set[str]:
    """Effects of a joint that an MJCF file expresses; a ``pid`` has no filter of its commands."""
    has = {*HAS, "torque_saturation", *SOFT}
    names = {fitted.effect for fitted in joint.effects}
    return has - {"command_filter"} if names & {"integral_action", "rate_limit"} else has


def mujoco(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """An MJCF model of a fitted model's actuators.

    ``pid`` and ``dcmotor`` elements need MuJoCo 3.12, polynomial damping 3.7 and delays 3.5. Where
    an older one is installed the model has no delays; `mujoco_bench.simulate` then holds commands
    back itself, and shows how.

    Args:
        model: The fitted model.
        robot: Gives the joints' limits, as their ``range``, if there is one.
        dropped: What the model had more, for the file to list, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    given = actuators(model, robot)
    root = Element("mujoco", model="sim2real")
    SubElement(root, "compiler", angle="radian")
    SubElement(
        root,
        "option",
        timestep=_text(TIMESTEP_S),
        integrator="implicitfast",
        gravity=_text(0, 0, -GRAVITY_M_S2),
    )
    parts = {name: Element(name) for name in ("worldbody", "tendon", "actuator", "sensor")}
    custom = SubElement(root, "custom")
    lines: list[LeftOut] = []
    for whole in given:
        actuator, moved = _within_a_pid(whole)
        lines += moved
        numeric = {"name": f"{actuator.joint}_latency_s", "data": _text(actuator.latency)}
        SubElement(custom, "numeric", numeric)
        _shaft(actuator, parts["worldbody"], parts["tendon"])
        lines += _motor(actuator, parts["actuator"])
        lines += _late(actuator, parts["actuator"][-1])
        lines += _passive(actuator, parts["actuator"])
        _sensor(actuator, parts["sensor"])
        hard = {name: x for name, x in actuator.motor.items() if f"motor.{name}" not in SOFT}
        lines += left_out(replace(actuator, motor=hard), HAS, LACKS, "MuJoCo")
    root.extend(part for part in parts.values() if len(part))
    lines += [*dropped, *shared_left_out(model)]
    ElementTree.indent(root)
    head = ["Actuators identified by sim2real; SI units, radians.", *listed(lines)]
    text = "\n".join(["<!--", *(f"  {line.replace('--', '- -')}" for line in head), "-->"])
    return Export(f"{text}\n{ElementTree.tostring(root, encoding='unicode')}\n", tuple(lines))


def _shaft(given: Actuator, world: Element, tendons: Element) -> None:
    """The shaft, its load, and what lies between them; tendons add up angles along the chain."""
    inertia, armature = given.inertia, given.value("unmodelled_inertia", "inertia_kgm2")
    if armature < 0:
        inertia, armature = inertia + armature, 0.0
    rotor = given.value("compliance", "rotor_inertia_kgm2")
    # A rotor would ring on its spring: as the law has it, what the motor feels of it is softer.
    spring = given.value("compliance", "compliance_rad_per_Nm") * (1 - rotor / inertia) ** 2
    shaft = SHAFT_SHARE * (inertia + armature) if spring > 0 else 0.0
    body = SubElement(world, "body", name=f"{given.joint}_link")
    attributes = {"name": given.joint, "type": "hinge", "axis": "0 1 0"}
    if armature > 0:
        attributes["armature"] = _text(armature)
    attributes |= _losses(given)
    if offset := _offset(given):
        attributes["ref"] = _text(offset)
    if given.sheet is not None:
        attributes["range"] = _text(*given.sheet.limits_rad)
    SubElement(body, "joint", attributes)
    weight = given.gravity + given.value("gravity_load", "torque_Nm")
    _inertial(body, inertia - shaft, weight)
    if spring > 0:
        twist = SubElement(body, "body", name=f"{given.joint}_shaft")
        SubElement(
            twist,
            "joint",
            {
                "name": f"{given.joint}_twist",
                "type": "hinge",
                "axis": "0 1 0",
                "stiffness": _text(1 / spring),
            },
        )
        _inertial(twist, shaft, 0.0)
    gain = 1 + given.value("sensor_gain", "gain")
    if spring > 0:
        _sum(tendons, f"{given.joint}_motor", {given.joint: 1.0, f"{given.joint}_twist": 1.0})
    if spring > 0 or gain != 1:
        chain = {given.joint: gain}
        chain |= {f"{given.joint}_twist": gain} if spring > 0 else {}
        _sum(tendons, f"{given.joint}_seen", chain)


def _within_a_pid(given: Actuator) -> tuple[Actuator, list[LeftOut]]:
    """The actuator with its back-EMF within the limit, where a ``pid`` or a spring needs it."""
    if given.back_emf > 0 and given.value("compliance", "compliance_rad_per_Nm") > 0:
        why = "the spring passes on what the motor makes, its damping included"
    elif given.kd >= 0 or not given.effects.keys() & {"integral_action", "rate_limit"}:
        return given, []
    else:
        why = "a pid's velocity gain is not negative"
    why += ": the limit holds for drive and back-EMF together"
    moved = replace(given, kd=given.kd + given.back_emf, back_emf=0.0)
    return moved, [LeftOut(given.joint, "a drive that clips before the back-EMF", why)]


def _losses(given: Actuator) -> dict[str, str]:
    """Attributes of dry friction and damping of a joint."""
    friction = given.value("coulomb_friction", "torque_Nm")
    friction += given.value("asymmetric_friction", "torque_Nm")
    attributes = {}
    if friction > 0:
        attributes["frictionloss"] = _text(friction)
        attributes |= _softness(
            *(given.motor.get(name.removeprefix("motor."), 0.0) for name in SOFT)
        )
    square = given.value("quadratic_drag", "coefficient_Nms2")
    if square > 0:
        attributes["damping"] = _text(given.back_emf, square, 0)
    elif given.back_emf > 0:
        attributes["damping"] = _text(given.back_emf)
    return attributes


def _softness(stick: float, creep: float) -> dict[str, str]:
    """Attributes of dry friction that stops a shaft in these times, s; at once where both are 0.

    Impedance d and time constant T of the constraint: ``stick = T d / 2``, ``creep = stick (1 - d)
    / d``. Source: MuJoCo's documentation, Computation, Constraint model (friction loss), where
    ``stick`` is 1 / b and b = 2 / (d T).
    """
    impedance = min(max(stick / max(stick + creep, 1e-12), 0.0001), 0.9999)
    constant = max(2 * stick / impedance, 2 * TIMESTEP_S)
    if not stick:
        impedance = 0.9999
    return {
        "solreffriction": _text(constant, 1),
        "solimpfriction": _text(impedance, impedance),
    }


def _motor(given: Actuator, section: Element) -> list[LeftOut]:
    """The drive: gain, bias, delay, limit; a ``pid`` where it integrates or limits the rate."""
    at = {"name": given.joint}
    if given.effects.get("compliance"):
        at["tendon"] = f"{given.joint}_motor"
    else:
        at["joint"] = given.joint
    # Dry friction that differs by direction is an even one and a constant torque.
    torque, uneven = (
        given.value("asymmetric_friction", name) for name in ("torque_Nm", "asymmetry")
    )
    constant = -torque * uneven
    if given.limit is not None:
        at["forcerange"] = _text(constant - given.limit, constant + given.limit)
    ki = given.value("integral_action", "ki_Nm_per_rad_s")
    slew = given.value("rate_limit", "limit_rad_s")
    smooth = given.value("command_filter", "time_constant_s")
    bias = constant + given.kp * _offset(given)
    if not ki and not slew:
        at |= {"gaintype": "fixed", "gainprm": _text(given.kp), "biastype": "affine"}
        # A velocity gain above 0 would be taken for a damping ratio, were kp the same in both.
        stiff = given.kp * (1 + 1e-7) if given.kd < 0 else given.kp
        at["biasprm"] = _text(bias, -stiff, -given.kd)
        if smooth:
            at |= {"dyntype": "filterexact", "dynprm": _text(smooth), "actearly": "true"}
        SubElement(section, "general", at)
        return []
    at |= {"kp": _text(given.kp), "kv": _text(given.kd), "input": "pos"}
    at |= {"ki": _text(ki)} if ki else {}
    at |= {"slewmax": _text(slew)} if slew else {}
    SubElement(section, "pid", at)
    lines = []
    why = "not beside integral action or a rate limit: a pid has neither filter nor bias"
    if smooth:
        lines.append(LeftOut(given.joint, f"command_filter ({smooth:.6g} s)", why))
    if bias:
        lines.append(LeftOut(given.joint, f"a constant torque of {bias:.6g} N m", why))
    return lines


def _late(given: Actuator, motor: Element) -> list[LeftOut]:
    """Delay the commands of a motor, if this version of MuJoCo does."""
    if given.latency <= 0:
        return []
    try:
        installed = version("mujoco")
    except PackageNotFoundError:
        installed = ""
    if installed and tuple(int(part) for part in installed.split(".")[:2]) < (3, 5):
        why = (
            f"MuJoCo {installed} has no delays; sim2real.exporters.mujoco_bench holds commands back"
        )
        return [LeftOut(given.joint, f"latency ({given.latency:.6g} s)", why)]
    motor.set("delay", _text(given.latency))
    motor.set("nsample", str(math.ceil(given.latency / TIMESTEP_S) + 2))
    return []


def _passive(given: Actuator, section: Element) -> list[LeftOut]:
    """Cogging and bristle friction, which MuJoCo has as a motor without inputs."""

    def motor(name: str, **terms: str) -> None:
        at = {"name": f"{given.joint}_{name}", "joint": given.joint, "input": "none"}
        SubElement(section, "dcmotor", at | {"resistance": "1", "motorconst": "0 0"} | terms)

    ripple = given.effects.get("cogging", {})
    if ripple.get("torque_Nm") and ripple.get("period_rad"):
        turns = 2 * math.pi / ripple["period_rad"]
        phase = ripple.get("phase_rad", 0.0) - turns * _offset(given)
        cogging = _text(ripple["torque_Nm"] / turns, 1, phase)
        motor("cogging", gear=_text(turns), cogging=cogging)
    bristles = given.effects.get("presliding_friction", {})
    if bristles.get("torque_Nm"):
        torque, stiffness = bristles["torque_Nm"], bristles["stiffness_Nm_per_rad"]
        ratio = bristles.get("damping_ratio", 0.0)
        damping = 2 * ratio * math.sqrt(stiffness * given.inertia)
        motor("bristles", lugre=_text(stiffness, damping, torque, torque, 1))
    falling = given.effects.get("stribeck_friction", {})
    if falling:
        sliding, breakaway = falling["torque_Nm"], falling["breakaway_Nm"]
        stiffness = given.inertia / (4 * TIMESTEP_S) ** 2  # as stiff as the step allows
        damping = 0.03 * math.sqrt(stiffness * given.inertia)
        motor(
            "friction",
            lugre=_text(stiffness, damping, sliding, breakaway, falling["velocity_rad_s"]),
        )
        give = max(sliding, breakaway) / stiffness
        why = f"bristles that give {give:.2g} rad stand for it; a shorter timestep allows less"
        return [LeftOut(given.joint, "rigid sticking of stribeck_friction", why)]
    return []


def _sensor(given: Actuator, section: Element) -> None:
    name = f"{given.joint}_position"
    if given.effects.keys() & {"compliance", "sensor_gain"}:
        SubElement(section, "tendonpos", name=name, tendon=f"{given.joint}_seen")
    else:
        SubElement(section, "jointpos", name=name, joint=given.joint)


def _offset(given: Actuator) -> float:
    """What the joint's coordinate is ahead of its angle, so that the sensor is off as measured."""
    gain = 1 + given.value("sensor_gain", "gain")
    return given.value("sensor_offset", "offset_rad") / gain


def _inertial(body: Element, inertia: float, weight: float) -> None:
    """Inertia in kg m2 about the joint whose weight, held level, has this torque in N m."""
    mass, arm = 0.1, 0.0
    if weight:
        arm = min(0.05, inertia * GRAVITY_M_S2 / (2 * abs(weight)))
        mass = abs(weight) / (GRAVITY_M_S2 * arm)
    central = inertia - mass * arm**2
    SubElement(
        body,
        "inertial",
        pos=_text(0, 0, -math.copysign(arm, weight)),
        mass=_text(mass),
        diaginertia=_text(central, central, central),
    )


def _sum(section: Element, name: str, joints: dict[str, float]) -> None:
    tendon = SubElement(section, "fixed", name=name)
    for joint, share in joints.items():
        SubElement(tendon, "joint", joint=joint, coef=_text(share))


def _text(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
