"""Arrays of parameters that may differ between the robots of a batch, one row per robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim.robot.chain import RING, Chain, Motion
from sim.robot.effects import Outside, about
from sim.robot.shape import Hull
from sim2real.arrays import Array, Index
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import CELLS, COLUMNS, TRAIN_ROTORS, beyond_load, joint_row
from sim2real.servo.rollout import active_effects


@dataclass(frozen=True)
class Masses:
    """Masses of the links; shape (E, L) or (L,), SI."""

    mass: Array  # mass in kg
    inertia: Array  # moment of inertia about the centre of mass in kg m2
    com: Array  # distance of the centre of mass from the link's front end in m


_KINDS: Mapping[str, Any] = {
    "mass": wp.vec2d,
    "water": wp.vec2d,
    "resist": wp.vec4d,
    "point": wp.vec4d,
    "laden": wp.mat33d,
    "skin": wp.vec4d,
    "tether": wp.vec3d,
    "current": wp.vec2d,
    "active": wp.int64,
    "tip": wp.vec2d,
    "along": wp.vec2d,
    "wake": wp.vec2d,
}


def chain_rows(masses: Masses, servos: Array, outside: Outside, E: int) -> dict[str, NDArray[Any]]:
    """Rows of ``Chain`` that are the same in the fluid and the twin.

    Args:
        masses: Masses of the links, shape (E, L) or (L,).
        servos: Rows of the servo law's parameters, shape (E, J, P).
        outside: Effects of the body.
        E: Number of robots.
    """
    J, L = servos.shape[1], servos.shape[1] + 1
    flat = np.ascontiguousarray(servos).reshape(E * J, len(COLUMNS))
    com = np.broadcast_to(masses.com + outside.com, (E, L))
    side = np.broadcast_to(outside.side, (E, L))
    point = np.array(np.broadcast_to(outside.point, (E, L, *outside.point.shape[-2:])))
    point[..., 0] = com[..., None] - point[..., 0]
    point[..., 1] -= side[..., None]
    return {
        "com": com,
        "side": side,
        "point": point,
        "laden": about(np.broadcast_to(outside.laden, (E, L, 3, 3)), -com, side),
        "rough": np.broadcast_to(outside.rough, (E, L)),
        "skin": np.broadcast_to(outside.skin, (E, J, 4)),
        "coupling": np.broadcast_to(outside.coupling, (E,)),
        "tether": np.broadcast_to(outside.tether, (E, 3)),
        "current": np.broadcast_to(outside.current, (E, 2)),
        "trim": np.broadcast_to(outside.trim, (E, J)),
        "servo": servos,
        "active": active_effects(flat).reshape(E, J),
    }


def make_rows(struct: Any, rows: Mapping[str, NDArray[Any]], device: Any) -> None:  # noqa: ANN401
    """Make the arrays of a Warp struct from rows for all robots."""
    for name, values in rows.items():
        kind = _KINDS.get(name, wp.float64)
        array: Any = wp.array(np.ascontiguousarray(values), dtype=kind, device=device)
        setattr(struct, name, array)


def make_chain(
    rows: Mapping[str, NDArray[Any]],
    length: Array,
    limits: Array,
    device: Any,  # noqa: ANN401
) -> Chain:
    """Parameters of robots on a device, from their rows, the links' lengths and joints' limits."""
    chain = Chain()
    make_rows(chain, rows, device)
    make_rows(chain, {"length": length}, device)
    E, J = rows["active"].shape
    ends = np.ascontiguousarray(limits, dtype=np.float64).reshape(J, 2)
    chain.limits = wp.array(ends, dtype=wp.vec2d, device=device)
    chain.memory = wp.zeros((E, J, CELLS), dtype=wp.float64, device=device)
    chain.push = wp.zeros((E, 3 + J), dtype=wp.float64, device=device)
    return chain


def make_motion(E: int, L: int, device: Any) -> Motion:  # noqa: ANN401 - Warp has no stubs
    """The state of E robots with L links on a device, all 0 and without set-points."""

    def room(shape: tuple[int, ...], kind: Any) -> Any:  # noqa: ANN401
        return wp.zeros(shape, dtype=kind, device=device)

    s, J, N = Motion(), L - 1, L + 2
    s.q, s.v, s.b = (room((E, N), wp.float64) for _ in range(3))
    s.link, s.twist, s.before, s.force, s.inner = (room((E, L), wp.vec3d) for _ in range(5))
    s.held, s.joint = room((E, L), wp.vec3d), room((E, J), wp.vec2d)
    s.fresh, s.clock = room((E,), wp.int32), room((E,), wp.float64)
    s.torque, s.impulse, s.stop = (room((E, J), wp.float64) for _ in range(3))
    s.measured, s.strain = (room((E, J), wp.float64) for _ in range(2))
    s.sent, s.arrival = (room((E, J, RING), wp.float64) for _ in range(2))
    s.newest = wp.full((E, J), -1, dtype=wp.int32, device=device)
    s.A, s.inverse = (room((E, N, N), wp.float64) for _ in range(2))
    return s


def change_rows(
    struct: Any,  # noqa: ANN401 - a Warp struct
    rows: Mapping[str, NDArray[Any]],
    which: Index,
) -> None:
    """Overwrite the rows of some robots, in place: captured graphs stay valid."""
    for name, values in rows.items():
        array = getattr(struct, name)
        content = array.numpy()
        content[which] = values
        array.assign(content)


def changed(outside: Outside, replacement: Outside, which: Index, E: int) -> Outside:
    """The effects of E robots, with those of some robots replaced."""
    merged: dict[str, Array] = {}
    for field in fields(Outside):
        new = getattr(replacement, field.name)
        content = np.array(np.broadcast_to(getattr(outside, field.name), (E, *new.shape[1:])))
        content[which] = new
        merged[field.name] = content
    return Outside(**merged)


def masses(robot: Robot, models: Sequence[Model], hull: Hull) -> Masses:
    """Masses of the links, by the model's normalised densities where it has them.

    A normalised density is (m_i / l_i) (sum l / sum m): Lin, Liu, Wang (2024), Sec. III-B.1. An
    inertia that the file lacks is that of an elliptic cylinder.
    """
    total = sum(link.mass_kg for link in robot.links)
    length = np.array([link.length_m for link in robot.links])
    width = np.array([link.width_m for link in robot.links])
    nominal = np.array([link.mass_kg for link in robot.links])
    mass = np.tile(nominal, (len(models), 1))
    for row, model in zip(mass, models, strict=True):
        if "normalised_density" in model.body:
            if len(model.body["normalised_density"]) != len(row):
                found = f"{len(model.body['normalised_density'])} values"
                expected = f"{len(row)}, one for each link"
                raise InputError("model", "body.normalised_density", found, expected)
            row[:] = np.asarray(model.body["normalised_density"]) * total * length / length.sum()
    com = np.array(
        [link.length_m / 2 if link.com_m is None else link.com_m for link in robot.links]
    )
    com[0] -= hull.half_width[0, 0]  # the hull's first axis begins behind the nose
    inertia = mass * (length**2 / 12 + width**2 / 16)
    for k, link in enumerate(robot.links):
        if link.inertia_kgm2 is not None:
            inertia[:, k] = link.inertia_kgm2 * mass[:, k] / nominal[k]
    return Masses(mass, inertia, np.broadcast_to(com, mass.shape))


def servo_rows(robot: Robot, models: Sequence[Model]) -> Array:
    """Rows of the servo law's parameters, shape (E, J, P).

    Raises:
        InputError: If a model lacks a joint, or has its gains only per unit of inertia.
    """
    rows = []
    for model in models:
        for joint in robot.joints:
            if joint.name not in model.joints:
                known = ", ".join(model.joints) or "none"
                raise InputError("model", "joints", f"{known}", f"the robot's joint {joint.name}")
            servo = model.joints[joint.name]
            if servo.per_inertia:
                raise InputError(
                    "model", f"joints.{joint.name}", "gains per unit of inertia",
                    "gains in N m, from recordings that state their loads",
                )  # fmt: skip
            row = joint_row(servo, None, joint.name, alone=False)
            row[4] = 0.0  # no pendulum in the water
            if row[list(TRAIN_ROTORS)].any():  # the terms of a gear train know one inertia
                row[3] += beyond_load(row)
            rows.append(row)
    return np.array(rows).reshape(len(models), len(robot.joints), -1)
