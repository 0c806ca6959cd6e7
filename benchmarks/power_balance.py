"""Where the power of a beating robot goes: the balance of energy of the water around it.

    python benchmarks/power_balance.py OUT.json [--device cuda:0] [--cells 0.02 0.01]

The body is held and its joints beat, in a periodic box without an absorbing layer, so that all work
on the water is dissipated or stays in the wake. The energy of a cell is ``cs^2 h``, with the
entropy ``h`` as the sum of ``f log(f / w) - f + w`` over its populations: to second order the
kinetic energy with that of compression, and of what deviates from equilibrium. Streaming moves
``h`` without loss, and dissipation is what the collisions take from it, sub-grid viscosity
included: Karlin, Ferrante and Öttinger, Europhys. Lett. 47 (1999) 182. What is missing is lost or
gained at the surface of the body. There is no skin friction, whose heat arises between body and
water.
"""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from fluid_speed import MODEL, ROBOT
from harness import command_line
from resolution import VISCOSITY_M2_S, beat
from tqdm import tqdm

from sim.fluid.fluid import CS2, Fluid
from sim.fluid.wall import SLIP
from sim.lattice.cell import BODY, FLUID, GHOST, KIND, Box
from sim.lattice.collision import collision
from sim.lattice.populations import populations
from sim.robot.multibody import HELD
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array

SECONDS, COUNTED = 4.0, 2.0
"""Simulated, and of these at the end counted: whole beats."""


def energy_kernel(fluid: Fluid) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Kernel for the energy of each cell of water and what its collision takes from it."""
    pop = populations(fluid.lattice, fluid.storage, fluid.wide)
    Stored, Vector, load = pop.Stored, pop.Vector, pop.load
    moments, neighbours = pop.moments, pop.neighbours
    collide = collision(fluid.lattice, fluid.storage, fluid.wide)
    rates, relaxed = collide.rates, collide.relaxed
    w, Q = fluid.lattice.weights, fluid.lattice.Q

    @wp.func
    def energy(p: Vector) -> wp.float64:
        h = wp.float64(0.0)
        for k in range(wp.static(Q)):
            weight = wp.float64(wp.static(w[k]))
            x = wp.float64(p[k]) / weight
            more = wp.max(wp.float64(1.0) + x, wp.float64(1.0e-30))
            h += weight * (more * wp.log(more) - x)
        return wp.float64(wp.static(CS2)) * h

    @wp.kernel(enable_backward=False, module="unique")
    def energies(
        f: Stored, flags: wp.array(dtype=wp.uint8), box: Box, t: int,
        tau: wp.array(dtype=wp.float32), magic: float, square: float, damping: float,
        out: wp.array(dtype=wp.vec2d),
    ) -> None:  # fmt: skip
        n = wp.tid()
        flag = int(flags[n])
        found = wp.vec2d()
        if (flag & wp.static(KIND | GHOST)) == wp.static(FLUID):
            p = load(f, n, neighbours(n, flag, box), t, box.total)
            m = moments(p)
            momentum = wp.vec3(m[1], m[2], m[3])
            inverse = 1.0 / (1.0 + m[0])
            more = wp.where((flag & wp.static(BODY)) != 0, damping, 0.0)
            rate = rates(p, m[0], momentum, inverse, tau[0], magic, square, more)
            before = energy(p)
            after = energy(relaxed(p, m[0], momentum, inverse, rate[0], rate[1]))
            found = wp.vec2d(before, before - after)
        out[n] = found

    return energies


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
        self.kernel, cells = energy_kernel(self.fluid), self.fluid.cells
        self.each: Any = wp.zeros(cells, dtype=wp.vec2d, device=self.fluid.device)
        self.found = np.zeros(2)
        collide = self.fluid.collide_and_stream

        def observed() -> None:
            self.found = self.energies()
            collide()

        self.fluid.collide_and_stream = observed  # type: ignore[method-assign]

    def energies(self) -> Array:
        """Energy of the water and what the next collision takes from it, shape (2,)."""
        fluid = self.fluid
        state = [fluid.f, fluid.flags, fluid.box, fluid.t, fluid.tau, fluid.magic]
        more = [fluid.smagorinsky**2, fluid.covered.damping, self.each]
        wp.launch(self.kernel, dim=fluid.cells, inputs=[*state, *more], device=fluid.device)
        return self.joule * np.asarray(wp.utils.array_sum(self.each))

    def run(self) -> Array:
        """Work on the water, change of its energy and dissipation in J, shape (3,)."""
        swimmer, bodies = self.swimmer, self.swimmer.bodies
        n, h = swimmer.substeps, swimmer.units.step_s
        first, last = (round(t / CONTROL_S) * n for t in (SECONDS - COUNTED, SECONDS))
        work, lost, begin = 0.0, 0.0, 0.0
        for k in tqdm(range(last + 1), disable=None):
            before = bodies.motion.twist.numpy()[0].copy()
            rates = (beat((k + 1) * h) - beat(k * h)) / h
            bodies.prescribe(np.concatenate([np.zeros(3), rates]))
            bodies.step(HELD)
            if k == first:
                begin = self.found[0]
            if first <= k < last:
                force, after = bodies.motion.force.numpy()[0], bodies.motion.twist.numpy()[0]
                work -= h * float(np.sum(force * (before + after) / 2))
                lost += self.found[1]
        return np.array([work, self.found[0] - begin, lost])


def main() -> None:
    """Simulate, write, print."""
    cells = [0.02, 0.0133333333, 0.01]
    options = command_line(__doc__, "out", device="cpu", cells=cells).parse_args()
    rows = []
    for cell_m in options.cells:
        work, wake, lost = Balance(cell_m, options.device).run()
        rows.append({"cell_m": cell_m, "work_J": work, "wake_J": wake, "dissipated_J": lost})
        missing = 100 * (1 - (wake + lost) / work)
        found = f"work {work:.3f} J, wake {wake:+.3f} J, dissipated {lost:.3f} J"
        print(f"{cell_m:g} m: {found}, {missing:.0f} % missing", flush=True)
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
