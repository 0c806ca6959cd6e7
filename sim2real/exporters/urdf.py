"""What a URDF can say of the identified actuators: friction, damping, limits and the load.

Elements: http://wiki.ros.org/urdf/XML/joint and http://wiki.ros.org/urdf/XML/link.
"""

from __future__ import annotations

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
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction",)
"""Effects of the catalogue that a URDF expresses."""


def urdf(model: Model, robot: Robot | None = None) -> Export:
    """A URDF with one link on each joint; its ``<joint>`` elements are what carries over.

    Args:
        model: The fitted model.
        robot: Gives the limits, which a URDF has only all together; without it joints are
            ``continuous``.

    Raises:
        InputError: See `actuators`.
    """
    given = actuators(model, robot)
    root = Element("robot", name=robot.name if robot else "sim2real")
    SubElement(root, "link", name="bench")
    lines: list[LeftOut] = []
    for actuator in given:
        _joint(actuator, root)
        lines += _left_out(actuator)
    lines += shared_left_out(model)
    ElementTree.indent(root)
    head = ["Actuators identified by sim2real; SI units, radians.", *listed(lines)]
    text = "\n".join(["<!--", *(f"  {line.replace('--', '- -')}" for line in head), "-->"])
    body = ElementTree.tostring(root, encoding="unicode")
    return Export(f'<?xml version="1.0"?>\n{text}\n{body}\n', tuple(lines))


def _joint(given: Actuator, root: Element) -> None:
    kind = "revolute" if given.sheet else "continuous"
    joint = SubElement(root, "joint", name=given.joint, type=kind)
    SubElement(joint, "parent", link="bench")
    SubElement(joint, "child", link=f"{given.joint}_link")
    SubElement(joint, "axis", xyz="0 1 0")
    friction = given.value("coulomb_friction", "torque_Nm")
    damping = f"{given.back_emf:.9g}"
    SubElement(joint, "dynamics", damping=damping, friction=f"{friction:.9g}")
    if given.sheet is not None:
        low, high = given.sheet.limits_rad
        limit = {"lower": f"{low:.9g}", "upper": f"{high:.9g}"}
        limit |= {"effort": f"{given.stall_torque:.9g}", "velocity": f"{given.no_load_speed:.9g}"}
        SubElement(joint, "limit", limit)
    inertial = SubElement(SubElement(root, "link", name=f"{given.joint}_link"), "inertial")
    SubElement(inertial, "mass", value="0.1")
    moment = f"{given.inertia:.9g}"
    terms = {"ixx": moment, "iyy": moment, "izz": moment, "ixy": "0", "ixz": "0", "iyz": "0"}
    SubElement(inertial, "inertia", terms)


def _left_out(given: Actuator) -> list[LeftOut]:
    lines = []
    for what, value, unit in (
        ("kp", given.kp, "N m/rad"),
        ("kd", given.kd, "N m s/rad"),
        ("latency", given.latency, "s"),
    ):
        why = "a URDF has no controller; set it there"
        lines.append(LeftOut(given.joint, f"{what} ({value:.6g} {unit})", why))
    if given.limit is not None and given.sheet is None:
        why = "a URDF has it only with limits of angle and speed, which a robot file gives"
        lines.append(LeftOut(given.joint, f"torque limit ({given.limit:.6g} N m)", why))
    if given.gravity:
        why = "the link here has inertia only"
        lines.append(LeftOut(given.joint, f"pendulum ({given.gravity:.6g} N m)", why))
    return lines + left_out(given, HAS, {}, "URDF")
