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
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        child = _end(file, joint, "child", links)
        parent = _end(file, joint, "parent", links)
        if child in above:
            raise InputError(file, f"link {child}", "two joints that it hangs on", "one")
        above[child], parents[child] = joint, parent
    frames = _frames(file, [*links], above, parents)
    bodies, hinges, left_out, not_taken = {}, [], [], []
    for name, frame in frames.items():
        bodies[name] = _body(file, links[name], parents.get(name, ""), *frame)
        if name not in above:
            continue
        joint, kind = above[name], above[name].get("type")
        if kind in TURNS:
            hinges.append(_hinge(file, joint, name, *frame))
            here = [what for tag, what in NOT_TAKEN.items() if joint.find(tag) is not None]
            not_taken += [f"{_name(file, joint)}: {what}: not taken" for what in here]
        elif kind != "fixed":
            left_out.append(f"{_name(file, joint)}: a {kind} joint: taken for stiff")
    title = root.get("name", "robot")
    return Tree(str(file), title, bodies, hinges, (*left_out, *not_taken))


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


def _frames(
    file: Path, links: list[str], above: dict[str, Element], parents: dict[str, str]
) -> dict[str, Frame]:
    """Frame of each link with every joint at 0, parents before their children."""
    bases = [name for name in links if name not in above]
    if len(bases) != 1:
        raise InputError(file, "link", f"{len(bases)} links that hang on no joint", "one")
    frames: dict[str, Frame] = {}
    waiting: list[tuple[str, Frame]] = [(bases[0], (np.zeros(3), np.eye(3)))]
    while waiting:
        name, (place, turned) = waiting.pop()
        frames[name] = place, turned
        for child in reversed([child for child, parent in parents.items() if parent == name]):
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
    axis = _vector(file, joint.find("axis"), "xyz", name, "1 0 0")
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        raise InputError(file, f"joint {name}, axis", "a vector of no length", "a direction")
    low, high, torque, speed = (
        _number(file, joint.find("limit"), end, f"joint {name}, limit", 0.0, math.inf)
        for end in ("lower", "upper", "effort", "velocity")  # of which many are placeholders
    )
    ends = (low, high) if low < high and joint.get("type") == "revolute" else None
    return Hinge(name, body, turned @ axis / size, place, ends, torque or None, speed or None)


def _origin(file: Path, element: Element) -> Frame:
    """Place and rotation of an element; roll, pitch and yaw turn about fixed axes in that order."""
    from scipy.spatial.transform import Rotation

    origin, name = element.find("origin"), element.get("name", element.tag)
    angles = _vector(file, origin, "rpy", name)
    return _vector(file, origin, "xyz", name), Rotation.from_euler("xyz", angles).as_matrix()


def _vector(
    file: Path, element: Element | None, name: str, where: str, default: str = "0 0 0"
) -> Array:
    if element is None:
        return np.array(default.split(), dtype=np.float64)
    text = element.get(name, "0 0 0")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.size != 3 or not (np.abs(values) <= _LARGEST).all():
        expected = f"three numbers within {_LARGEST:g}"
        raise InputError(file, f"{where}, {element.tag} {name}", shown(text), expected)
    return values


def _number(
    file: Path,
    element: Element | None,
    name: str,
    where: str,
    default: float | None = None,
    largest: float = _LARGEST,
) -> float:
    text = None if element is None else element.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not math.isfinite(value) or abs(value) > largest:
        expected = "a number" if largest == math.inf else f"a number within {largest:g}"
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
