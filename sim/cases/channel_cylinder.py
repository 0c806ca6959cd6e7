"""A cylinder held in a channel: the steady and the periodic case of the DFG benchmark.

Source of the references: Schaefer and Turek, Notes Numer. Fluid Mech. 52 (1996) 547 (cases 2D-1 and
2D-2); precise figures are those of the FeatFlow project's benchmark pages. Lengths here are in
diameters, speeds in mean speeds of the stream.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.ramp import Ramp
from sim.fluid.fluid import CS2, Fluid
from sim.lattice.cell import INLET, OUTLET, SOLID
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import HELD, Bodies, Masses, inset_at
from sim.robot.shape import Hull
from sim2real.arrays import Array, Array32, Integers, Picture

LENGTH, HEIGHT, CENTRE = 22.0, 4.1, (2.0, 2.0)
DRAG, LIFT, PRESSURE = 5.57953523384, 0.010618948146, 0.11752016697
"""Case 2D-1; the pressure between the cylinder's front and back is in the benchmark's own Pa."""
LEAST_DRAG, MOST_DRAG, LIFT_SWING, STROUHAL = 3.164263, 3.227393, 2.007871, 0.301841
"""Case 2D-2."""
_PASCAL = 0.2**2
"""Density times the square of the mean speed in case 2D-1, in the benchmark's units."""
_PEAK = 0.075
"""Largest speed of the inflow in cells a step."""
_MEAN = 2 / 3 * _PEAK
_RAMP = 8.0
_LOOKS = 100


@dataclass(frozen=True)
class FixedCylinder:
    """Forces on a held cylinder.

    Attributes:
        time: In diameters over the mean speed, shape (T,).
        drag: Coefficient, shape (T,).
        lift: Likewise.
        pressure: Difference of front and back at the end, over density and mean speed squared.
    """

    time: Array
    drag: Array
    lift: Array
    pressure: float


def channel(diameter: int) -> tuple[Picture, Integers, Array32]:
    """Walls, their normals and velocities; the row y = 0 is the wall on either side."""
    size = (round(LENGTH * diameter) + 2, round(HEIGHT * diameter) + 1)
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    walls[0], normals[0] = INLET, 1
    walls[-1], normals[-1] = OUTLET, 0
    walls[:, 0] = SOLID
    across = (np.arange(size[1]) - 0.5) / (size[1] - 1)
    velocity = np.zeros((*size, 3), np.float32)
    velocity[0, 1:, 0] = (4 * _PEAK * across * (1 - across))[1:]
    return walls, normals, velocity


def hold(
    reynolds: float, diameter: int, time: float, *, device: str = "cpu", threads: int = 2
) -> FixedCylinder:
    """Simulate the held cylinder for ``time`` diameters over the mean speed."""
    walls, normals, velocity = channel(diameter)
    viscosity = _MEAN * diameter / reynolds
    fluid = Fluid(
        D2Q9,
        walls.shape,
        viscosity=viscosity,
        walls=walls,
        normals=normals,
        wall_velocity=velocity,
        device=device,
        threads=threads,
    )
    radius = np.full((1, 3), diameter / 2)
    still = Masses(np.ones(1), np.ones(1), np.zeros(1))
    disc, units = Hull(np.zeros(1), radius, radius), Units(1.0, 1.0, 1.0, 1.0)
    cylinder = Bodies(fluid, disc, still, units, inset=inset_at(viscosity))
    x, y = (c * diameter + 0.5 for c in CENTRE)
    cylinder.place(np.array([[x, y, 0.0]]))
    ramp = Ramp(fluid, round(_RAMP * diameter / _MEAN))
    every = max(1, round(diameter / _MEAN / _LOOKS))
    looks = round(time * diameter / _MEAN / every)
    force = np.zeros((looks, 2))
    for k in range(looks):
        ramp.at(k * every)
        for _ in range(every):
            cylinder.step(HELD)
        force[k] = cylinder.motion.force.numpy()[0, 0, :2]
    force /= 0.5 * _MEAN**2 * diameter
    density = fluid.moments()[0][0, :, :, 0].astype(np.float64)
    row = density[:, [int(y), int(y) + 1]].mean(axis=1)
    front, back = np.interp([x - diameter / 2, x + diameter / 2], np.arange(row.size), row)
    times = (np.arange(looks) + 1) * every * _MEAN / diameter
    return FixedCylinder(times, force[:, 0], force[:, 1], float((front - back) * CS2 / _MEAN**2))


def strouhal(time: Array, lift: Array) -> float:
    """Frequency of the lift, from where it rises through its mean."""
    c = lift - lift.mean()
    before = np.flatnonzero((c[:-1] < 0) & (c[1:] >= 0))
    if before.size < 2:
        return float("nan")
    step = time[1] - time[0]
    rise = time[before] + step * c[before] / (c[before] - c[before + 1])
    return float((rise.size - 1) / (rise[-1] - rise[0]))


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """Case 2D-1, and without ``quick`` also 2D-2."""
    diameter = 10 if quick else (60 if device.startswith("cuda") else 30)
    where = {"device": device, "threads": threads}
    steady = hold(20.0, diameter, 14.0 if quick else 20.0, **where)  # type: ignore[arg-type]
    last = steady.time > steady.time[-1] - 1
    figures = [
        Figure(
            "2D-1 drag coefficient", float(steady.drag[last].mean()), DRAG, 0.06 if quick else 0.015
        ),
        Figure("2D-1 lift coefficient", float(steady.lift[last].mean()), LIFT),
        Figure("2D-1 pressure difference in Pa", steady.pressure * _PASCAL, PRESSURE),
    ]
    curves = []
    if not quick:
        shed = hold(100.0, diameter, 60.0, **where)  # type: ignore[arg-type]
        late = shed.time > shed.time[-1] - 10
        t, drag, lift = shed.time[late], shed.drag[late], shed.lift[late]
        figures += [
            Figure("2D-2 least drag coefficient", float(drag.min()), LEAST_DRAG, 0.015),
            Figure("2D-2 largest drag coefficient", float(drag.max()), MOST_DRAG, 0.015),
            Figure("2D-2 lift coefficient, peak to peak", float(np.ptp(lift)), LIFT_SWING, 0.04),
            Figure("2D-2 Strouhal number", strouhal(t, lift), STROUHAL, 0.01),
        ]
        axis = "time in diameters over the mean speed"
        curves = [
            Curve("2D-2, drag", axis, "drag coefficient", shed.time, shed.drag),
            Curve("2D-2, lift", axis, "lift coefficient", shed.time, shed.lift),
        ]
    return Case(
        name="channel_cylinder",
        title="Cylinder in a channel, DFG benchmark 2D-1 (Re 20) and 2D-2 (Re 100)",
        source="Schaefer and Turek, Notes Numer. Fluid Mech. 52 (1996) 547; FeatFlow",
        setup=f"{diameter} cells a diameter, largest inflow {_PEAK:g} cells a step, raised over "
        f"{_RAMP:g} diameters; the cylinder as solid shares of cells",
        figures=tuple(figures),
        curves=tuple(curves),
    )
