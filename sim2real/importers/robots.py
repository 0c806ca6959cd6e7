"""Conversion of a tree of bodies and hinges, as in a URDF, to a ``robot.toml``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.structured import check_label
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
            for name, values in (
                ("mass_kg", body.mass),
                ("com_m", body.com),
                ("inertia_kgm2", body.inertia),
            ):
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
    if groups is None:
        notes.append("links: the joints branch, and a robot here is a chain: choose by --joints")
    else:
        for k, group in enumerate(groups):
            text += _link(tree, chosen, k, group, notes)
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
    if groups is not None:
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


def _groups(tree: Tree, chosen: Sequence[Hinge]) -> list[list[Body]] | None:
    """The bodies of each link, from head to tail; None if the joints branch."""
    number = {hinge.body: k + 1 for k, hinge in enumerate(chosen)}

    def link_of(body: str) -> int:
        while body not in number and tree.bodies[body].parent:
            body = tree.bodies[body].parent
        return number.get(body, 0)

    if len(number) != len(chosen):  # two hinges on one body: nothing between them
        return None
    for k, hinge in enumerate(chosen):
        if link_of(tree.bodies[hinge.body].parent) != k:
            return None
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
        turned = chosen[max(k - 1, 0)].axis
        values["inertia_kgm2"] = float(turned @ _about(com, group) @ turned)
    rows = (
        f"{field} = {value:.9g}\n"
        for field, value in values.items()
        if value > 0 or (field == "com_m" and value == 0)
    )
    return f"\n[[links]]\nname = {_quoted(name)}\n" + "".join(rows)


def _about(com: Array, group: Sequence[Body]) -> Array:
    """Inertia of bodies together about a point, shape (3, 3)."""
    total = np.zeros((3, 3))
    for body in group:
        arm = body.com - com
        total += body.inertia + body.mass * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return total


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
