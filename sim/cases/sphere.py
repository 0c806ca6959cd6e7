"""A sphere held in a stream at Re 100: its drag in the steady state.

Source of the reference: the correlation of Clift, Grace and Weber, Bubbles, Drops and Particles
(Academic Press, 1978), 24 (1 + 0.1935 Re^0.6305) / Re for Re 20 to 260.
"""

from __future__ import annotations

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.ramp import Ramp
from sim.fluid.fluid import Fluid
from sim.lattice.cell import INLET, OUTLET, SLIP, SOLID
from sim.lattice.units import Units
from sim.lattice.velocities import D3Q19
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull
from sim2real.arrays import Array, Array32, Integers, Picture

REYNOLDS = 100.0
DRAG = 1.087
_SPEED = 0.1
_MAGIC = 0.02
"""There is no wall that needs 3/16, at which the slowly decaying odd part disturbs the inlet."""
_RAMP = 6.0
_AHEAD, _BEHIND, _SIDE = 5, 8, 5
"""Extent of the water upstream, downstream and to the side of the centre, in diameters."""


def stream(diameter: int) -> tuple[Picture, Integers, Array32]:
    """Walls, their normals and velocities: in at x = 0, out at the end, free-slip sides.

    Two of the sides are planes of symmetry through the sphere's centre. Boxes and bodies are
    periodic: beyond the far side in y there are solid cells for the sphere's other half.
    """
    width, room = _SIDE * diameter, diameter // 2 + 4
    size = ((_AHEAD + _BEHIND) * diameter + 2, width + 2 + room, width + 2)
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    walls[0], normals[0] = INLET, 1
    walls[-1], normals[-1] = OUTLET, 0
    for axis in (1, 2):
        for end, normal in ((0, 2 * axis + 1), (width + 1, 2 * axis)):
            np.moveaxis(walls, axis, 0)[end] = SLIP
            np.moveaxis(normals, axis, 0)[end] = normal
    edges = [0, width + 1]
    walls[:, np.repeat(edges, 2), edges * 2] = SOLID  # bounce-back at edges of two free-slip sides
    walls[:, width + 2 :] = SOLID
    velocity = np.zeros((*size, 3), np.float32)
    velocity[..., 0] = _SPEED
    return walls, normals, velocity


def drag(
    diameter: int, time: float, *, device: str = "cpu", threads: int = 2
) -> tuple[Array, Array]:
    """Times in diameters over the stream's speed, and the drag coefficient at them."""
    walls, normals, velocity = stream(diameter)
    fluid = Fluid(
        D3Q19,
        walls.shape,
        viscosity=_SPEED * diameter / REYNOLDS,
        walls=walls,
        normals=normals,
        wall_velocity=velocity,
        magic=_MAGIC,
        device=device,
        threads=threads,
    )
    radius = np.full((1, 3), diameter / 2)
    still = Masses(np.ones(1), np.ones(1), np.zeros(1))
    sphere = Bodies(
        fluid, Hull(np.zeros(1), radius, radius), still, Units(1.0, 1.0, 1.0, 1.0), middle=0.5
    )
    sphere.place(np.array([[_AHEAD * diameter + 0.5, 0.5, 0.0]]))
    ramp = Ramp(fluid, round(_RAMP * diameter / _SPEED))
    unit = 0.5 * _SPEED**2 * np.pi / 4 * diameter**2
    steps = round(diameter / _SPEED / 4)
    coefficient = np.zeros(round(4 * time))
    for k in range(coefficient.size):
        for step in range(steps):
            ramp.at(k * steps + step)
            sphere.step(HELD)
        coefficient[k] = 4 * sphere.motion.force.numpy()[0, 0, 0] / unit
    return (np.arange(coefficient.size) + 1) / 4, coefficient


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """On a CPU the coarsest resolution that meets the bar; finer on a GPU."""
    diameter, time = (32 if device.startswith("cuda") else 14), 14.0
    if quick:
        diameter, time = 6, 9.0
    times, coefficient = drag(diameter, time, device=device, threads=threads)
    last = float(coefficient[-4:].mean())
    figures = (Figure("drag coefficient", last, DRAG, 0.1 if quick else 0.04),)
    return Case(
        name="sphere",
        title="Sphere in a stream at Re 100",
        source="Clift, Grace and Weber, Bubbles, Drops and Particles (1978)",
        setup=f"D3Q19, {diameter} cells a diameter, {2 * _SIDE} diameters between free-slip "
        f"sides, a quarter of the flow, {time:g} diameters long, stream at {_SPEED:g} cells a step",
        figures=figures,
        curves=(
            Curve(
                "Drag of the sphere; reference: steady", "time in diameters over the speed",
                "drag coefficient", times, coefficient, times[[0, -1]], np.full(2, DRAG),
            ),
        ),
    )  # fmt: skip
