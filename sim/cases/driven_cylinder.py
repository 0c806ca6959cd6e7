"""A free cylinder driven by an oscillating force in still water, at density ratios from 0.5 to 10.

The force on the cylinder is Stokes' of 1851, corrected for its images in the periodic box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import kv

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import Fluid
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import Bodies, Masses, inset_at
from sim.robot.shape import Hull
from sim2real.arrays import Array

RATIOS = (0.5, 0.9, 1.0, 1.1, 2.0, 10.0)
_VISCOSITY, _PERIOD, _PERIODS = 0.02, 2000, 4
_SPEED = 0.01
_SIDE = 6
"""Side of a box in diameters."""


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """Drive a cylinder 32 cells wide (16 if quick) at each ratio, all in one batch."""
    diameter, ratios = (16, (1.0,)) if quick else (32, RATIOS)
    side = _SIDE * diameter
    speed = shaken(diameter, side, ratios, device=device, threads=threads)
    exact = np.array([stokes_speed(diameter / 2, ratio, side) for ratio in ratios])
    return Case(
        name="driven_cylinder",
        title="Free cylinder driven in still water",
        source="Stokes, Trans. Camb. Phil. Soc. 9 (1851) 8; closed form with Bessel functions",
        setup=f"D = {diameter} cells, {side} x {side} cells, periodic (the reference is corrected "
        f"for it), viscosity {_VISCOSITY}, {_PERIOD} steps a period, {_PERIODS} periods",
        figures=tuple(
            Figure(f"speed at density ratio {ratio:g}, cells a step", ours, theirs, 0.03)
            for ratio, ours, theirs in zip(ratios, speed, exact, strict=True)
        ),
        curves=(
            Curve(
                "Speed against density ratio", "density ratio", "speed (cells a step)",
                np.array(ratios), speed, np.array(ratios), exact,
            ),
        ),
    )  # fmt: skip


def force(radius: float) -> float:
    """Amplitude of the force per depth in lattice units, which sets the speed."""
    return float(2 * np.pi * radius**2 * _SPEED * 2 * np.pi / _PERIOD)


def stokes_speed(radius: float, ratio: float, side: float) -> float:
    """Amplitude of the speed of a cylinder in a square periodic box, in cells a step.

    In unbounded fluid at rest the force of the fluid is -i w rho pi a^2 U C, with
    C = 1 + 4 K1(la) / (la K0(la)), l^2 = i w / nu. Outside its boundary layer the cylinder is a
    doublet, as if it moved in ideal fluid at U (1 + C) / 2. In the box the driving force F moves
    the whole, so that the mean flow is F / (i w rho) - (ratio - 1) pi a^2 U over the area, which is
    c (1 + C) U with c = pi a^2 / side^2; the images' doublets take half of it back (the local field
    of a square array). The cylinder is thus in a stream of u = c (1 + C) U / 2, which pushes it
    with i w rho pi a^2 (1 + C) u: correct to first order in c.
    """
    omega = 2 * np.pi / _PERIOD
    la = radius * np.sqrt(1j * omega / _VISCOSITY)
    area = np.pi * radius**2
    c = 1 + 4 * kv(1, la) / (la * kv(0, la))
    mass = area * (ratio + c - area / side**2 * (1 + c) ** 2 / 2)
    return float(abs(force(radius) / (omega * mass)))


def shaken(
    diameter: int, side: int, ratios: Sequence[float], *, device: str, threads: int
) -> Array:
    """Amplitude of the speed over the last two periods, one box for each ratio."""
    radius = diameter / 2
    fluid = Fluid(
        D2Q9, (side, side), viscosity=_VISCOSITY, boxes=len(ratios), device=device, threads=threads
    )
    hull = Hull(np.zeros(1), np.full((1, 3), radius), np.full((1, 3), radius))
    mass = np.array(ratios)[:, None] * np.pi * radius**2
    masses = Masses(mass, mass * radius**2 / 2, np.zeros_like(mass))
    bodies = Bodies(fluid, hull, masses, Units(1.0, 1.0, 1.0, 1.0), inset=inset_at(_VISCOSITY))
    start = np.zeros((len(ratios), 3))
    start[:, :2] = side / 2 + 0.3  # a generic position on the grid
    bodies.place(start)
    push = np.zeros_like(start)
    speed: list[Array] = []
    for step in range(_PERIODS * _PERIOD):
        push[:, 0] = force(radius) * np.cos(2 * np.pi * (step + 0.5) / _PERIOD)
        bodies.push(push)
        bodies.step()
        if step >= (_PERIODS - 2) * _PERIOD:
            speed.append(bodies.motion.v.numpy()[:, 0].copy())
    t = 2 * np.pi * np.arange(len(speed)) / _PERIOD
    basis = np.stack([np.cos(t), np.sin(t), np.ones_like(t), t], axis=1)
    fit = np.linalg.lstsq(basis, np.array(speed), rcond=None)[0]
    return np.asarray(np.hypot(fit[0], fit[1]))
