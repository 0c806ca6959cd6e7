"""Where the power of a beating robot goes: the balance of energy of the water around it.

    python benchmarks/power_balance.py OUT.json [--device cuda:0] [--cells 0.02 0.01]

The body is held and its joints beat, in a periodic box without an absorbing layer, so that all work
on the water is dissipated or stays in the wake as kinetic energy. Dissipation is that of resolved
gradients, ``2 rho nu S:S`` with central differences outside the body and the viscosity that each
cell has, sub-grid viscosity included. What is missing is lost by the scheme: at the surface of the
body, or in gradients that the cells do not resolve. There is no skin friction, whose heat
arises between body and water.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from fluid_speed import MODEL, ROBOT
from resolution import VISCOSITY_M2_S, beat
from tqdm import tqdm

from sim.cases.hard_commands import water_energy
from sim.fluid.fluid import CS2
from sim.fluid.wall import SLIP
from sim.lattice.cell import BODY, FLUID, GHOST, KIND, Box
from sim.lattice.collision import collision
from sim.lattice.populations import populations
from sim.robot.multibody import HELD
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array

SECONDS, COUNTED = 4.0, 2.0
"""Simulated, and of these at the end counted: whole beats."""
SAMPLED = 2
"""Dissipation is sampled this many times a control period."""


def viscosity_kernel(fluid: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Kernel for the viscosity of each cell, in lattice units."""
    pop = populations(fluid.lattice, fluid.storage, fluid.wide)
    Stored, load, moments, neighbours = pop.Stored, pop.load, pop.moments, pop.neighbours
    subgrid_tau = collision(fluid.lattice, fluid.storage, fluid.wide).subgrid_tau

    @wp.kernel(enable_backward=False, module="unique")
    def viscosities(
        f: Stored, flags: wp.array(dtype=wp.uint8), box: Box, t: int,
        tau: wp.array(dtype=wp.float32), square: float, damping: float,
        out: wp.array(dtype=wp.float32),
    ) -> None:  # fmt: skip
        n = wp.tid()
        flag = int(flags[n])
        if (flag & wp.static(KIND)) == wp.static(FLUID):
            p = load(f, n, neighbours(n, flag, box), t, box.total)
            m = moments(p)
            velocity = wp.vec3(m[1], m[2], m[3])
            whole = subgrid_tau(p, m[0], velocity, 1.0 / (1.0 + m[0]), tau[0], square)
            if (flag & wp.static(BODY)) != 0:
                whole += damping
            out[n] = wp.static(CS2) * (whole - 0.5)

    return viscosities


class Balance:
    """A held, beating robot in one box, and the energies of its water in J."""

    def __init__(self, cell_m: float, device: str) -> None:
        """Put the robot into water at rest."""
        self.swimmer = Swimmer(
            ROBOT, MODEL, cell_m=cell_m, viscosity_m2_s=VISCOSITY_M2_S, device=device, threads=2,
            wall=replace(SLIP, line="none"),
        )  # fmt: skip
        self.fluid, units = self.swimmer.fluid, self.swimmer.units
        self.joule = units.mass_kg * units.speed_m_s**2
        self.kernel = viscosity_kernel(self.fluid)
        cells, own = self.fluid.cells, self.fluid.device
        self.viscosity: Any = wp.zeros(cells, dtype=wp.float32, device=own)

    def water(self) -> tuple[Array, Array, Array]:
        """Density, velocity and whether a cell is water outside the body, by cell."""
        density, velocity = self.fluid.moments()
        flags = self.grid(self.fluid.flags)
        return density[0], velocity[0], (flags & (KIND | GHOST)) == FLUID

    def grid(self, flat: Any) -> Array:  # noqa: ANN401 - a Warp array
        """A field of cells in the shape of the box."""
        return np.asarray(flat.numpy().reshape(self.fluid.size[::-1]).transpose(2, 1, 0))

    def kinetic(self) -> float:
        """Kinetic energy of the water, with that of compression."""
        density, u, wet = self.water()
        return self.joule * float(water_energy(density, u)[wet].sum(dtype=np.float64))

    def dissipated(self) -> float:
        """Dissipation in one step of the lattice."""
        fluid = self.fluid
        state = [fluid.f, fluid.flags, fluid.box, fluid.t, fluid.tau]
        wall = [fluid.smagorinsky**2, fluid.covered.damping, self.viscosity]
        wp.launch(self.kernel, dim=fluid.cells, inputs=[*state, *wall], device=fluid.device)
        density, u, wet = self.water()
        slope = np.stack([difference(u, wet, axis) for axis in range(3)], axis=-1)
        strain = (slope + slope.swapaxes(-1, -2)) / 2
        cells = 2 * density * self.grid(self.viscosity) * (strain**2).sum(axis=(-1, -2))
        return self.joule * float(cells[wet].sum(dtype=np.float64))

    def run(self) -> Array:
        """Work on the water, change of its kinetic energy and dissipation in J, shape (3,)."""
        swimmer, bodies = self.swimmer, self.swimmer.bodies
        n, h = swimmer.substeps, swimmer.units.step_s
        first = round((SECONDS - COUNTED) / CONTROL_S) * n
        work, lost, begin = 0.0, 0.0, 0.0
        every = n // SAMPLED
        for k in tqdm(range(round(SECONDS / CONTROL_S) * n), disable=None):
            if k == first:
                begin = self.kinetic()
            before = bodies.motion.twist.numpy()[0].copy()
            rates = (beat((k + 1) * h) - beat(k * h)) / h
            bodies.prescribe(np.concatenate([np.zeros(3), rates]))
            bodies.step(HELD)
            if k >= first:
                force, after = bodies.motion.force.numpy()[0], bodies.motion.twist.numpy()[0]
                work -= h * float(np.sum(force * (before + after) / 2))
                lost += every * self.dissipated() if k % every == 0 else 0.0
        return np.array([work, self.kinetic() - begin, lost])


def difference(u: Array, wet: Array, axis: int) -> Array:
    """Slope of a velocity along an axis: central, one-sided beside what is not water."""
    up, down = np.roll(u, -1, axis) - u, u - np.roll(u, 1, axis)
    above, below = np.roll(wet, -1, axis)[..., None], np.roll(wet, 1, axis)[..., None]
    return np.where(above, up, 0) / (1 + below) + np.where(below, down, 0) / (1 + above)


def main() -> None:
    """Simulate, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.02, 0.0133333333, 0.01])
    options = parser.parse_args()
    rows = []
    for cell_m in options.cells:
        work, wake, lost = Balance(cell_m, options.device).run()
        rows.append({"cell_m": cell_m, "work_J": work, "wake_J": wake, "dissipated_J": lost})
        missing = 100 * (1 - (wake + lost) / work)
        found = f"work {work:.3f} J, kinetic energy {wake:+.3f} J, dissipated {lost:.3f} J"
        print(f"{cell_m:g} m: {found}, {missing:.0f} % missing", flush=True)
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
