"""The body's effects of models, as arrays for ``sim.robot.outside``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.lattice.units import WATER_KG_M3
from sim.robot.shape import Hull
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.effects import BODY
from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.model import Model
from sim2real.robot import Robot


@dataclass(frozen=True)
class Outside:
    """Effects on E robots in addition to the fluid's forces; shapes may be broadcast.

    Attributes:
        com: Shift of the centres of mass backwards in m, (E, 1).
        side: Shift of the centres of mass to the left of the axis in m, (E, 1).
        rough: Additional friction coefficient of each link's surface, (E, L).
        resist: For each link: drag in N s/m, drag along its axis in N s2/m2, added mass across it
            and added inertia relative to the displaced water, (E, L, 4).
        skin: For each joint: stiffness in N m/rad, damping in N m s/rad, relaxing stiffness in
            N m/rad, relaxation time in s, (E, J, 4).
        coupling: Stiffness between neighbouring joints in N m/rad, (E,).
        tether: Stiffness at the head in N/m, and the anchor's x and y in m, (E, 3).
        trim: Offset of the joints' angles in rad, (E, 1).
        current: Velocity of the pool's water in m/s, (E, 2).
        wall: Relative increase of the thrust by a wall one body length away, (E,).
    """

    com: Array
    side: Array
    rough: Array
    resist: Array
    skin: Array
    coupling: Array
    tether: Array
    trim: Array
    current: Array
    wall: Array


def outside(robot: Robot, models: Sequence[Model], hull: Hull) -> Outside:
    """The arrays for robots with these models: the sums of their effects.

    Raises:
        InputError: If a model's effect does not exist.
    """
    forces = [_forces(robot, model, hull) for model in models]

    def of(name: str) -> Array:
        return np.array([getattr(force, name) for force in forces], dtype=np.float64)

    return Outside(
        com=of("com")[:, None],
        side=of("side")[:, None],
        rough=of("rough"),
        resist=of("resist"),
        skin=of("skin"),
        coupling=of("coupling"),
        tether=of("tether"),
        trim=of("trim")[:, None],
        current=of("current"),
        wall=of("wall"),
    )


def _forces(robot: Robot, model: Model, hull: Hull) -> Forces:
    forces = Forces(
        np.asarray(hull.length),
        tuple(link.material or "" for link in robot.links),
        np.pi * float((hull.half_width * hull.half_height).max()),
        WATER_KG_M3,
    )
    parameters = values(model)
    for effect in BODY:
        names = [name for name in parameters if name.partition(".")[0] == effect.name]
        for material in dict.fromkeys(name.split(".")[1] for name in names if effect.by_material):
            effect.act(forces, _named(parameters, effect, f"{effect.name}.{material}"), material)
        if names and not effect.by_material:
            effect.act(forces, _named(parameters, effect, effect.name), "")
    return forces


def _named(parameters: Mapping[str, float], effect: BodyEffect, prefix: str) -> dict[str, float]:
    return {p.name: parameters.get(f"{prefix}.{p.name}", 0.0) for p in effect.parameters}


def surface_drag(outside: Outside, hull: Hull) -> Array:
    """Drag of the added friction along each link in N s2/m2, shape (E, L).

    For simulations that do not resolve the slip velocity: rho / 2 times the skin's area.
    """
    around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
    return np.asarray(0.5 * WATER_KG_M3 * around * hull.length * outside.rough)


_ZERO = np.zeros(1)
OFF = Outside(
    _ZERO, _ZERO, _ZERO, np.zeros(4), np.zeros(4), _ZERO, np.zeros(3), _ZERO, np.zeros(2), _ZERO
)
"""No effects."""
