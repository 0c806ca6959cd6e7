"""The body's effects of models, as the arrays that ``sim.robot.outside`` acts on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.lattice.units import WATER_KG_M3
from sim.robot.shape import Hull
from sim2real.body import values
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
    """The arrays for robots with these models.

    Form drag refers to the largest cross-section, surface friction to the skin of the material's
    links; both to rho / 2 times the square of the speed along a link. Drag that is linear in the
    speed is shared by the links according to their lengths.

    Raises:
        InputError: If a model's effect does not exist.
    """
    given = [values(model) for model in models]
    E, L = len(models), hull.length.size

    def column(name: str) -> Array:
        return np.array([one.get(name, 0.0) for one in given])

    frontal = np.pi * float((hull.half_width * hull.half_height).max())
    resist, rough = np.zeros((E, L, 4)), np.zeros((E, L))
    share = hull.length / hull.length.sum()
    resist[:, :, 0] = column("linear_drag.coefficient")[:, None] * share
    resist[:, 0, 1] = 0.5 * WATER_KG_M3 * frontal * column("form_drag.coefficient")
    for k, link in enumerate(robot.links):
        rough[:, k] = column(f"surface_friction.{link.material or ''}.coefficient")
        rough[:, k] += column("surface_friction..coefficient") if link.material else 0.0
    resist[:, :, 2:] = column("added_mass.ratio")[:, None, None]
    skin = np.stack(
        [
            column("skin_elasticity.stiffness_Nm_per_rad"),
            column("skin_damping.damping_Nms_per_rad"),
            column("skin_viscoelasticity.stiffness_Nm_per_rad"),
            column("skin_viscoelasticity.relaxation_s"),
        ],
        axis=-1,
    )
    return Outside(
        com=-column("com_offset.x_m")[:, None],
        side=column("com_offset.y_m")[:, None],
        rough=rough,
        resist=resist,
        skin=np.broadcast_to(skin[:, None], (E, L - 1, 4)),
        coupling=column("skin_coupling.stiffness_Nm_per_rad"),
        tether=np.stack([column(f"tether.{n}") for n in ("stiffness_N_per_m", "x_m", "y_m")], -1),
        trim=column("trim_asymmetry.offset_rad")[:, None],
        current=np.stack([column(f"pool_current.{n}") for n in ("u_m_s", "v_m_s")], -1),
        wall=column("wall_effect.ratio"),
    )


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
