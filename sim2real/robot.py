"""The description of a robot: links and their density, joints, data sheets of its servos.

A file needs only the values that are used: a missing value is an error where it is used.
"""

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from sim2real.appendages import Appendage, read_appendage
from sim2real.arm.description import Arm, read_arm
from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.display import Drawing, NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.inference.normal import Z90
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.structured import Fields, read_toml

Place = tuple[str, str]
"""A file and a table in it, for messages."""

LIMITS = "two angles in rad, the smaller first"


def _needed(expected: str = "a number above 0", **limits: float) -> Any:  # noqa: ANN401 - a field
    """A value that may be missing, which is an error where it is used."""
    return field(default=None, metadata={"expected": expected, "limits": limits})


def _optional(**limits: float) -> Any:  # noqa: ANN401 - a field
    return field(default=None, metadata={"limits": limits})


class Sheet:
    """A named dataclass of values that may be missing, compared regardless of where it was read."""

    name: str
    where: Place
    declared: ClassVar[Mapping[str, Mapping[str, Any]]]

    def __init_subclass__(cls) -> None:
        """Keep what is declared of each value: its limits, and what is expected if it is needed."""
        cls.declared = {n: f.metadata for n, f in vars(cls).items() if isinstance(f, Field)}

    @classmethod
    def keys(cls) -> list[str]:
        """Keys of its table in the file."""
        return [name for name in cls.__annotations__ if name != "where"]

    @classmethod
    def read(cls, table: Fields, **others: Any) -> Self:  # noqa: ANN401 - fields of the class
        """Read the numbers of a table, given what else it holds."""
        limits = {name: kind["limits"] for name, kind in cls.declared.items() if kind["limits"]}
        numbers = {name: table.optional_number(name, **ends) for name, ends in limits.items()}
        others["where"] = str(table.file), table.where
        return cls(**numbers, **others)

    def __getattribute__(self, name: str) -> Any:  # noqa: ANN401 - of any type
        """The value, or an InputError where it is needed and was not stated."""
        value = super().__getattribute__(name)
        if value is None and (expected := self.declared.get(name, {}).get("expected")):
            raise InputError(self.where[0], f"{self.where[1]}.{name}", "nothing", expected)
        return value

    def states(self, *names: str) -> bool:
        """Whether all of these values are stated."""
        return all(vars(self)[name] is not None for name in names)

    def _stated(self) -> dict[str, Any]:
        return {n: v for n, v in vars(self).items() if n != "where" and v not in (None, ())}

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._stated() == other._stated()

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        stated = ", ".join(f"{n}={v!r}" for n, v in self._stated().items())
        return f"{type(self).__name__}({stated})"


@dataclass(frozen=True, eq=False, repr=False)
class Link(Sheet):
    """One rigid link in SI units, appendages included; ``com_m`` is measured from its front end."""

    name: str
    mass_kg: float = _needed(above=0)
    length_m: float = _needed(above=0)
    width_m: float = _needed(above=0)
    height_m: float = _needed(above=0)
    material: str | None = None
    com_m: float | None = _optional(low=0)
    inertia_kgm2: float | None = _optional(low=0)
    mass_sd_kg: float | None = _optional(low=0)
    length_sd_m: float | None = _optional(low=0)
    appendages: tuple[Appendage, ...] = ()
    where: Place = ("robot", "link")


@dataclass(frozen=True, eq=False, repr=False)
class Servo(Sheet):
    """Data sheet of a servo."""

    name: str
    max_torque_Nm: float = _needed(above=0)
    no_load_speed_rad_s: float = _needed(above=0)
    position_step_rad: float = _needed("a number of at least 0", low=0)
    where: Place = ("robot", "servos")


@dataclass(frozen=True, eq=False, repr=False)
class Joint(Sheet):
    """Joint k connects links k and k + 1 and is driven by ``servo`` within ``limits_rad``."""

    name: str
    servo: Servo
    limits_rad: tuple[float, float] = _needed(LIMITS)
    where: Place = ("robot", "joint")


@dataclass(frozen=True)
class Robot(NotebookDisplay):
    """A chain of links, one more than joints, from head to tail.

    If a file has no links, they are named by number and have no stated values. Of an arm, ``arm``
    describes the bodies that its joints move, by a URDF.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    path: Path | None = None
    arm: Arm | None = None

    @property
    def weighed(self) -> bool:
        """Whether every link states its mass and its length."""
        stated = [vars(link)[name] for link in self.links for name in ("mass_kg", "length_m")]
        return None not in stated

    @property
    def appendages(self) -> tuple[Appendage, ...]:
        """What all links carry outside their hulls, from head to tail."""
        return tuple(appendage for link in self.links for appendage in link.appendages)

    def joint(self, name: str) -> Joint | None:
        """The joint with this name, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)


def match_recordings(recordings: Sequence[Recording], robot: Robot) -> None:
    """Raise InputError if the robot lacks a joint of a recording, or a recording is repeated."""
    files: set[str] = set()
    for recording in recordings:
        match_joints(recording, robot)
        if recording.file in files:
            raise InputError(recording.file, "", "the recording twice", "each recording once")
        files.add(recording.file)


def match_joints(recording: Recording, robot: Robot) -> None:
    """Raise InputError if the robot lacks a joint of the recording."""
    for joint in recording.joints:
        if robot.joint(joint) is None:
            names = ", ".join(defined.name for defined in robot.joints)
            raise InputError(recording.file, "joints", repr(joint), f"one of {names}")


def read_robot(path: str | os.PathLike[str]) -> Robot:
    """Read ``robot.toml``.

    Raises:
        InputError: If the file or one of its fields does not conform to the format.
    """
    top = Fields(path, "", read_toml(path))
    top.refuse_unknown(("name", "links", "joints", "servos", "arm"))
    sheets = top.table("servos")
    servos = {name: _servo(name, sheets.table(name)) for name in sheets.labels()}
    joints = tuple(_joint(fields, servos) for fields in top.tables("joints"))
    unknown = (Link(f"link{k}", where=(str(path), f"links[{k}]")) for k in range(len(joints) + 1))
    links = tuple(map(_link, top.tables("links"))) if "links" in top else tuple(unknown)
    if len(links) != len(joints) + 1:
        found = f"{len(links)} links and {len(joints)} joints"
        raise InputError(path, "links", found, "one link more than joints")
    names = [joint.name for joint in joints]
    if len(set(names)) != len(names):
        raise InputError(path, "joints", f"the names {', '.join(names)}", "each name once")
    arm = read_arm(top.table("arm"), names) if "arm" in top else None
    return Robot(top.label("name", "robot"), links, joints, Path(path), arm)


def _servo(name: str, table: Fields) -> Servo:
    if "type" in table:  # of earlier versions
        warnings.warn(f"{table.file}: {table.path('type')} is ignored", stacklevel=2)
    table.refuse_unknown([*Servo.keys()[1:], *(["type"] if "type" in table else [])])
    return Servo.read(table, name=name)


def _link(table: Fields) -> Link:
    table.refuse_unknown(Link.keys())
    bodies = table.tables("appendages") if "appendages" in table else []
    length = table.optional_number("length_m", above=0)
    appendages = tuple(read_appendage(body, length) for body in bodies)
    material = table.text("material") if "material" in table else None
    link = Link.read(table, name=table.label("name"), material=material, appendages=appendages)
    end = max([length or math.inf, *(one.at_m[0] + one.size_m[0] / 2 for one in appendages)])
    if link.com_m is not None and link.com_m > end:
        raise table.error("com_m", f"a place on the link, at most {end:g} m from its front")
    return link


def _joint(table: Fields, servos: dict[str, Servo]) -> Joint:
    table.refuse_unknown(Joint.keys())
    servo = table.text("servo")
    if servo not in servos:
        raise table.error("servo", f"one of the [servos.*] tables ({', '.join(servos) or 'none'})")
    limits = None
    if "limits_rad" in table:
        low, high = limits = tuple(table.numbers("limits_rad", LIMITS, 2))
        if low >= high:
            raise table.error("limits_rad", LIMITS)
        if max(abs(low), abs(high)) > LARGEST_ANGLE_RAD:
            expected = f"two angles in rad within {LARGEST_ANGLE_RAD:.1f} (are they degrees?)"
            raise table.error("limits_rad", expected)
    return Joint.read(table, name=table.label("name"), servo=servos[servo], limits_rad=limits)


@dataclass(frozen=True)
class Density(NotebookDisplay):
    """Normalised density of L links, 1 where mass per length equals that of the robot.

    Attributes:
        links: Names of the links.
        value: Normalised densities, shape (L,).
        sd: Their standard deviations, shape (L,); None if no link states one.
        mass_kg, length_m: Measured masses and lengths, shape (L,).
    """

    links: tuple[str, ...]
    value: Array
    sd: Array | None
    mass_kg: Array
    length_m: Array

    @property
    def interval(self) -> Array | None:
        """Lower and upper ends of 90 % intervals, shape (2, L); None where ``sd`` is."""
        return None if self.sd is None else self.value + Z90 * np.outer([-1, 1], self.sd)

    def plot(self) -> Drawing:
        """Bar chart of the normalised density of each link."""
        figure: Drawing = from_report("ranges.density_figure")(self)
        return figure


def normalised_density(robot: Robot) -> Density:
    """Mass per length of each link over that of the robot: rho_i = (m_i / l_i) sum(l) / sum(m).

    Source: Lin, Liu, Wang (2024), Sec. III-B.1. Errors of masses and lengths are assumed to be
    independent and small, and are propagated linearly through the logarithm:

        d log rho_i = dm_i / m_i - dl_i / l_i + sum(dl) / sum(l) - sum(dm) / sum(m).
    """
    names = ("mass_kg", "length_m", "mass_sd_kg", "length_sd_m")
    mass, length, *errors = (np.array([getattr(x, n) for x in robot.links]) for n in names)
    value = mass / length * length.sum() / mass.sum()
    sd = None
    if any(x is not None for error in errors for x in error):
        mass_sd, length_sd = (np.nan_to_num(error.astype(float)) for error in errors)
        by_mass = np.diag(1 / mass) - 1 / mass.sum()
        by_length = 1 / length.sum() - np.diag(1 / length)
        sd = value * np.hypot(
            np.linalg.norm(by_mass * mass_sd, axis=1), np.linalg.norm(by_length * length_sd, axis=1)
        )
    return Density(tuple(x.name for x in robot.links), value, sd, mass, length)


def with_density(model: Model, density: Density) -> Model:
    """Model with ``body.normalised_density``, and ``normalised_density_sd`` if known."""
    body = dict(model.body) | {"normalised_density": [float(x) for x in density.value]}
    body.pop("normalised_density_sd", None)
    if density.sd is not None:
        body["normalised_density_sd"] = [float(x) for x in density.sd]
    return replace(model, body=body)
