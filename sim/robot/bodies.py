"""Robots in the boxes of a fluid: one for each box, all advanced together."""

from typing import Any

import numpy as np
import warp as wp

from sim.fluid.coupling import SUMS, cover_kernel
from sim.fluid.fluid import BLOCK, Fluid
from sim.fluid.ghost_coupling import ghost_kernels
from sim.fluid.wall import DAMPING, MEMORY, NO_SLIP, Wall
from sim.lattice.cell import Covered
from sim.lattice.populations import FIXED_POINT
from sim.lattice.velocities import Units
from sim.robot.chain import OnGrid, fill, still
from sim.robot.effects import Outside, no_effects, surface_drag
from sim.robot.multibody import FREE, HELD, KINEMATIC, advance, move, start
from sim.robot.rows import Masses, Rows, chain_rows, change_rows, make_chain
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array, Index, Mask
from sim2real.servo.parameters import COLUMNS

VIRTUAL_MASS = 0.25
"""Share of the displaced water that is added to both sides of the equations of motion."""
INSET = 0.5
"""Distance in cells by which the surface is moved inwards, as a cell with a small solid share stops
almost all of its water: ``inset_at`` for the viscosities at which robots swim."""
THINNEST = INSET + 0.15
"""Smallest half-width and half-height in cells: a thinner fin would lie between the cells."""
_MARGIN = 3
_NO_LIMIT, _FINE = 1e6, 60
_LISTED, _BLOCK, _COLUMNS = 32, 32, 2**17
"""Cells of a body's square for each thread that shares its listed cells, about as many as there are
of these; CUDA threads of a block where there are few: large blocks leave processors idle; columns
of all squares from which on a GPU is busy with one thread for each."""


def inset_at(viscosity: float) -> float:
    """Distance in cells to move the surface inwards, at this viscosity in lattice units.

    The slope is that of creeping flow through periodic arrays (Sangani and Acrivos, Int. J.
    Multiphase Flow 8 (1982) 193, 343): a disc or ball of 6 to 14 cells acts as if 0.34 - 1.5
    sqrt(viscosity) cells larger, within 0.03 for viscosities from 0.005 to 0.4. The constant is
    that of faster flow, whose best insets are 0.23 higher (cylinder towed at Re 100, 8 to 24 cells;
    spheres at Re 1.5 and 32).
    """
    return 0.57 - 1.5 * float(np.sqrt(viscosity))


class Bodies:
    """One chain of links in each box; ``displaced``: mass, centre, inertia of the water, (L, 3)."""

    def __init__(
        self,
        fluid: Fluid,
        hull: Hull,
        masses: Masses,
        units: Units,
        *,
        servos: Array | None = None,  # rows of ``COLUMNS``, (E, J, P) or (J, P); None: slack joints
        limits: Array | None = None,  # of joints in rad, shape (J, 2)
        origin_m: tuple[float, float] = (0.0, 0.0),  # world coordinates of the cell (0, 0)
        middle: float | None = None,  # the robot's height in cells, which may stick out of the box
        wall: Wall = NO_SLIP,
        inset: float = INSET,  # of the surface in cells, without slip
        # share of the displaced water on both sides of the equations, without slip
        virtual_mass: float = VIRTUAL_MASS,
        outside: Outside | None = None,
    ) -> None:
        """Put robots into a fluid, straight, at the origin, heading along x."""
        self.fluid, self.hull, self.units = fluid, hull, units
        E, L = fluid.boxes, hull.length.size
        J, flat, cell = L - 1, fluid.lattice.dimensions == 2, units.cell_m
        device, nz = fluid.device, fluid.size[2]
        self.wall, self._virtual = wall, virtual_mass
        least, set_in = (0.0, 0.0) if wall.slip else (THINNEST * cell, inset)
        width, height = (np.maximum(x, least) for x in (hull.half_width, hull.half_height))
        self.middle = 0.0 if flat else ((nz - 1) / 2 if middle is None else middle)
        surface = (nz - 0.5 - self.middle) * cell
        fine = hull.body_length / _FINE if wall.slip else cell
        water = displaced(Hull(hull.length, width, height), fine, set_in * cell, flat, surface)
        water[:, [0, 2]] *= units.density_kg_m3 * (units.depth_m if flat else 1.0)
        self.displaced = water
        rows = np.zeros((E, J, len(COLUMNS)))
        if servos is not None:
            rows[:] = servos
        ends = np.tile([-_NO_LIMIT, _NO_LIMIT], (J, 1)) if limits is None else limits
        effects = no_effects(L) if outside is None else outside
        self.chain = make_chain(self._rows(masses, rows, effects), hull.length, ends, device)
        self.chain.widest = wp.float64(hull.half_width.max())
        self.motion = still(E, L, device)
        grid = self.grid = fill(OnGrid(), device, position=(E,))
        grid.cell, grid.step = wp.float64(cell), wp.float64(units.step_s)
        grid.mass, grid.origin = wp.float64(units.mass_kg), wp.vec2d(*origin_m)
        grid.margin, grid.scale = _MARGIN, wp.float64(FIXED_POINT)
        grid.memory = wp.float32(MEMORY)
        self.target: Any = wp.zeros((E, L + 2), dtype=wp.float64, device=device)
        self.friction: Any = wp.zeros((E, J), dtype=wp.float64, device=device)
        high = np.full_like(height, _NO_LIMIT) if flat else height / cell - set_in
        self._cover_cells(hull.length / cell, width / cell - set_in, high, height)
        self._touch = wall.touch(hull.body_length, units)
        made = ghost_kernels if wall.slip else cover_kernel
        self._cover = made(fluid.lattice, fluid.wide)
        self.place(np.zeros((E, L + 2)))

    def _cover_cells(self, length: Array, width: Array, high: Array, height: Array) -> None:
        """Tell the fluid of the robots' shape, in cells, and make room for what they cover."""
        hull, cell, fluid = self.hull, self.units.cell_m, self.fluid
        E, L = fluid.boxes, hull.length.size
        nz, cuda = fluid.size[2], fluid.device.is_cuda
        flat = fluid.lattice.dimensions == 2
        reach = int(np.ceil(hull.half_width.max() / cell)) + _MARGIN
        side = int(np.ceil(hull.length.sum() / cell)) + 2 * reach + 2
        tall = int(np.ceil(height.max() / cell)) + 1
        low = 0 if flat else max(0, int(self.middle) - tall)
        top = 1 if flat else min(nz, int(np.ceil(self.middle)) + tall + 1)
        square = side**2 * (top - low)
        ghosts = E * square if self.wall.slip else 1
        covered = fluid.covered = fill(
            Covered(), fluid.device, share=(E * square,), face=(E * square,), leak=(ghosts,),
            back=(ghosts,), water=(ghosts,), beyond=(ghosts,), links=(ghosts,), count=(2 * E,),
            listed=(2 * E, ghosts // E), length=length.astype(np.float32),
            half_width=width.astype(np.float32), half_height=high.astype(np.float32),
            pose=(E, L), twist=(E, L), centre=(E, L), sums=(E, L, SUMS), kept=(E,), corner=(E,),
        )  # fmt: skip
        covered.middle, covered.damping = self.middle, DAMPING if self.wall.slip else 0.0
        covered.side, covered.low, covered.tall = side, low, top - low
        covered.layers = 1 if cuda and E * side**2 < _COLUMNS else covered.tall
        covered.lanes = max(1, square // _LISTED) if cuda else 1
        self.grid.body = covered

    def _rows(self, masses: Masses, servos: Array, outside: Outside) -> Rows:
        """The arrays of robots with these masses, servos and effects."""
        E, L = servos.shape[0], self.hull.length.size
        rows = chain_rows(masses, servos, outside)
        water = self.displaced
        mass, inertia = (np.broadcast_to(x, (E, L)) for x in (masses.mass, masses.inertia))
        inside = water[:, 2] + water[:, 0] * (rows["com"] - water[:, 1]) ** 2
        share = 0.0 if self.wall.slip else 1.0  # with slip, the sums account for the inner water
        rows["mass"] = np.stack([mass - share * water[:, 0], inertia - share * inside], axis=-1)
        inner = np.stack([np.broadcast_to(water[:, 0], (E, L)), inside], axis=-1)
        rows["water"] = share * self._virtual * inner
        rows["weight"] = np.array((rows["mass"] if self.wall.slip else rows["water"])[..., 0])
        resist = np.array(np.broadcast_to(outside["resist"], (E, L, 4)))
        resist[:, :, 2] *= water[:, 0]
        resist[:, :, 3] *= inside
        if not self.wall.slip:
            resist[:, :, 1] += surface_drag(outside, self.hull)
        rows["resist"] = resist
        return rows

    def adopt(self, which: Index, masses: Masses, servos: Array, outside: Outside) -> None:
        """Assign other masses, servos and effects to some robots, one row each."""
        change_rows(self.chain, self._rows(masses, servos, outside), which)

    def place(self, q: Array, v: Array | None = None, mask: Mask | None = None) -> None:
        """Set the head's x, y and heading, joint angles, and velocities, (E, N), by ``mask``."""
        E, N = self.motion.q.shape
        chosen = np.ones(E, dtype=bool) if mask is None else mask
        states = {"q": q, "v": np.zeros((E, N)) if v is None else v}
        rows = {name: np.broadcast_to(x, (E, N))[chosen] for name, x in states.items()}
        change_rows(self.motion, rows, chosen)
        on_device: Any = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=self.fluid.device)
        self._launch(start, E, [self.chain, self.motion, self.grid, on_device])

    def step(self, mode: int = FREE) -> None:
        """Advance robots and fluid by one step of the lattice."""
        fluid, covered, robots = (
            self.fluid,
            self.fluid.covered,
            [self.chain, self.motion, self.grid],
        )
        boxes, columns, water = fluid.boxes, covered.side**2, [fluid.f, fluid.box, covered]
        listed = (boxes, covered.lanes)
        # The fluid's sums over each link (``coupling.SUMS``).
        if self.wall.slip:
            covered.count.zero_()
            parts = (boxes, -(-covered.tall // covered.layers), columns)
            self._launch(self._cover.mark, parts, [*water[1:], self._touch], BLOCK)
            self._launch(self._cover.shear, listed, [*water, self._touch, self.chain.rough])
            self._launch(self._cover.cover, listed, water)
        else:
            self._launch(self._cover, (boxes, columns), water, BLOCK)
        moved = [*robots, mode, self.target, self.friction, fluid.stopped]
        self._launch(advance, boxes, moved)
        if self.wall.slip:
            self._launch(self._cover.emit, listed, water)
        fluid.collide_and_stream()
        self._launch(move, boxes, [*robots, mode, fluid.stopped])

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], block: int = _BLOCK) -> None:  # noqa: ANN401
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.fluid.device, block_dim=block)

    def prescribe(self, velocities: Array) -> None:
        """Velocities that ``KINEMATIC`` and ``HELD`` steps prescribe, shape (E, N) or (N,)."""
        values = np.broadcast_to(velocities, self.target.shape)
        self.target.assign(np.ascontiguousarray(values, dtype=np.float64))

    def push(self, force: Array) -> None:
        """Set external forces from now on: N, N, N m and N m at the joints, shape (E, N)."""
        values = np.broadcast_to(force, self.chain.push.shape)
        self.chain.push.assign(np.ascontiguousarray(values, np.float64))

    def momentum(self) -> Array:
        """Momentum (E, 3) along x, y and about the origin, without the water inside the links."""
        m, w = self.chain.mass.numpy(), self.chain.water.numpy()
        s = self.motion
        V, before, at = (x.numpy() for x in (s.twist, s.before, s.link))
        P = m[..., :1] * V[..., :2] + w[..., :1] * (V - before)[..., :2]
        spin = m[..., 1] * V[..., 2] + w[..., 1] * (V - before)[..., 2]
        L = spin + at[..., 0] * P[..., 1] - at[..., 1] * P[..., 0]
        whole = np.concatenate([P.sum(axis=1), L.sum(axis=1)[:, None]], axis=1)
        return np.asarray(whole - s.inner.numpy().sum(axis=1))


__all__ = ["FREE", "HELD", "KINEMATIC", "Bodies", "Masses", "inset_at"]
