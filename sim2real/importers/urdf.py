"""Robots from URDF (http://wiki.ros.org/urdf/XML), and their conversion to a ``robot.toml``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, shown
from sim2real.structured import check_label, read_text
from sim2real.units import plausible

PLACEHOLDER = {"max_torque_Nm": 1000.0, "no_load_speed_rad_s": 100.0}
"""Smallest limits that no servo has: files of robots state them where a number is required."""


@dataclass(frozen=True)
class Body:
    """One body, in the frame of the base with every joint at 0."""

    name: str
    parent: str  # name of its parent body; empty for the base
    mass: float  # mass in kg; 0 if not stated
    com: Array  # centre of mass in m, shape (3,)
    inertia: Array  # about the centre of mass in kg m2, shape (3, 3)


@dataclass(frozen=True)
class Hinge:
    """A joint of ``body`` with an ``axis`` through ``origin``, both of shape (3,)."""

    name: str
    body: str
    axis: Array
    origin: Array
    limits: tuple[float, float] | None = None
    torque: float | None = None
    speed: float | None = None


@dataclass(frozen=True)
class Tree:
    """A robot in another format; ``left_out`` lists parts that cannot be represented here."""

    file: str
    name: str
    bodies: dict[str, Body]
    hinges: list[Hinge]
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in (self.name, *self.bodies, *(hinge.name for hinge in self.hinges)):
            check_label(self.file, "name", name)
        for body in self.bodies.values():
            numbers = {"com_m": body.com, "inertia_kgm2": body.inertia}
            for name, values in {"mass_kg": np.array(body.mass), **numbers}.items():
                _, largest, unit = plausible(name)
                found = float(np.abs(values).max())
                if not found <= largest:
                    expected = f"at most {largest:g} {unit} in size"
                    raise InputError(self.file, f"{body.name}: {name}", f"{found:g}", expected)


def robot_toml(tree: Tree, joints: Sequence[str] | None = None) -> tuple[str, list[str]]:
    """A robot file, and a list of parts that it omits or that have to be filled in.

    Bodies between two joints become one rigid link at angle 0; joints that are not chosen are rigid
    as well. The length of a link is from its joint to the axis of the next, its inertia about an
    axis through its centre of mass parallel to its joint (the head: to the first joint). Without a
    chain of joints no links are written, as robots here are chains. ``InputError`` if there is no
    hinge, or a joint is not one.
    """
    chosen = _chosen(tree, joints)
    notes = list(tree.left_out)
    text = f"name = {_quoted(tree.name)}\n"
    groups = _groups(tree, chosen)
    if not groups:
        notes.append("links: the joints branch, and a robot here is a chain: choose by --joints")
    text += "".join(_link(tree, chosen, k, group, notes) for k, group in enumerate(groups))
    servos: dict[tuple[float | None, float | None], str] = {}
    for hinge in chosen:
        servo = servos.setdefault((hinge.torque, hinge.speed), f"servo{len(servos) + 1}")
        text += f"\n[[joints]]\nname = {_quoted(hinge.name)}\nservo = {_quoted(servo)}\n"
        if hinge.limits is not None:
            text += f"limits_rad = [{hinge.limits[0]:.9g}, {hinge.limits[1]:.9g}]\n"
        else:
            notes.append(f"{hinge.name}: limits_rad: not stated")
    for (torque, speed), name in servos.items():
        text += f"\n[servos.{name}]\n"
        # Exporters of CAD write 10, 100 and so on as both limits of every joint.
        alike = torque is not None and torque == speed and torque in (10.0, 100.0)
        for field, value in (("max_torque_Nm", torque), ("no_load_speed_rad_s", speed)):
            if value is None or value <= 0:
                notes.append(f"{name}: {field}: not stated")
            elif alike or value >= PLACEHOLDER[field]:
                what = f"{value:g}, a placeholder" + (" (torque and speed alike)" if alike else "")
                notes.append(f"{name}: {field}: {what}: take it from the data sheet")
            else:
                text += f"{field} = {value:.9g}\n"
        notes.append(f"{name}: position_step_rad: take it from the data sheet")
    if groups:
        notes.append("links: width_m and height_m: measure them, if the robot is to swim")
    return text, notes


def _chosen(tree: Tree, joints: Sequence[str] | None) -> list[Hinge]:
    hinges = {hinge.name: hinge for hinge in tree.hinges}
    if not hinges:
        raise InputError(tree.file, "joints", "no hinge", "at least one joint that turns")
    if joints and len(set(joints)) != len(joints):
        raise InputError("--joints", "", ", ".join(joints), "each joint once")
    for name in joints or ():
        if name not in hinges:
            raise InputError(tree.file, "joints", f"no hinge {name}", f"one of {', '.join(hinges)}")
    return [hinges[name] for name in joints or hinges]


def _groups(tree: Tree, chosen: Sequence[Hinge]) -> list[list[Body]]:
    """The bodies of each link, from head to tail; none if the joints branch."""
    number = {hinge.body: k + 1 for k, hinge in enumerate(chosen)}

    def link_of(body: str) -> int:
        while body not in number and tree.bodies[body].parent:
            body = tree.bodies[body].parent
        return number.get(body, 0)

    above = [link_of(tree.bodies[hinge.body].parent) for hinge in chosen]
    # two hinges on one body have nothing between them
    if len(number) != len(chosen) or above != list(range(len(chosen))):
        return []
    groups: list[list[Body]] = [[] for _ in range(len(chosen) + 1)]
    for body in tree.bodies.values():
        groups[link_of(body.name)].append(body)
    return groups


def _link(tree: Tree, chosen: Sequence[Hinge], k: int, group: list[Body], notes: list[str]) -> str:
    """The table of link k; its bodies together, by the parallel axis theorem."""
    name = tree.bodies[chosen[k - 1].body].name if k else (group[0].name if group else "base")
    mass = sum(body.mass for body in group)
    length, along, front = 0.0, np.zeros(3), np.zeros(3)
    if 0 < k < len(chosen):
        front, axis = chosen[k - 1].origin, chosen[k - 1].axis
        between = chosen[k].origin - front
        along = between - axis * float(axis @ between)
        length = float(np.linalg.norm(along))
    values = {"mass_kg": mass, "length_m": length if length > 1e-9 else 0.0}
    notes += [f"{name}: {field}: not stated" for field, value in values.items() if value <= 0]
    if mass > 0:
        com = sum((body.mass * body.com for body in group), np.zeros(3)) / mass
        if length > 1e-9:
            values["com_m"] = float(along / length @ (com - front))
            if values["com_m"] < 0:
                notes.append(f"{name}: com_m: {values['com_m']:.3g}, in front of its joint")
        turned, total = chosen[max(k - 1, 0)].axis, np.zeros((3, 3))
        for body in group:
            arm = body.com - com
            total += body.inertia + body.mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm))
        values["inertia_kgm2"] = float(turned @ total @ turned)
    text = f"\n[[links]]\nname = {_quoted(name)}\n"
    for field, value in values.items():
        if value > 0 or (field == "com_m" and value == 0):
            text += f"{field} = {value:.9g}\n"
    return text


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


_LARGEST = 1e9
"""Largest size of a number, SI."""

NOT_TAKEN = {
    "mimic": "its coupling to another joint (mimic)",
    "dynamics": "damping and friction (identify finds them)",
}
"""Elements of a joint that a robot here has no place for."""


@dataclass(frozen=True)
class _Part:
    """An element of a URDF, if it is there, and its place for messages."""

    file: Path
    where: str
    element: Element | None

    def part(self, tag: str) -> _Part:
        """The first element of this name within it."""
        inside = None if self.element is None else self.element.find(tag)
        return _Part(self.file, f"{self.where}, {tag}", inside)

    def text(self, name: str) -> str | None:
        """The text of an attribute."""
        return None if self.element is None else self.element.get(name)

    def number(self, name: str, default: float | None = None, largest: float = _LARGEST) -> float:
        """A number of at most this size."""
        text = self.text(name)
        if text is None and default is not None:
            return default
        try:
            value = float(text or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > largest:
            expected = "a number" if largest == math.inf else f"a number within {largest:g}"
            found = shown(text) if text else "nothing"
            raise InputError(self.file, f"{self.where} {name}", found, expected)
        return value

    def vector(self, name: str, absent: str = "0 0 0") -> Array:
        """Three numbers, shape (3,)."""
        text = absent if self.element is None else self.element.get(name, "0 0 0")
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.empty(0)
        if values.size != 3 or not (np.abs(values) <= _LARGEST).all():
            expected = f"three numbers within {_LARGEST:g}"
            raise InputError(self.file, f"{self.where} {name}", shown(text), expected)
        return values

    def frame(self, place: Array, turned: Array) -> tuple[Array, Array]:
        """Its position (3,) and rotation (3, 3); roll, pitch and yaw turn about fixed axes."""
        from scipy.spatial.transform import Rotation

        origin = self.part("origin")
        rotation = Rotation.from_euler("xyz", origin.vector("rpy")).as_matrix()
        return place + turned @ origin.vector("xyz"), turned @ rotation


def read_urdf(path: str | os.PathLike[str]) -> Tree:
    """The links and joints of a URDF, without xacro, every joint at 0; else ``InputError``."""
    file = Path(path)
    text = read_text(file)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(file, "", "a document type", "a URDF without one")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(file, "", f"no XML ({error})", "a URDF") from None
    if root.tag != "robot":
        raise InputError(file, "", f"<{root.tag}>", "<robot>")
    links = {_name(file, link): link for link in root.findall("link")}
    above: dict[str, Element] = {}
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        child, parent = (_end(file, joint, end, links) for end in ("child", "parent"))
        if child in above:
            raise InputError(file, f"link {child}", "two joints that it hangs on", "one")
        above[child], parents[child] = joint, parent
    bases = [name for name in links if name not in above]
    if len(bases) != 1:
        raise InputError(file, "link", f"{len(bases)} links that hang on no joint", "one")
    bodies: dict[str, Body] = {}
    hinges, left_out, not_taken = [], [], []
    waiting = [(bases[0], np.zeros(3), np.eye(3))]
    while waiting:
        name, place, turned = waiting.pop()
        if name in above:
            title = _name(file, above[name])
            hung = _Part(file, f"joint {title}", above[name])
            place, turned = hung.frame(place, turned)
            kind = hung.text("type")
            if kind in ("revolute", "continuous"):
                hinges.append(_hinge(hung, title, name, place, turned))
                here = [
                    what for tag, what in NOT_TAKEN.items() if above[name].find(tag) is not None
                ]
                not_taken += [f"{title}: {what}: not taken" for what in here]
            elif kind != "fixed":
                left_out.append(f"{title}: a {kind} joint: taken for stiff")
        link = _Part(file, f"link {name}", links[name])
        bodies[name] = _body(link, name, parents.get(name, ""), place, turned)
        children = [child for child, parent in parents.items() if parent == name]
        waiting += [(child, place, turned) for child in reversed(children)]
    if len(bodies) != len(links):
        raise InputError(file, "joint", "links in a ring", "a tree")
    return Tree(str(file), root.get("name", "robot"), bodies, hinges, (*left_out, *not_taken))


def _body(link: _Part, name: str, parent: str, place: Array, turned: Array) -> Body:
    inertial = link.part("inertial")
    if inertial.element is None:
        return Body(name, parent, 0.0, place, np.zeros((3, 3)))
    mass, moments = inertial.part("mass").number("value"), inertial.part("inertia")
    terms = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
    tensor = np.reshape([moments.number(term, 0.0) for term in terms], (3, 3))
    com, frame = inertial.frame(place, turned)
    return Body(name, parent, mass, com, frame @ tensor @ frame.T)


def _hinge(joint: _Part, name: str, body: str, place: Array, turned: Array) -> Hinge:
    axis, limit = joint.part("axis").vector("xyz", "1 0 0"), joint.part("limit")
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        raise InputError(joint.file, f"{joint.where}, axis", "a vector of no length", "a direction")
    low, high, torque, speed = (  # of which many are placeholders
        limit.number(end, 0.0, math.inf) for end in ("lower", "upper", "effort", "velocity")
    )
    ends = (low, high) if low < high and joint.text("type") == "revolute" else None
    return Hinge(name, body, turned @ axis / size, place, ends, torque or None, speed or None)


def _name(file: Path, element: Element) -> str:
    name = element.get("name")
    if not name:
        raise InputError(file, f"<{element.tag}>", "no name", "a name")
    return name


def _end(file: Path, joint: Element, end: str, links: dict[str, Element]) -> str:
    """The link at one end of a joint."""
    link = _Part(file, "", joint).part(end).text("link")
    if link not in links or link is None:
        found = shown(link) if link else "nothing"
        raise InputError(file, f"joint {_name(file, joint)}, {end}", found, "the name of a link")
    return link
