"""Export of the identified actuators as a MuJoCo model (MJCF): a bench with a shaft for each joint.

Joint attributes and the ``<actuator>`` section can be copied to the model of a robot; the bodies
are the load of the recordings. Terms: https://mujoco.readthedocs.io, XML reference.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from sim2real.exporters.actuator import (
    BEYOND_LIMIT,
    RIGID,
    SATURATION,
    Actuator,
    Export,
    LeftOut,
    actuator,
    actuators,
    head,
    left_out,
    limit_effects,
    limit_with_back_emf,
    shared_left_out,
)
from sim2real.model import JointModel, Model
from sim2real.recording import GRAVITY_M_S2
from sim2real.robot import Robot
from sim2real.servo.gear_train import SPRING_DAMPING
from sim2real.servo.parameters import CONTROL_SIDE, SOFT, TRAINS

TIMESTEP_S = 0.00025
INTEGRATOR = "implicitfast"
STEP = (
    f"Integrator and time step of this file: {INTEGRATOR}, {1e3 * TIMESTEP_S:g} ms (<option>); "
    "set them in your model too, or expect the errors of your own."
)
CONTACT_S, CONTACT_IMPEDANCE = 2 * TIMESTEP_S, "0.999 0.9999 0.0001"
"""The flanks of a gear train with play, as rigid as the time step allows."""

PID = {"integral_action", "rate_limit"}
"""Effects whose drive is a ``pid``."""

PASSIVE = {"cogging", "presliding_friction", "stribeck_friction"}
"""Effects that are motors without inputs, which a limit of all motors of a joint would limit."""

HAS = (
    *sorted(PID | PASSIVE), "asymmetric_friction", "backlash", "command_filter", "compliance",
    "coulomb_friction", "gravity_load", "quadratic_drag", "sensor_gain", "sensor_offset",
    "unmodelled_inertia",
)  # fmt: skip
"""Effects of the catalogue that an MJCF file expresses."""

LACKS = {
    "sensor_eccentricity": "add a sine of the angle to the observation",
    "encoder_quantization": "sensors are continuous; round the reading",
    "latency_jitter": "a delay is constant; delay each set-point by a different time",
    "packet_loss": "the program that sets ctrl has to omit set-points",
}


def expressed(joint: JointModel) -> set[str]:
    """Effects of a joint that an MJCF file expresses; a ``pid`` cannot filter its commands."""
    has = {*HAS, *limit_effects(joint), *SOFT}
    names = {fitted.effect for fitted in joint.effects}
    has -= {fitted.effect for fitted in joint.effects if fitted.parameters.get(CONTROL_SIDE)}
    if SATURATION in names and _two_limits(actuator("joint", joint)):
        has |= {SATURATION, BEYOND_LIMIT}
    return has - {"command_filter"} if names & PID else has


def mujoco(
    model: Model,
    robot: Robot | None = None,
    dropped: Sequence[LeftOut] = (),
    remarks: Sequence[str] = (),
) -> Export:
    """An MJCF model of a fitted model's actuators, for MuJoCo 3.12 and later.

    The head lists parts that were dropped from the model (see `nearest`) and ``remarks``; ``range``
    of the joints is the robot's. ``InputError`` as of `actuators`.
    """
    root = Element("mujoco", model="sim2real")
    SubElement(root, "compiler", angle="radian")
    option = {"timestep": _text(TIMESTEP_S), "integrator": INTEGRATOR}
    SubElement(root, "option", option, gravity=_text(0, 0, -GRAVITY_M_S2))
    parts = {name: Element(name) for name in ("worldbody", "tendon", "actuator", "sensor")}
    lines: list[LeftOut] = []
    for servo in actuators(model, robot):
        if servo.effects.keys() & PID:
            servo, moved = limit_with_back_emf(servo, "the velocity gain of a pid")
            lines += moved
        _shaft(servo, parts["worldbody"], parts["tendon"])
        lines += [*_motor(servo, parts["actuator"]), *_passive(servo, parts["actuator"])]
        seen = {"name": f"{servo.joint}_position"}
        if servo.effects.keys() & {*TRAINS, "sensor_gain"}:
            SubElement(parts["sensor"], "tendonpos", seen, tendon=f"{servo.joint}_seen")
        else:
            SubElement(parts["sensor"], "jointpos", seen, joint=servo.joint)
        lines += left_out(servo, "MuJoCo", (*HAS, SATURATION), LACKS)
        if servo.effects.keys() >= set(TRAINS):
            why = "the stops of a joint with play are rigid"
            lines.append(LeftOut(servo.joint, "compliance with backlash", why))
    root.extend(part for part in parts.values() if len(part))
    lines += [*dropped, *shared_left_out(model)]
    return Export(xml_text(root, lines, [STEP, *remarks]), tuple(lines))


def xml_text(root: Element, lines: Sequence[LeftOut], remarks: Sequence[str] = ()) -> str:
    """An XML file with its head, and further remarks, as a comment."""
    ElementTree.indent(root)
    comments = (f"  {line.replace('--', '- -')}" for line in (*head(lines), *remarks))
    return "\n".join(["<!--", *comments, "-->", ElementTree.tostring(root, encoding="unicode"), ""])


def _two_limits(servo: Actuator) -> bool:
    """Whether a limit of the current can limit all motors of the joint, the back-EMF as well."""
    others = any(servo.value(name, "torque_Nm") for name in PASSIVE)
    alone = not (others or servo.effects.keys() & PID or _train(servo))
    return servo.current_limit is not None and alone and servo.damping_beyond <= servo.back_emf


def _shaft(servo: Actuator, world: Element, tendons: Element) -> None:
    """The output and its load; behind a spring or play, the motor's side is a second body."""
    train = _train(servo)
    rotor = _rotor(servo) if train else 0.0
    armature = 0.0 if train else servo.armature
    body = SubElement(world, "body", name=f"{servo.joint}_link")
    attributes = {"name": servo.joint, "type": "hinge", "axis": "0 1 0"}
    if armature > 0:
        attributes["armature"] = _text(armature)
    if _two_limits(servo):
        attributes["actuatorfrcrange"] = _range(servo, servo.current_limit or 0.0)
        beyond = servo.damping_beyond
        servo = replace(servo, kd=servo.kd + servo.back_emf - beyond, back_emf=beyond)
    friction = servo.friction + servo.value("asymmetric_friction", "torque_Nm")
    stop, drag = servo.stop(2 * TIMESTEP_S), servo.value("quadratic_drag", "coefficient_Nms2")
    if train:
        rubbing = servo.value("backlash", "output_friction_Nm")
        attributes |= _losses(rubbing, (2 * TIMESTEP_S, RIGID), 0.0, drag)
    else:
        attributes |= _losses(friction, stop, servo.passive_damping, drag)
    if offset := _offset(servo):
        attributes["ref"] = _text(offset)
    if servo.sheet is not None:
        attributes["range"] = _text(*servo.sheet.limits_rad)
    SubElement(body, "joint", attributes)
    weight = servo.gravity + servo.value("gravity_load", "torque_Nm")
    _inertial(body, servo.inertia + servo.beyond_load - armature - rotor, weight)
    gain = 1 + servo.value("sensor_gain", "gain")
    lead = f"{servo.joint}_lead"
    if train:  # its angle is the lead, so the motor's is the sum of both, a tendon that is driven
        motor = SubElement(body, "body", name=f"{servo.joint}_motor")
        SubElement(motor, "joint", {"name": lead, "type": "hinge", "axis": "0 1 0"} | train)
        _inertial(motor, rotor, 0.0)
        sides = _add_tendon(tendons, f"{servo.joint}_motor", {servo.joint: 1.0, lead: 1.0})
        sides.attrib.update(_losses(friction, stop, servo.back_emf))
    elif servo.back_emf > servo.passive_damping:
        # Euler's method treats damping of joints implicitly and that of tendons explicitly, as it
        # does the actuator's, whose negative velocity gain this cancels at every time step.
        excess = _add_tendon(tendons, f"{servo.joint}_back_emf", {servo.joint: 1.0})
        excess.set("damping", _text(servo.back_emf - servo.passive_damping))
    if train or gain != 1:
        chain = {servo.joint: gain}
        on_output = servo.value("compliance", "sensor_on_output")
        if train and not servo.effects.get("backlash") and on_output < 1:
            chain[lead] = gain * (1 - on_output)
        _add_tendon(tendons, f"{servo.joint}_seen", chain)


def _train(servo: Actuator) -> dict[str, str]:
    """Attributes of the joint between motor and output: play, a spring or both; empty if rigid."""
    gap = servo.value("backlash", "gap_rad")
    spring = servo.value("compliance", "compliance_rad_per_Nm")
    if spring > 0 and gap == 0:
        inertia = servo.inertia + servo.beyond_load
        share = _rotor(servo) / inertia
        ratio = servo.value("compliance", "damping_ratio") or SPRING_DAMPING
        damping = 2 * ratio * math.sqrt(share * (1 - share) * inertia / spring)
        return {"stiffness": _text(1 / spring), "damping": _text(damping)}
    if gap == 0:
        return {}
    ratio, kept = 1.0, servo.value("backlash", "restitution")
    if kept > 1e-3:  # of its speed after a half-period: exp(-pi z / sqrt(1 - z^2)) of the ratio z
        ratio = -math.log(kept) / math.hypot(math.pi, math.log(kept))
    flanks = {"solreflimit": _text(CONTACT_S / ratio, ratio), "solimplimit": CONTACT_IMPEDANCE}
    return {"limited": "true", "range": _text(-gap / 2, gap / 2), **flanks}


def _rotor(servo: Actuator) -> float:
    """Inertia of the motor's side in kg m2, as ``servo.gear_train.train_of`` has it."""
    rotor = servo.train_rotor or servo.armature
    total = servo.inertia + servo.beyond_load
    if rotor == 0 and servo.effects.get("backlash"):
        rotor = total  # an output without inertia
    return min(max(rotor, 0.02 * total), 0.98 * total)


def _losses(
    friction: float, stop: tuple[float, float], linear: float, square: float = 0.0
) -> dict[str, str]:
    """Attributes of dry friction, see ``Actuator.stop``, and damping of a joint or a tendon."""
    attributes = {}
    if friction > 0:
        attributes["frictionloss"] = _text(friction)
        attributes["solreffriction"] = _text(stop[0], 1)
        attributes["solimpfriction"] = _text(stop[1], stop[1])
    if square > 0:
        attributes["damping"] = _text(linear, square, 0)
    elif linear > 0:
        attributes["damping"] = _text(linear)
    return attributes


def _motor(servo: Actuator, section: Element) -> list[LeftOut]:
    """The drive: gain, bias, limit, delay; a ``pid`` with integral action or a rate limit."""
    moved = {"tendon": f"{servo.joint}_motor"} if _train(servo) else {"joint": servo.joint}
    attributes = {"name": servo.joint, **moved}
    if servo.limit is not None:
        attributes["forcerange"] = _range(servo, servo.limit)
    if servo.latency > 0:
        attributes["delay"] = _text(servo.latency)
        attributes["nsample"] = str(math.ceil(servo.latency / TIMESTEP_S) + 2)
    bias = _constant_torque(servo) + servo.kp * _offset(servo)
    if not servo.effects.keys() & PID:
        attributes |= {"gaintype": "fixed", "gainprm": _text(servo.kp), "biastype": "affine"}
        # With equal kp in gain and bias, MuJoCo reads a positive biasprm[2] as a damping ratio.
        stiff = servo.kp * (1 + 1e-7) if servo.kd < 0 else servo.kp
        attributes["biasprm"] = _text(bias, -stiff, -servo.kd)
        if smooth := servo.value("command_filter", "time_constant_s"):
            attributes |= {"dyntype": "filterexact", "dynprm": _text(smooth), "actearly": "true"}
        SubElement(section, "general", attributes)
        return []
    attributes |= {"kp": _text(servo.kp), "kv": _text(servo.kd), "input": "pos"}
    if ki := servo.value("integral_action", "ki_Nm_per_rad_s"):
        attributes["ki"] = _text(ki)
    if slew := servo.value("rate_limit", "limit_rad_s"):
        attributes["slewmax"] = _text(slew)
    SubElement(section, "pid", attributes)
    why = "not with integral action or a rate limit: a pid has neither filter nor bias"
    return [LeftOut(servo.joint, f"a constant torque of {bias:.6g} N m", why)] if bias else []


def _constant_torque(servo: Actuator) -> float:
    """Torque in N m that makes symmetric dry friction asymmetric."""
    torque = servo.value("asymmetric_friction", "torque_Nm")
    return -torque * servo.value("asymmetric_friction", "asymmetry")


def _range(servo: Actuator, limit: float) -> str:
    """Ends of a torque that is limited, in N m, with the constant torque."""
    constant = _constant_torque(servo)
    return _text(constant - limit, constant + limit)


def _passive(servo: Actuator, section: Element) -> list[LeftOut]:
    """Cogging, bristle friction and back-EMF, which are motors without inputs in MuJoCo."""

    def motor(name: str, **terms: str) -> None:
        attributes = {"name": f"{servo.joint}_{name}", "joint": servo.joint, "input": "none"}
        attributes |= {"resistance": "1", "motorconst": "0 0"}
        SubElement(section, "dcmotor", attributes | terms)

    if _two_limits(servo):
        constant = math.sqrt(servo.back_emf - servo.damping_beyond)
        motor("back_emf", motorconst=_text(constant, constant))
    ripple = servo.effects.get("cogging", {})
    if ripple.get("torque_Nm") and ripple.get("period_rad"):
        turns = 2 * math.pi / ripple["period_rad"]
        phase = ripple.get("phase_rad", 0.0) - turns * _offset(servo)
        cogging = _text(ripple["torque_Nm"] / turns, 1, phase)
        motor("cogging", gear=_text(turns), cogging=cogging)
    bristles = servo.effects.get("presliding_friction", {})
    if bristles.get("torque_Nm"):
        torque, stiffness = bristles["torque_Nm"], bristles["stiffness_Nm_per_rad"]
        ratio = bristles.get("damping_ratio", 0.0)
        damping = 2 * ratio * math.sqrt(stiffness * servo.inertia)
        motor("bristles", lugre=_text(stiffness, damping, torque, torque, 1))
    falling = servo.effects.get("stribeck_friction", {})
    if falling:
        sliding, breakaway = falling["torque_Nm"], falling["breakaway_Nm"]
        stiffness = servo.inertia / (4 * TIMESTEP_S) ** 2  # as stiff as the step allows
        damping = 0.03 * math.sqrt(stiffness * servo.inertia)
        lugre = _text(stiffness, damping, sliding, breakaway, falling["velocity_rad_s"])
        motor("friction", lugre=lugre)
        give = max(sliding, breakaway) / stiffness
        why = f"bristles yield {give:.2g} rad before slip; a shorter timestep allows less"
        return [LeftOut(servo.joint, "rigid sticking of stribeck_friction", why)]
    return []


def _offset(servo: Actuator) -> float:
    """Offset of the joint's coordinate from its angle, which gives the sensor its offset."""
    gain = 1 + servo.value("sensor_gain", "gain")
    return servo.value("sensor_offset", "offset_rad") / gain


def _inertial(body: Element, inertia: float, weight: float) -> None:
    """Add an inertia in kg m2 about the joint, with this gravity torque in N m when horizontal."""
    mass, arm = 0.1, 0.0
    if weight:
        arm = min(0.05, inertia * GRAVITY_M_S2 / (2 * abs(weight)))
        mass = abs(weight) / (GRAVITY_M_S2 * arm)
    central = inertia - mass * arm**2
    about, place = _text(central, central, central), _text(0, 0, -math.copysign(arm, weight))
    SubElement(body, "inertial", pos=place, mass=_text(mass), diaginertia=about)


def _add_tendon(section: Element, name: str, joints: dict[str, float]) -> Element:
    tendon = SubElement(section, "fixed", name=name)
    for joint, share in joints.items():
        SubElement(tendon, "joint", joint=joint, coef=_text(share))
    return tendon


def _text(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
