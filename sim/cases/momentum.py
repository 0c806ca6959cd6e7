"""Conservation of momentum of a robot and its water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import Fluid
from sim.fluid.wall import NO_SLIP, Wall
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9, D3Q19, Lattice
from sim.robot.bodies import Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array
from sim2real.servo.parameters import COLUMNS

RADII = np.array([0.085, 0.115, 0.06, 0.03, 0.02])
"""Half-widths at the nose, the joints and the tail's tip, in body lengths."""
SET_POINTS = (0.4, -0.5, 0.6)
"""Set-points in rad, from a straight body at rest."""
_VISCOSITY, _SMAGORINSKY = 0.005, 0.1
_KP, _KD = 0.006, 0.6
"""Gains over the body length to the fourth (fifth in three dimensions), in lattice units."""


@dataclass(frozen=True)
class Audit:
    """Momentum of body and water together, over the sum of all impulses between them.

    Attributes:
        step: Steps since the start, shape (T,).
        linear: Along x and y, shape (T, 2).
        angular: About the box's corner, over impulse times body length, shape (T,).
        bend: Largest joint angle in rad at the end.
    """

    step: Array
    linear: Array
    angular: Array
    bend: float


def robot(fluid: Fluid, length: float, wall: Wall = NO_SLIP) -> Bodies:
    """Four links with three servos at density ratio 1, in lattice units, oblique to the grid."""
    half = length * np.stack([RADII[:-1], (RADII[:-1] + RADII[1:]) / 2, RADII[1:]], axis=1)
    hull = Hull(np.full(4, length * (1 - RADII[0] - RADII[-1]) / 4), half, 1.5 * half)
    flat = fluid.lattice.dimensions == 2
    water = displaced(hull, 1.0, 0.0, flat)
    rows = np.zeros((3, len(COLUMNS)))
    scale = length**4 if flat else 0.15 * length**5
    rows[:, COLUMNS.index("kp_Nm_per_rad")] = _KP * scale / length**2
    rows[:, COLUMNS.index("kd_Nms_per_rad")] = _KD * scale / length**2
    masses = Masses(water[:, 0], water[:, 2], water[:, 1])
    bodies = Bodies(fluid, hull, masses, Units(1.0, 1.0, 1.0, 1.0), servos=rows, wall=wall)
    start = np.zeros((1, 6))
    start[0, :3] = fluid.size[0] / 2 + 0.3 * length, fluid.size[1] / 2 + 0.2, 0.3
    bodies.place(start)
    sent = bodies.motion.sent.numpy()
    sent[:, :, 0] = SET_POINTS
    bodies.motion.sent.assign(sent)
    bodies.motion.newest.fill_(0)
    return bodies


def momentum(fluid: Fluid, bodies: Bodies) -> Array:
    """Momentum of water and robot along x and y, and about the corner of the box."""
    density, u = (field[0].astype(np.float64) for field in fluid.moments())
    x, y = np.arange(float(fluid.size[0])), np.arange(float(fluid.size[1]))
    m = (density[..., None] * u).sum(axis=2)
    spin = (x[:, None] * m[..., 1] - y * m[..., 0]).sum()
    return np.asarray(np.array([*m.sum(axis=(0, 1))[:2], spin]) + bodies.momentum()[0])


def audit(
    lattice: Lattice,
    length: int,
    side: int,
    steps: int,
    wall: Wall = NO_SLIP,
    *,
    device: str = "cpu",
    threads: int = 2,
) -> Audit:
    """Move the servos to their set-points in a periodic box; evaluate twenty times."""
    size = (side,) * lattice.dimensions
    fluid = Fluid(
        lattice,
        size,
        viscosity=_VISCOSITY,
        smagorinsky=_SMAGORINSKY,
        device=device,
        threads=threads,
    )
    bodies = robot(fluid, float(length), wall)
    impulse, rows = 0.0, []
    for step in range(1, steps + 1):
        bodies.step()
        impulse += float(np.abs(bodies.motion.force.numpy()[..., :2]).sum())
        if step % (steps // 20) == 0:
            rows.append([step, *(momentum(fluid, bodies) / impulse)])
    table = np.array(rows)
    bend = float(np.abs(bodies.motion.q.numpy()[0, 3:]).max())
    return Audit(table[:, 0], table[:, 1:3], table[:, 3] / length, bend)


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """In two dimensions for long times, and shorter in three.

    A periodic box conserves linear momentum, but angular momentum only until sound has crossed its
    edge. Single precision loses 4e-9 of the impulses per step.
    """
    where = {"device": device, "threads": threads}
    side = 160 if quick else 320
    near = audit(D2Q9, 32, side, side // 2, **where)  # type: ignore[arg-type]
    figures = [
        _residual("linear, 2D", np.abs(near.linear).max()),
        _residual("angular, 2D", np.abs(near.angular).max()),
    ]
    curves = [_curve("2D, until sound has crossed the box", near)]
    if not quick:
        long = audit(D2Q9, 32, 128, 2000, **where)  # type: ignore[arg-type]
        solid = audit(D3Q19, 24, 64, 60, **where)  # type: ignore[arg-type]
        figures += [
            _residual("linear, 2D, 2000 steps", np.abs(long.linear).max()),
            _residual("linear, 3D", np.abs(solid.linear).max()),
            _residual("angular, 3D", np.abs(solid.angular).max()),
        ]
        curves.append(_curve("2D, long", long))
    return Case(
        name="momentum",
        title="Momentum of a three-joint robot and its water",
        source="conservation of momentum; the reference is 0",
        setup=f"density ratio 1, free in a periodic box of {side} x {side} cells (2D), 32 cells a "
        f"body length, joints turn to {near.bend:.2f} rad; relative to all impulses on the links",
        figures=tuple(figures),
        curves=tuple(curves),
    )


def _residual(name: str, ours: float) -> Figure:
    return Figure(f"momentum left over, {name}", float(ours), 0.0, 1e-5, scale=1.0)


def _curve(label: str, result: Audit) -> Curve:
    largest = np.maximum(np.abs(result.linear).max(axis=1), np.abs(result.angular))
    name = f"Momentum left over, {label}"
    return Curve(name, "step", "share of the impulses", result.step, largest)
