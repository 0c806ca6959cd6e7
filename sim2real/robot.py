"""The robot as its owner knows it: links, joints and the data sheets of its servos."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from sim2real.errors import InputError
from sim2real.recording import Recording
from sim2real.structured import Fields, finite_number, read_toml


@dataclass(frozen=True)
class Link:
    """One rigid link, SI units; ``com_m`` is measured from its front end.

    ``mass_sd_kg`` and ``length_sd_m`` say how sure scale and ruler are (standard deviations).
    """

    name: str
    mass_kg: float
    length_m: float
    width_m: float
    height_m: float
    material: str | None = None
    com_m: float | None = None
    inertia_kgm2: float | None = None
    mass_sd_kg: float | None = None
    length_sd_m: float | None = None


@dataclass(frozen=True)
class Servo:
    """What the maker says of a servo; never fitted."""

    name: str
    max_torque_Nm: float
    no_load_speed_rad_s: float
    position_step_rad: float


@dataclass(frozen=True)
class Joint:
    """Joint k joins links k and k + 1 and is turned by ``servo`` within ``limits_rad``."""

    name: str
    servo: Servo
    limits_rad: tuple[float, float]


@dataclass(frozen=True)
class Robot:
    """A chain of links, one more than the joints, from head to tail."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    path: Path | None = None

    def joint(self, name: str) -> Joint | None:
        """The joint called ``name``, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)


def match_joints(recording: Recording, robot: Robot) -> None:
    """Make sure that the robot has every joint of the recording.

    Raises:
        InputError: If it lacks one.
    """
    for joint in recording.joints:
        if robot.joint(joint) is None:
            names = ", ".join(known.name for known in robot.joints)
            raise InputError(recording.file, "joints", repr(joint), f"one of {names}")


def read_robot(path: str | os.PathLike[str]) -> Robot:
    """Read ``robot.toml``.

    Raises:
        InputError: If the file or one of its fields is not as the format says.
    """
    top = Fields(path, "", read_toml(path))
    servos = {
        name: _servo(name, Fields(path, f"servos.{name}", content))
        for name, content in top.table("servos").content.items()
    }
    links = tuple(_link(fields) for fields in top.tables("links"))
    joints = tuple(_joint(fields, servos) for fields in top.tables("joints"))
    if len(links) != len(joints) + 1:
        found = f"{len(links)} links and {len(joints)} joints"
        raise InputError(path, "links", found, "one link more than joints")
    names = [joint.name for joint in joints]
    if len(set(names)) != len(names):
        raise InputError(path, "joints", f"the names {', '.join(names)}", "each name once")
    return Robot(top.text("name", "robot"), links, joints, Path(path))


def _servo(name: str, fields: Fields) -> Servo:
    return Servo(
        name,
        max_torque_Nm=fields.number("max_torque_Nm", above=0),
        no_load_speed_rad_s=fields.number("no_load_speed_rad_s", above=0),
        position_step_rad=fields.number("position_step_rad", low=0),
    )


def _link(fields: Fields) -> Link:
    def optional(name: str) -> float | None:
        return fields.number(name, low=0) if name in fields else None

    return Link(
        name=fields.text("name"),
        mass_kg=fields.number("mass_kg", above=0),
        length_m=fields.number("length_m", above=0),
        width_m=fields.number("width_m", above=0),
        height_m=fields.number("height_m", above=0),
        material=fields.text("material") if "material" in fields else None,
        com_m=optional("com_m"),
        inertia_kgm2=optional("inertia_kgm2"),
        mass_sd_kg=optional("mass_sd_kg"),
        length_sd_m=optional("length_sd_m"),
    )


def _joint(fields: Fields, servos: dict[str, Servo]) -> Joint:
    servo = fields.text("servo")
    if servo not in servos:
        raise fields.error("servo", f"one of the [servos.*] tables ({', '.join(servos) or 'none'})")
    limits = fields.content.get("limits_rad")
    ends = [finite_number(end) for end in limits] if isinstance(limits, list) else []
    if len(ends) != 2 or ends[0] is None or ends[1] is None or ends[0] >= ends[1]:
        raise fields.error("limits_rad", "two angles, the smaller first")
    return Joint(fields.text("name"), servos[servo], (ends[0], ends[1]))
