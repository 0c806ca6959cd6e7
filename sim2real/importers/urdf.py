"""Robots from URDF: http://wiki.ros.org/urdf/XML."""

from __future__ import annotations

import math
import os
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, shown
from sim2real.importers.chain import Body, Hinge, Tree
from sim2real.structured import read_text

_LARGEST = 1e9
"""Largest size of a number, SI."""

TURNS = ("revolute", "continuous")
NOT_TAKEN = {
    "mimic": "its coupling to another joint (mimic)",
    "dynamics": "damping and friction (identify finds them)",
}
"""Elements of a joint that a robot here has no place for."""
Frame = tuple[Array, Array]  # position of the origin, (3,), and rotation, (3, 3)


def read_urdf(path: str | os.PathLike[str]) -> Tree:
    """The links and joints of a URDF, every joint at 0.

    Args:
        path: The file; xacro must have been run on it.

    Raises:
        InputError: If it is no URDF, or its links do not form a tree.
    """
    file = Path(path)
    root = _root(file)
    links = {_name(file, link): link for link in root.findall("link")}
    above: dict[str, Element] = {}
    for joint in root.findall("joint"):
        child = _end(file, joint, "child", links)
        _end(file, joint, "parent", links)
        if child in above:
            raise InputError(file, f"link {child}", "two joints that it hangs on", "one")
        above[child] = joint
    frames = _frames(file, links, above)
    bodies = {
        name: _body(file, links[name], _end(file, above[name], "parent", links), *frame)
        if name in above
        else _body(file, links[name], "", *frame)
        for name, frame in frames.items()
    }
    hung = {name: above[name] for name in frames if name in above}
    left_out = [
        f"{_name(file, joint)}: a {joint.get('type')} joint: taken for stiff"
        for joint in hung.values()
        if joint.get("type") not in (*TURNS, "fixed")
    ]
    left_out += [
        f"{_name(file, joint)}: {what}: not taken"
        for joint in hung.values()
        for tag, what in NOT_TAKEN.items()
        if joint.find(tag) is not None and joint.get("type") in TURNS
    ]
    hinges = [
        _hinge(file, joint, body, *frames[body])
        for body, joint in hung.items()
        if joint.get("type") in TURNS
    ]
    return Tree(str(file), root.get("name", "robot"), bodies, hinges, tuple(left_out))


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


def _frames(file: Path, links: dict[str, Element], above: dict[str, Element]) -> dict[str, Frame]:
    """Frame of each link with every joint at 0, parents before their children."""
    bases = [name for name in links if name not in above]
    if len(bases) != 1:
        raise InputError(file, "link", f"{len(bases)} links that hang on no joint", "one")
    below: dict[str, list[str]] = {name: [] for name in links}
    for child, joint in above.items():
        below[_end(file, joint, "parent", links)].append(child)
    frames: dict[str, Frame] = {}
    waiting: list[tuple[str, Frame]] = [(bases[0], (np.zeros(3), np.eye(3)))]
    while waiting:
        name, (place, turned) = waiting.pop()
        frames[name] = place, turned
        for child in reversed(below[name]):
            offset, rotation = _origin(file, above[child])
            waiting.append((child, (place + turned @ offset, turned @ rotation)))
    if len(frames) != len(links):
        raise InputError(file, "joint", "links in a ring", "a tree")
    return frames


def _body(file: Path, link: Element, parent: str, place: Array, turned: Array) -> Body:
    inertial = link.find("inertial")
    name = _name(file, link)
    if inertial is None:
        return Body(name, parent, 0.0, place, np.zeros((3, 3)))
    offset, rotation = _origin(file, inertial)
    mass = _number(file, inertial.find("mass"), "value", f"link {name}, mass")
    moments = inertial.find("inertia")
    xx, yy, zz, xy, xz, yz = (
        _number(file, moments, term, f"link {name}, inertia", 0.0)
        for term in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    frame = turned @ rotation
    return Body(name, parent, mass, place + turned @ offset, frame @ tensor @ frame.T)


def _hinge(file: Path, joint: Element, body: str, place: Array, turned: Array) -> Hinge:
    name = _name(file, joint)
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if element is None else _vector(file, element, "xyz", name)
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        raise InputError(file, f"joint {name}, axis", "a vector of no length", "a direction")
    limit = joint.find("limit")
    ends = torque = speed = None
    if limit is not None:
        torque = _number(file, limit, "effort", f"joint {name}, limit", 0.0) or None
        speed = _number(file, limit, "velocity", f"joint {name}, limit", 0.0) or None
        low, high = (
            _number(file, limit, end, f"joint {name}, limit", 0.0) for end in ("lower", "upper")
        )
        ends = (low, high) if low < high and joint.get("type") == "revolute" else None
    return Hinge(name, body, turned @ axis / size, place, ends, torque, speed)


def _origin(file: Path, element: Element) -> Frame:
    """Place and rotation of an element; roll, pitch and yaw turn about fixed axes in that order."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    name = element.get("name", element.tag)
    (a, b, c) = _vector(file, origin, "rpy", name)
    sines, cosines = np.sin([a, b, c]), np.cos([a, b, c])
    roll = np.array([[1, 0, 0], [0, cosines[0], -sines[0]], [0, sines[0], cosines[0]]])
    pitch = np.array([[cosines[1], 0, sines[1]], [0, 1, 0], [-sines[1], 0, cosines[1]]])
    yaw = np.array([[cosines[2], -sines[2], 0], [sines[2], cosines[2], 0], [0, 0, 1]])
    return _vector(file, origin, "xyz", name), yaw @ pitch @ roll


def _vector(file: Path, element: Element, name: str, where: str) -> Array:
    words = element.get(name, "0 0 0").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.empty(0)
    if values.size != 3 or not (np.abs(values) <= _LARGEST).all():
        found = shown(element.get(name))
        expected = f"three numbers within {_LARGEST:g}"
        raise InputError(file, f"{where}, {element.tag} {name}", found, expected)
    return values


def _number(
    file: Path, element: Element | None, name: str, where: str, default: float | None = None
) -> float:
    text = None if element is None else element.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    limit = math.inf if where.endswith("limit") else _LARGEST  # of which many are placeholders
    if not math.isfinite(value) or abs(value) > limit:
        expected = "a number" if limit == math.inf else f"a number within {limit:g}"
        raise InputError(file, f"{where} {name}", shown(text) if text else "nothing", expected)
    return value


def _name(file: Path, element: Element) -> str:
    name = element.get("name")
    if not name:
        raise InputError(file, f"<{element.tag}>", "no name", "a name")
    return name


def _end(file: Path, joint: Element, end: str, links: dict[str, Element]) -> str:
    """The link at one end of a joint."""
    element = joint.find(end)
    link = None if element is None else element.get("link")
    if link not in links or link is None:
        found = shown(link) if link else "nothing"
        raise InputError(file, f"joint {_name(file, joint)}, {end}", found, "the name of a link")
    return link
