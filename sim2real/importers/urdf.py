"""Robots from URDF: http://wiki.ros.org/urdf/XML."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, shown
from sim2real.importers.robots import Body, Hinge, Tree
from sim2real.structured import read_text

_LARGEST = 1e9
"""Largest size of a number, SI."""

TURNS = ("revolute", "continuous")
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
        """Its position (3,) and rotation (3, 3), from those of the element that it is in.

        Roll, pitch and yaw turn about fixed axes in that order.
        """
        from scipy.spatial.transform import Rotation

        origin = self.part("origin")
        rotation = Rotation.from_euler("xyz", origin.vector("rpy")).as_matrix()
        return place + turned @ origin.vector("xyz"), turned @ rotation


def read_urdf(path: str | os.PathLike[str]) -> Tree:
    """The links and joints of a URDF, every joint at 0; xacro must have been run on it.

    ``InputError`` if it is no URDF, or its links do not form a tree.
    """
    file = Path(path)
    root = _root(file)
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
            if kind in TURNS:
                hinges.append(_hinge(hung, title, name, place, turned))
                here = [
                    what for tag, what in NOT_TAKEN.items() if hung.part(tag).element is not None
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


def _root(file: Path) -> Element:
    text = read_text(file)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(file, "", "a document type", "a URDF without one")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(file, "", f"no XML ({error})", "a URDF") from None
    if root.tag != "robot":
        raise InputError(file, "", f"<{root.tag}>", "<robot>")
    return root


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
