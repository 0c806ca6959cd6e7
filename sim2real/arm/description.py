"""An arm: the rigid bodies of its URDF, which recorded joint is which of its, and its dynamics."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, library, one_of
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


class Multibody:
    """Inertias and torques of an arm of J joints in motion, with angles as recorded.

    By Pinocchio: Carpentier et al., IEEE/SICE International Symposium on System Integration (2019)
    614-619.

    Raises:
        InputError: If Pinocchio is not installed, or it does not accept the URDF.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._library = library("pinocchio", arm.file)
        self._model = self._reduced()
        self._data = self._model.createData()
        order = [self._model.getJointId(joint.urdf_joint) for joint in arm.joints]
        self._place = np.array([self._model.joints[k].idx_v for k in order])
        self._direction = np.array([joint.direction for joint in arm.joints])
        self._zero = np.array([joint.zero_rad for joint in arm.joints])
        diagonal = np.diagonal(self.mass_matrix(self._zero[None])[0])
        for joint, inertia in zip(arm.joints, diagonal, strict=True):
            if inertia <= 0:
                place = f"joint {joint.urdf_joint}"
                found = "no mass and no inertia beyond it"
                raise InputError(arm.file, place, found, "<inertial> of the links it moves")

    def loads(self, angle: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """Inertia and torque that each joint's servo sees of the moving arm.

        With the equations of motion M(q) q'' + C(q, q') q' + g(q) = T (any text on robot dynamics),
        servo j sees M_jj q_j'' = T_j + load_j, so that load_j = M_jj q_j'' - T_j: gravity, Coriolis
        and centrifugal torques, and what the other joints' accelerations exert.

        Angles in rad, speeds in rad/s and accelerations in rad/s2 are of shape (T, J), as are the
        inertias M_jj in kg m2 and the torques on the shafts in N m.
        """
        q, v, a = (np.zeros((len(angle), self._model.nv)) for _ in range(3))
        q[:, self._place] = self._direction * (angle - self._zero)
        v[:, self._place] = self._direction * velocity
        a[:, self._place] = self._direction * acceleration
        inertia, total = np.empty_like(q), np.empty_like(q)
        rnea, crba = self._library.rnea, self._library.crba
        for k in range(len(q)):
            total[k] = rnea(self._model, self._data, q[k], v[k], a[k])
            inertia[k] = np.diagonal(crba(self._model, self._data, q[k]))
        load = inertia * a - total
        return inertia[:, self._place], self._direction * load[:, self._place]

    def mass_matrix(self, angle: Array) -> Array:
        """Mass matrices M(q) in kg m2 at angles (T, J), shape (T, J, J)."""
        q = np.zeros((len(angle), self._model.nv))
        q[:, self._place] = self._direction * (angle - self._zero)
        matrices = np.empty((len(q), q.shape[1], q.shape[1]))
        for k in range(len(q)):
            upper = np.triu(self._library.crba(self._model, self._data, q[k]))
            matrices[k] = upper + np.triu(upper, 1).T
        chosen = matrices[:, self._place[:, None], self._place]
        return np.asarray(self._direction[:, None] * chosen * self._direction)

    def _reduced(self) -> Any:  # noqa: ANN401 - Pinocchio has no stubs
        """Pinocchio's model of the arm, with all other joints of the URDF locked at 0."""
        library, arm = self._library, self.arm
        try:
            whole = library.buildModelFromXML(arm.urdf)
        except (ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:160]
            expected = "a URDF that Pinocchio reads"
            raise InputError(arm.file, "", f"no model ({reason})", expected) from None
        named = {joint.urdf_joint for joint in arm.joints}
        absent = named - set(whole.names)
        if absent:
            found = f"no joint {', '.join(sorted(absent))}"
            raise InputError(arm.file, "joints", found, f"joints of {', '.join(whole.names[1:])}")
        locked = [k for k, name in enumerate(whole.names) if k and name not in named]
        model = library.buildReducedModel(whole, locked, library.neutral(whole))
        model.gravity.linear = np.array(arm.gravity_m_s2)
        return model
