"""The description of a robot: links and their density, joints, data sheets of its servos.

A file needs only the values that are used: a missing value is an error where it is used.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, overload

import numpy as np

from sim2real.appendages import Appendage, read_appendage
from sim2real.arm.description import Arm, read_arm
from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.inference.normal import Z90
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.structured import Fields, read_toml

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Place = tuple[str, str]
"""A file and a table in it, for messages."""

LIMITS = "two angles in rad, the smaller first"


T = TypeVar("T")


class Stated(Generic[T]):
    """A value that may be missing and then raises an InputError, of a class with ``where``."""

    def __init__(self, expected: str = "a number above 0") -> None:
        self.expected = expected

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type) -> T: ...
    def __get__(self, instance: object | None, owner: type) -> Self | T:
        if instance is None:
            return self
        value: T | None = vars(instance)[self.name]
        if value is None:
            file, table = vars(instance)["where"]
            raise InputError(file, f"{table}.{self.name}", "nothing", self.expected)
        return value

    def __set__(self, instance: object, value: Any) -> None:  # noqa: ANN401 - the default is self
        vars(instance)[self.name] = None if value is self else value


class Sheet:
    """A named dataclass with ``Stated`` values, compared regardless of where it was read."""

    name: str

    @classmethod
    def keys(cls) -> list[str]:
        """Keys of its table in the file."""
        return [name for name in cls.__annotations__ if name != "where"]

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
    mass_kg: Stated[float] = Stated()
    length_m: Stated[float] = Stated()
    width_m: Stated[float] = Stated()
    height_m: Stated[float] = Stated()
    material: str | None = None
    com_m: float | None = None
    inertia_kgm2: float | None = None
    mass_sd_kg: float | None = None
    length_sd_m: float | None = None
    appendages: tuple[Appendage, ...] = ()
    where: Place = ("robot", "link")


@dataclass(frozen=True, eq=False, repr=False)
class Servo(Sheet):
    """Data sheet of a servo."""

    name: str
    max_torque_Nm: Stated[float] = Stated()
    no_load_speed_rad_s: Stated[float] = Stated()
    position_step_rad: Stated[float] = Stated("a number of at least 0")
    where: Place = ("robot", "servos")


@dataclass(frozen=True, eq=False, repr=False)
class Joint(Sheet):
    """Joint k connects links k and k + 1 and is driven by ``servo`` within ``limits_rad``."""

    name: str
    servo: Servo
    limits_rad: Stated[tuple[float, float]] = Stated(LIMITS)
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


def _servo(name: str, fields: Fields) -> Servo:
    if "type" in fields:  # of earlier versions
        warnings.warn(f"{fields.file}: {fields.path('type')} is ignored", stacklevel=2)
    fields.refuse_unknown([*Servo.keys()[1:], *(["type"] if "type" in fields else [])])
    number, where = fields.optional_number, (str(fields.file), fields.where)
    torque, speed = (number(key, above=0) for key in ("max_torque_Nm", "no_load_speed_rad_s"))
    return Servo(name, torque, speed, number("position_step_rad", low=0), where)


def _link(fields: Fields) -> Link:
    fields.refuse_unknown(Link.keys())
    tables = fields.tables("appendages") if "appendages" in fields else []
    number = fields.optional_number
    length, com = number("length_m", above=0), number("com_m", low=0)
    ends = [length or math.inf]
    appendages = tuple(read_appendage(table, length) for table in tables)
    ends += [one.at_m[0] + one.size_m[0] / 2 for one in appendages]
    if com is not None and com > max(ends):
        raise fields.error("com_m", f"a place on the link, at most {max(ends):g} m from its front")
    measures = ("mass_kg", "length_m", "width_m", "height_m")
    optional = ("com_m", "inertia_kgm2", "mass_sd_kg", "length_sd_m")
    return Link(
        name=fields.label("name"),
        material=fields.text("material") if "material" in fields else None,
        appendages=appendages,
        where=(str(fields.file), fields.where),
        **{name: number(name, above=0) for name in measures},
        **{name: number(name, low=0) for name in optional},
    )


def _joint(fields: Fields, servos: dict[str, Servo]) -> Joint:
    fields.refuse_unknown(Joint.keys())
    servo = fields.text("servo")
    if servo not in servos:
        raise fields.error("servo", f"one of the [servos.*] tables ({', '.join(servos) or 'none'})")
    limits = None
    if "limits_rad" in fields:
        low, high = limits = tuple(fields.numbers("limits_rad", LIMITS, 2))
        if low >= high:
            raise fields.error("limits_rad", LIMITS)
        if max(abs(low), abs(high)) > LARGEST_ANGLE_RAD:
            expected = f"two angles in rad within {LARGEST_ANGLE_RAD:.1f} (are they degrees?)"
            raise fields.error("limits_rad", expected)
    return Joint(fields.label("name"), servos[servo], limits, (str(fields.file), fields.where))


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

    def plot(self) -> Figure:
        """Bar chart of the normalised density of each link."""
        figure: Figure = from_report("ranges.density_figure")(self)
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
