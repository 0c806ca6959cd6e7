"""What a URDF can say of the identified actuators: friction, damping, limits and the load.

Elements: http://wiki.ros.org/urdf/XML/joint and http://wiki.ros.org/urdf/XML/link. ``damping`` (N m
s/rad) and ``friction`` (N m) of ``<dynamics>`` are positive and oppose the motion: the joint turns
under ``controller torque - damping velocity - friction sign(velocity)``. The identified damping is
shared between the joint and its position controller, whose gains a URDF does not have: the joint
takes the motor's back-EMF, but no more than the whole, so that the controller's share is never
negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from sim2real.exporters.actuator import (
    Actuator,
    Export,
    LeftOut,
    actuators,
    left_out,
    listed,
    quantity,
    shared_left_out,
)
from sim2real.model import Model
from sim2real.robot import Robot

HAS = ("coulomb_friction", "unmodelled_inertia")
"""Effects of the catalogue that a URDF expresses."""

LACKS = {"gravity_load": "the link here has inertia only; add the weight to your link"}


def urdf(model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()) -> Export:
    """A URDF with one link on each joint; its ``<joint>`` elements are what carries over.

    Args:
        model: The fitted model.
        robot: Gives the limits, which a URDF has only all together; without it joints are
            ``continuous``.
        dropped: What the model had more, for the file to list, see `expressible`.

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
    lines += [*dropped, *shared_left_out(model)]
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
    damping = f"{_damping(given):.9g}"
    SubElement(joint, "dynamics", damping=damping, friction=f"{friction:.9g}")
    if given.sheet is not None:
        low, high = given.sheet.limits_rad
        limit = {"lower": f"{low:.9g}", "upper": f"{high:.9g}"}
        limit |= {"effort": f"{given.stall_torque:.9g}", "velocity": f"{given.no_load_speed:.9g}"}
        SubElement(joint, "limit", limit)
    inertial = SubElement(SubElement(root, "link", name=f"{given.joint}_link"), "inertial")
    SubElement(inertial, "mass", value="0.1")
    moment = f"{given.inertia + given.value('unmodelled_inertia', 'inertia_kgm2'):.9g}"
    terms = {"ixx": moment, "iyy": moment, "izz": moment, "ixy": "0", "ixz": "0", "iyz": "0"}
    SubElement(inertial, "inertia", terms)


def _damping(given: Actuator) -> float:
    """The joint's own share of the identified damping, N m s/rad: that of the back-EMF."""
    return max(min(given.back_emf, given.kd + given.back_emf), 0.0)


def _left_out(given: Actuator) -> list[LeftOut]:
    lines = []
    damping = _damping(given)
    own = given.kd + given.back_emf - damping
    for what, value, unit in (
        ("kp", given.kp, "N m/rad"),
        ("kd", own if abs(own) > 1e-9 * damping else 0.0, "N m s/rad"),
        ("latency", given.latency, "s"),
    ):
        why = "a URDF has no controller; set it there"
        if what == "kd" and damping:
            why += f", beside the damping of {damping:.6g} N m s/rad in the joint"
        lines += quantity(given.joint, what, value, unit, why)
    if given.limit is not None and given.sheet is None:
        why = "a URDF has it only with limits of angle and speed, which a robot file gives"
        lines.append(LeftOut(given.joint, f"torque limit ({given.limit:.6g} N m)", why))
    if given.back_emf > damping:
        why = "only while the drive is not at its limit: there the motor damps with "
        why += f"{given.back_emf:.6g} N m s/rad"
        lines.append(LeftOut(given.joint, f"damping ({damping:.6g} N m s/rad)", why))
    why = "the link here has inertia only"
    lines += quantity(given.joint, "pendulum", given.gravity, "N m", why)
    inertia = given.value("unmodelled_inertia", "inertia_kgm2")
    why = "a URDF has no armature: it is in the inertia of the link here; add it to your link's"
    lines += quantity(given.joint, "unmodelled_inertia", inertia, "kg m2", why)
    return lines + left_out(given, HAS, LACKS, "URDF")
