"""Export of the identified actuators as a URDF: friction, damping, limits and the load.

Elements: http://wiki.ros.org/urdf/XML/joint and http://wiki.ros.org/urdf/XML/link. ``damping`` (N m
s/rad) and ``friction`` (N m) of ``<dynamics>`` are positive and oppose the motion: the joint turns
under ``controller torque - damping velocity - friction sign(velocity)``. The identified damping is
split between the joint and its position controller, whose gains a URDF does not have: the joint has
that of the motor's back-EMF, but at most the whole, so that the controller's share is never
negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from sim2real.exporters.actuator import (
    Actuator,
    Export,
    LeftOut,
    actuators,
    left_out,
    quantity,
    shared_left_out,
    xml_text,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that a URDF expresses."""

LACKS = {"gravity_load": "the link here has inertia only; add the weight to your link"}


def urdf(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """A URDF with one link on each joint; its ``<joint>`` elements can be copied.

    Args:
        model: The fitted model.
        robot: Source of the limits of angle, torque and speed, of which a URDF requires all;
            without it joints are ``continuous``.
        dropped: Parts that were dropped from the model, to be listed, see `expressible`.

    Raises:
        InputError: See `actuators`.
    """
    servos = actuators(model, robot)
    root = Element("robot", name=robot.name if robot else "sim2real")
    SubElement(root, "link", name="bench")
    lines: list[LeftOut] = []
    for actuator in servos:
        _joint(actuator, root)
        lines += _left_out(actuator)
    lines += [*dropped, *shared_left_out(model)]
    return Export(f'<?xml version="1.0"?>\n{xml_text(root, lines)}', tuple(lines))


def _joint(servo: Actuator, root: Element) -> None:
    kind = "revolute" if servo.sheet else "continuous"
    joint = SubElement(root, "joint", name=servo.joint, type=kind)
    SubElement(joint, "parent", link="bench")
    SubElement(joint, "child", link=f"{servo.joint}_link")
    SubElement(joint, "axis", xyz="0 1 0")
    friction = servo.value("coulomb_friction", "torque_Nm")
    damping = f"{servo.passive_damping:.9g}"
    SubElement(joint, "dynamics", damping=damping, friction=f"{friction:.9g}")
    if servo.sheet is not None:
        low, high = servo.sheet.limits_rad
        limit = {"lower": f"{low:.9g}", "upper": f"{high:.9g}"}
        limit |= {"effort": f"{servo.stall_torque:.9g}", "velocity": f"{servo.no_load_speed:.9g}"}
        SubElement(joint, "limit", limit)
    inertial = SubElement(SubElement(root, "link", name=f"{servo.joint}_link"), "inertial")
    SubElement(inertial, "mass", value="0.1")
    moment = f"{servo.inertia + servo.beyond_load:.9g}"
    terms = {"ixx": moment, "iyy": moment, "izz": moment, "ixy": "0", "ixz": "0", "iyz": "0"}
    SubElement(inertial, "inertia", terms)


def _left_out(servo: Actuator) -> list[LeftOut]:
    lines = []
    damping = servo.passive_damping
    controller_kd = servo.kd + servo.back_emf - damping
    for name, value, unit in (
        ("kp", servo.kp, "N m/rad"),
        ("kd", controller_kd if abs(controller_kd) > 1e-9 * damping else 0.0, "N m s/rad"),
        ("latency", servo.latency, "s"),
    ):
        why = "a URDF has no controller; set it there"
        if name == "kd" and damping:
            why += f", in addition to the damping of {damping:.6g} N m s/rad in the joint"
        lines += quantity(servo.joint, name, value, unit, why)
    if servo.limit is not None and servo.sheet is None:
        why = "a URDF has it only with limits of angle and speed, which a robot file contains"
        lines.append(LeftOut(servo.joint, f"torque limit ({servo.limit:.6g} N m)", why))
    if servo.back_emf > damping:
        why = "only below the limit of the drive; at the limit the damping is "
        why += f"{servo.back_emf:.6g} N m s/rad"
        lines.append(LeftOut(servo.joint, f"damping ({damping:.6g} N m s/rad)", why))
    why = "the link here has inertia only"
    lines += quantity(servo.joint, "pendulum", servo.gravity, "N m", why)
    inertia = servo.beyond_load
    why = "a URDF has no armature: it is added to the inertia of the link here; do so for yours"
    lines += quantity(servo.joint, "unmodelled_inertia", inertia, "kg m2", why)
    return lines + left_out(servo, "URDF", HAS, LACKS)
