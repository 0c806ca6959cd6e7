"""Description of an arm: the rigid bodies of its URDF, and which recorded joint is which of its."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from sim2real.errors import InputError, one_of
from sim2real.output import protect
from sim2real.structured import Fields, read_text

_PARTS = {"link": ("inertial",), "joint": ("origin", "parent", "child", "axis", "limit")}
"""Elements of a URDF that determine its dynamics."""


@dataclass(frozen=True)
class ArmJoint:
    """A recorded joint of an arm: URDF angle = direction (recorded angle - zero_rad)."""

    name: str  # name in recordings
    urdf_joint: str  # name in the URDF
    direction: float = 1.0  # 1 or -1
    zero_rad: float = 0.0  # recorded angle where the URDF's angle is 0


@dataclass(frozen=True)
class Arm:
    """Rigid bodies that joints move."""

    urdf: str  # text of the URDF, reduced to inertias and joints
    joints: tuple[ArmJoint, ...]  # the joints that may be recorded; others of the URDF stay at 0
    # acceleration of gravity in the frame of the base
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    file: str = "urdf"  # origin of the URDF, for messages

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints in recordings."""
        return tuple(joint.name for joint in self.joints)


def read_arm(fields: Fields, names: Sequence[str]) -> Arm:
    """The arm of the table ``[arm]`` of a robot file.

    ``urdf`` is a file relative to the folder of the robot file; ``names`` are the robot's joints.

    Raises:
        InputError: If the URDF cannot be read, or a joint is not one of its hinges.
    """
    from sim2real.importers.urdf import read_urdf

    fields.refuse_unknown(("urdf", "gravity_m_s2", "joints"))
    file = Path(fields.file).parent / fields.text("urdf")
    tree = read_urdf(file)
    hinges = [hinge.name for hinge in tree.hinges]
    joints = _joints(fields, names)
    for joint in joints:
        if joint.urdf_joint not in hinges:
            place = f"{fields.where}.joints.{joint.name}.urdf_joint"
            found, expected = repr(joint.urdf_joint), f"a hinge of {file.name}: "
            raise InputError(fields.file, place, found, expected + one_of(joint.urdf_joint, hinges))
    protect(file)
    return Arm(_dynamics_only(read_text(file)), joints, _gravity(fields), str(file))


def arm_content(arm: Arm) -> dict[str, Any]:
    """The arm as it stands in a model file, from which ``arm_from`` restores it."""
    joints = {
        joint.name: {key: value for key, value in vars(joint).items() if key != "name"}
        for joint in arm.joints
    }
    return {"urdf": arm.urdf, "gravity_m_s2": list(arm.gravity_m_s2), "joints": joints}


def arm_from(fields: Fields) -> Arm:
    """The arm of the table ``arm`` of a model file.

    Raises:
        InputError: If a field does not conform to the format.
    """
    joints = _joints(fields, list(fields.table("joints").content))
    return Arm(fields.text("urdf"), joints, _gravity(fields), str(fields.file))


def _joints(fields: Fields, names: Sequence[str]) -> tuple[ArmJoint, ...]:
    table, joints = fields.table("joints"), []
    table.refuse_unknown(names)
    for name in names:
        entry = table.table(name)
        entry.refuse_unknown(("urdf_joint", "direction", "zero_rad"))
        direction = entry.number("direction", 1.0)
        if abs(direction) != 1:
            raise entry.error("direction", "1 or -1")
        zero = entry.number("zero_rad", 0.0)
        joints.append(ArmJoint(name, entry.text("urdf_joint", name), direction, zero))
    used = [joint.urdf_joint for joint in joints]
    for name in used:
        if used.count(name) > 1:
            raise InputError(fields.file, fields.path("joints"), f"{name!r} twice", "each once")
    return tuple(joints)


def _gravity(fields: Fields) -> tuple[float, float, float]:
    if "gravity_m_s2" not in fields:
        return Arm.gravity_m_s2
    x, y, z = fields.numbers("gravity_m_s2", "three numbers in m/s2", 3)
    return x, y, z


def _dynamics_only(text: str) -> str:
    """A URDF without what does not change its dynamics."""
    source = ElementTree.fromstring(text)
    robot = Element("robot", {"name": source.get("name", "arm")})
    for element in source:
        if element.tag not in _PARTS:
            continue
        kept = Element(element.tag, element.attrib)
        kept.extend(part for part in element if part.tag in _PARTS[element.tag])
        if kept.get("type") == "continuous":
            kept.set("type", "revolute")
        if kept.get("type") == "revolute" and kept.find("limit") is None:
            wide = {"lower": "-100", "upper": "100", "effort": "1e9", "velocity": "1e9"}
            kept.append(Element("limit", wide))
        for end, name in (("link", "name"), ("parent", "link"), ("child", "link")):
            for part in (kept, *kept):
                if part.tag == end:
                    part.set(name, f"link {part.get(name)}")
        robot.append(kept)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")
