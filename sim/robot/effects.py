"""The body's effects of models, as the arrays that ``sim.robot.outside`` acts on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.lattice.units import WATER_KG_M3
from sim.robot.shape import Hull
from sim2real.body import values
from sim2real.effects import BODY
from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outside:
    """What acts on E robots beside the water; each of the shape given, or one that broadcasts.

    Attributes:
        com: Distance in m by which the centres of mass lie further back, (E, 1).
        side: Distance in m of the centres of mass to the left of the axis, (E, 1).
        rough: Added friction coefficient of each link's surface, (E, L).
        resist: Of each link: drag in N s/m, drag along its axis in N s2/m2, share of the displaced
            water that goes along across it and as it turns, (E, L, 4).
        skin: Over each joint: N m/rad, N m s/rad, N m/rad that relax, their time in s, (E, J, 4).
        coupling: N m/rad between neighbouring joints, (E,).
        tether: N/m on the head, and the anchor's x and y in m, (E, 3).
        trim: Angle in rad by which the joints are off, (E, 1).
        current: Velocity of the pool's water in m/s, (E, 2).
        wall: Share by which a wall one body length away adds to the thrust, (E,).
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
    """The arrays for robots with these models: what each effect adds, as its own file says.

    Raises:
        InputError: If a model's effect does not exist.
    """
    each = [_forces(robot, model, hull) for model in models]

    def of(name: str) -> Array:
        return np.array([getattr(one, name) for one in each], dtype=np.float64)

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
    given = values(model)
    for effect in BODY:
        mine = [name for name in given if name.partition(".")[0] == effect.name]
        for material in dict.fromkeys(name.split(".")[1] for name in mine if effect.by_material):
            effect.act(forces, _of(given, effect, f"{effect.name}.{material}"), material)
        if mine and not effect.by_material:
            effect.act(forces, _of(given, effect, effect.name), "")
    return forces


def _of(given: Mapping[str, float], effect: BodyEffect, prefix: str) -> dict[str, float]:
    return {p.name: given.get(f"{prefix}.{p.name}", 0.0) for p in effect.parameters}


def surface_drag(outside: Outside, hull: Hull) -> Array:
    """Drag of the added friction along each link in N s2/m2, shape (E, L).

    For water that shows no velocity along the skin: rho / 2 times the skin's area.
    """
    around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
    return np.asarray(0.5 * WATER_KG_M3 * around * hull.length * outside.rough)


_ZERO = np.zeros(1)
OFF = Outside(
    _ZERO, _ZERO, _ZERO, np.zeros(4), np.zeros(4), _ZERO, np.zeros(3), _ZERO, np.zeros(2), _ZERO
)
"""Nothing beside the water."""
