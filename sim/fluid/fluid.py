"""The fluid: boxes of water side by side, all stepped at once."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim.lattice.cell import EDGE, FLUID, KIND, MOVING, SLIP, SOLID, Box, Covered
from sim.lattice.kernels import kernels
from sim.lattice.populations import MOST_CELLS, allocate, is_wide
from sim.lattice.velocities import Lattice
from sim.lattice.walls import wall_kernels
from sim2real.arrays import Array32, Integers, Picture
from sim2real.effects import start_warp
from sim2real.errors import InputError

WINDOW_M = (1.5, 1.0, 0.4)
POOL_M = (3.6, 3.6, 0.4)
"""The pool of Lin, Liu, Wang (2024): length, width, depth of the water."""
_UP = 4
CS2 = 1 / 3
"""Square of the lattice's speed of sound."""
BLOCK = 128
"""CUDA threads of a block: measured fastest of 64, 128, 256 and 512 on an H200."""
_LEAST_SLAB = 4096


class Fluid:
    """Boxes of fluid of one shape, in lattice units; each may have its own viscosity.

    Fields have the shape (E, nx, ny, nz), nz 1 in 2D, velocities one axis of 3 more. Boxes are
    periodic without walls; ``wide``: too many populations for 32-bit indices.
    """

    def __init__(
        self,
        lattice: Lattice,
        size: Sequence[int],  # (nx, ny) or (nx, ny, nz)
        *,
        viscosity: float | NDArray[np.floating[Any]],  # kinematic, one or one for each box
        boxes: int = 1,
        walls: NDArray[np.uint8] | None = None,  # ``FLUID``, ``SOLID``, ``MOVING``, ``SLIP``
        normals: Integers | None = None,  # of free-slip cells, 0 to 5: +x, -x, +y, -y, +z, -z
        wall_velocity: Array32 | None = None,  # of moving cells, shape (*size, 3)
        magic: float = 3 / 16,  # puts a straight no-slip wall exactly half-way between cells
        smagorinsky: float = 0.0,  # constant of the sub-grid viscosity
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        """Fill ``boxes`` boxes of ``size`` cells, walls included, with water at rest."""
        self.lattice, self.boxes, self.threads = lattice, boxes, max(1, threads)
        self.size = (int(size[0]), int(size[1]), int(size[2]) if len(size) > 2 else 1)
        self.device = find_device(device)
        self.cells = int(np.prod(self.size))
        viscous = np.broadcast_to(np.asarray(viscosity, dtype=np.float64), (boxes,))
        if not np.all(viscous > 0):
            raise InputError("fluid", "viscosity", f"{viscous.min():g}", "above 0")
        if boxes * self.cells > MOST_CELLS:
            found = f"{boxes * self.cells} cells in {boxes} boxes"
            expected = f"at most {MOST_CELLS} in one batch"
            raise InputError("fluid", "size", found, expected)
        self.wide = is_wide(lattice, boxes * self.cells)
        self.kernels = kernels(lattice, self.wide, self.device.is_cuda)
        self._mirror, self._walls = wall_kernels(lattice, self.wide)
        self.box = Box()
        self.box.nx, self.box.ny, self.box.nz = self.size
        self.box.cells, self.box.total, self.box.t = self.cells, boxes * self.cells, 0
        self.magic, self.smagorinsky = magic, smagorinsky
        self.f: Any = allocate(lattice, self.wide, self.box.total, self.device)
        above = viscous / CS2
        self.tau = self._put((above + 0.5).astype(np.float32))
        rates = np.stack([1 / (above + 0.5), above / (above / 2 + magic)], axis=1)
        self._rates = self._put(rates.astype(np.float32), wp.vec2)
        self._driven = False
        self.drive: Any = wp.zeros(boxes, dtype=wp.vec3, device=self.device)
        self.stopped = self.box.stopped = self._put(np.full(boxes, -1), wp.int32)
        self.covered = Covered()
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        self._close(walls, normals, wall_velocity)

    def _put(self, values: NDArray[Any], kind: Any = wp.float32) -> Any:  # noqa: ANN401 - Warp's arrays
        return wp.array(values, dtype=kind, device=self.device)

    def _close(
        self, walls: NDArray[np.uint8] | None, normals: Integers | None, velocity: Array32 | None
    ) -> None:
        flags = np.zeros(self.size, dtype=np.uint8) if walls is None else walls.reshape(self.size)
        flags = flags.copy()
        for axis in range(self.lattice.dimensions):
            edge = np.moveaxis(flags, axis, 0)
            edge[[0, -1]] |= EDGE
        flat = flatten(flags)
        self.flags = self.box.flags = self._put(np.tile(flat, self.boxes), wp.uint8)
        kind = flat & KIND
        direction = np.zeros(flat.size, dtype=np.int32)
        if normals is not None:
            direction[:] = flatten(normals.reshape(self.size))
        slips = np.flatnonzero(kind == SLIP).astype(np.int32)
        normal, shape = direction[slips], self.size[::-1]
        at = np.array(np.unravel_index(slips, shape))
        at[2 - normal // 2, np.arange(slips.size)] += np.where(normal % 2 == 0, -1, 1)
        before = np.ravel_multi_index(tuple(at), shape, mode="wrap")  # boxes wrap
        self._slips = [self._put(rows, wp.int32) for rows in (slips, normal, before)]
        active = np.flatnonzero(kind == MOVING).astype(np.int32)
        self.fluid_cells = int(np.count_nonzero(kind == FLUID))
        moving = np.zeros((active.size, 3), dtype=np.float32)
        if velocity is not None:
            moving = flatten(velocity.reshape(*self.size, 3))[active]
        self._moving = [self._put(active, wp.int32), self._put(moving, wp.vec3)]
        self._net: Any = wp.zeros(self.boxes, dtype=wp.int64, device=self.device)

    def accelerate(self, acceleration: NDArray[Any]) -> None:
        """Set a body force on all fluid: shape (E, 3) or (3,), in cells per step squared."""
        values = np.broadcast_to(np.asarray(acceleration, dtype=np.float32), (self.boxes, 3))
        self.drive.assign(np.ascontiguousarray(values))
        self._driven = bool(np.any(values))

    def step(self, count: int = 1) -> None:
        """Advance by ``count`` steps."""
        for _ in range(count):
            self.collide_and_stream()

    def collide_and_stream(self) -> None:
        """One step: all cells, then walls, which set what arrives from them."""
        total = self.boxes * self.cells
        if self._pool is None or total < _LEAST_SLAB:
            self._collide(0, total)
        else:
            edges = np.linspace(0, total, self.threads + 1).astype(int)
            list(self._pool.map(self._collide, edges[:-1], np.diff(edges)))
        self.box.t = 1 - self.box.t
        for kernel, (cells, *more) in ((self._mirror, self._slips), (self._walls, self._moving)):
            if cells.shape[0]:
                inputs = [self.f, self.box, cells, *more]
                self._launch(kernel, (self.boxes, cells.shape[0]), inputs)

    def _collide(self, first: int, count: int) -> None:
        relaxation = [self.tau, self._rates, self.magic, self.smagorinsky**2]
        pushes = [int(self._driven), self.drive, self.covered]
        inputs = [self.f, self.box, int(first), *relaxation, *pushes]
        self._launch(self.kernels.step, int(count), inputs, block_dim=BLOCK)

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], **more: Any) -> None:  # noqa: ANN401
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device, **more)

    def level(self) -> None:
        """Make the mean density of each box 1 again, without a change of momentum."""
        columns = self.boxes, self.size[0] * self.size[1]
        self._launch(self.kernels.weigh, columns, [self.f, self.box, self._net])
        inputs = [self.f, self.box, self.fluid_cells, self._net]
        self._launch(self.kernels.level, (self.boxes, self.cells), inputs)
        self._net.zero_()

    def set(
        self,
        density: NDArray[Any] | None = None,
        velocity: NDArray[Any] | None = None,
        strain_rate: NDArray[Any] | None = None,
    ) -> None:
        """Set the state that the next step starts from: arrays, or what broadcasts to them.

        Density has the shape (E, nx, ny, nz), 1 where None, velocity one axis of 3 more, 0 there.
        The rates of strain xx, yy, zz, xy, yz, zx of that velocity, an axis of 6, set the
        non-equilibrium part, without which pressure waves arise at the start.
        """
        shape = (self.boxes, *self.size)
        rest = np.zeros(shape) if density is None else np.broadcast_to(density, shape) - 1.0
        u = np.broadcast_to(0.0 if velocity is None else velocity, (*shape, 3))
        strain = np.zeros((0, 6), dtype=np.float32)
        if strain_rate is not None:
            strain = self._flat(np.broadcast_to(strain_rate, (*shape, 6)))
        state = [self._put(self._flat(rest)), self._put(self._flat(u), wp.vec3), self._put(strain)]
        inputs = [self.f, self.box, self.tau, *state]
        self._launch(self.kernels.initialise, self.boxes * self.cells, inputs)
        self.stopped.fill_(-1)

    def _flat(self, field: NDArray[Any]) -> Array32:
        return np.concatenate([flatten(box) for box in field]).astype(np.float32)

    def moments(self) -> tuple[Array32, Array32]:
        """Density (E, nx, ny, nz) and velocity (E, nx, ny, nz, 3), copied from the device."""
        total = self.boxes * self.cells
        density: Any = wp.empty(total, dtype=wp.float32, device=self.device)
        velocity: Any = wp.empty(total, dtype=wp.vec3, device=self.device)
        self._launch(self.kernels.fields, total, [self.f, self.box, density, velocity])
        nx, ny, nz = self.size
        rho = density.numpy().reshape(self.boxes, nz, ny, nx).transpose(0, 3, 2, 1) + 1.0
        u = velocity.numpy().reshape(self.boxes, nz, ny, nx, 3).transpose(0, 3, 2, 1, 4)
        return rho, u


def flatten(field: NDArray[Any]) -> NDArray[Any]:
    """A field of one box, shape (nx, ny, nz, ...), in the order of its cells: x fastest."""
    return np.ascontiguousarray(field.swapaxes(0, 2).reshape(-1, *field.shape[3:]))


def find_device(name: str) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The Warp device of this name."""
    start_warp()
    try:
        return wp.get_device(name)
    except Exception:
        known = ", ".join(str(device) for device in wp.get_devices())
        raise InputError("device", "name", repr(name), f"one of {known}") from None


@dataclass(frozen=True)
class Tank:
    """Cells and walls of one box."""

    size: tuple[int, int, int]  # cells (nx, ny, nz), walls included; nz is 1 in two dimensions
    walls: Picture  # kind of each cell, shape ``size``
    normals: Integers  # direction out of the fluid at the free surface, shape ``size``
    sponge: int  # width in cells of the absorbing layer; 0 where walls close the box


def tank(
    box_m: tuple[float, float, float], cell_m: float, *, closed: bool = False, flat: bool = False
) -> Tank:
    """A box with a no-slip floor and a free-slip surface, ``closed`` by walls or periodic."""
    nx, ny, nz = (round(side / cell_m) + 1 for side in box_m)
    if not closed:
        nx, ny = (max(8, round(side / cell_m)) for side in box_m[:2])
    shape = nx, ny, 1 if flat else nz
    walls, normals = np.zeros(shape, np.uint8), np.zeros(shape, np.int32)
    if not flat:
        walls[:, :, 0], normals[:, :, 0] = SLIP, _UP  # the surface for cells below, the floor above
    if closed:
        walls[0] = walls[:, 0] = SOLID
    return Tank(shape, walls, normals, 0 if closed else max(3, round(0.12 * min(nx, ny))))
