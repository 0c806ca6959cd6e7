"""Swimming robots in the lattice-Boltzmann fluid, one robot per box, in a batch of boxes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from sim.fluid.fluid import WINDOW_M, Fluid, tank
from sim.fluid.wall import SLIP, Wall
from sim.lattice.velocities import D2Q9, D3Q19, WATER_M2_S, Units
from sim.robot.bodies import FREE, Bodies
from sim.robot.effects import Outside
from sim.robot.joints import calm, send
from sim.robot.live import Robots
from sim.robot.rows import masses, servo_rows
from sim.robot.shape import Hull, hull_of, submerged
from sim2real.arrays import Array, Index, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot

CONTROL_S = 0.02
"""Control period of the robot: 50 Hz."""
TOP_SPEED_M_S = 1.2
"""Design speed of the tail, at which it moves 0.15 cells per time step."""
LEAST_VISCOSITY = 3e-4
"""Default viscosity in lattice units; its influence is small, see ``reports/resolution``."""
SMAGORINSKY = 0.17
"""Lilly's constant of the sub-grid viscosity."""
_FASTEST = 0.15
_SPONGE = 0.5


def steps_of(cell_m: float) -> int:
    """Time steps of the fluid per control period, an even number."""
    return 2 * int(np.ceil(CONTROL_S * TOP_SPEED_M_S / _FASTEST / cell_m / 2))


def least_viscosity(cell_m: float, substeps: int | None = None) -> float:
    """Default viscosity in m2/s for cells of this size."""
    step_s = CONTROL_S / (substeps or steps_of(cell_m))
    return max(WATER_M2_S, LEAST_VISCOSITY * cell_m**2 / step_s)


class Swimmer(Robots):
    """A batch of robots in the fluid, one in each box.

    ``units`` are the sizes of a cell and of a time step, ``substeps`` the time steps per control
    period; the Warp arrays of ``fluid`` and ``bodies`` are the current state.
    """

    def __init__(
        self,
        robot: Robot,
        model: Model | Sequence[Model],
        *,
        n_envs: int = 1,
        device: str = "cpu",
        cell_m: float = 0.02,
        dimensions: int = 3,
        box_m: tuple[float, float, float] = WINDOW_M,
        walls: bool = False,
        wall: Wall = SLIP,
        viscosity_m2_s: float | Array | None = None,
        smagorinsky: float = SMAGORINSKY,
        substeps: int | None = None,
        threads: int = 1,
    ) -> None:
        """Create the boxes, with the robots straight, at rest, at the origin, heading along x.

        Args:
            robot: Links, joints and data sheets.
            model: Servos and body, one for all or one for each box.
            n_envs: Number of boxes.
            device: Warp device.
            cell_m: Side of a cell.
            dimensions: 2 (plan view) or 3.
            box_m: Length, width and depth of a box.
            walls: Whether the box has walls; otherwise it moves with the robot.
            wall: Wall model; ``NO_SLIP`` if cells resolve the boundary layer.
            viscosity_m2_s: Viscosity away from the wall, one or one for each box, at least 1e-6; by
                default the model's or ``least_viscosity``.
            smagorinsky: Constant of the sub-grid viscosity.
            substeps: Time steps per control period, even; by default from ``TOP_SPEED_M_S``.
            threads: CPU threads.

        Raises:
            InputError: If robot, model and box do not agree.
        """
        self.robot, self.n_envs = robot, n_envs
        flat = dimensions == 2
        _check(robot, hull_of(robot), box_m, cell_m)
        self.hull, depth, self.surface_m = submerged(robot, flat, box_m[2] / 2)
        if substeps is None:
            substeps = steps_of(cell_m)
        if substeps < 2 or substeps % 2:
            raise InputError("swimmer", "substeps", str(substeps), "an even number above 0")
        self.substeps = substeps
        models, effects = self._take(model)
        self.units = Units(cell_m, CONTROL_S / substeps, depth if flat else cell_m)
        if viscosity_m2_s is None:
            least = least_viscosity(cell_m, substeps)
            viscosities = [m.body.get("water", {}).get("viscosity_m2_s", least) for m in models]
            viscosity_m2_s = np.maximum(viscosities, WATER_M2_S if wall.slip else least)
        self.viscosity_m2_s = np.broadcast_to(viscosity_m2_s, (n_envs,))
        self.tank = tank(box_m, cell_m, closed=walls, flat=flat)
        self.fluid = Fluid(
            D2Q9 if flat else D3Q19, self.tank.size,
            viscosity=self.units.viscosity_lu(1.0) * self.viscosity_m2_s, boxes=n_envs,
            walls=self.tank.walls, normals=self.tank.normals, smagorinsky=smagorinsky,
            device=device, threads=threads,
        )  # fmt: skip
        self.device, self._stopped = self.fluid.device, self.fluid.stopped
        if effects["wall"].any() or (walls and effects["current"].any()):
            name = "wall_effect" if effects["wall"].any() else "pool_current with walls"
            raise InputError("model", "body.effects", name, "walls of the tank's own, still water")
        nx, ny, nz = self.tank.size
        self.bodies = Bodies(
            self.fluid, self.hull, masses(robot, models, self.hull), self.units,
            servos=servo_rows(robot, models),
            limits=np.array([joint.limits_rad for joint in robot.joints]),
            origin_m=(-cell_m * nx / 2, -cell_m * ny / 2),
            middle=nz - 0.5 - self.surface_m / cell_m, wall=wall, outside=effects,
        )  # fmt: skip
        self.chain, self.motion = self.bodies.chain, self.bodies.motion
        J = len(robot.joints)
        self._command: Any = wp.zeros((n_envs, J), dtype=wp.float64, device=self.device)
        self._graphs: dict[int, Any] = {}
        self.reset()

    def _place(self, q: Array, chosen: Mask, on_device: Any) -> None:  # noqa: ANN401
        fluid = self.fluid
        kernel = calm(fluid.lattice, fluid.wide)
        self._launch(kernel, (self.n_envs, fluid.cells), [on_device, fluid.f, fluid.box])
        self.bodies.place(q, mask=chosen)

    def _adopt(self, which: Index, models: Sequence[Model], effects: Outside) -> None:
        inertial = masses(self.robot, models, self.hull)
        self.bodies.adopt(which, inertial, servo_rows(self.robot, models), effects)

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""
        device = self.device
        if not device.is_cuda:
            self._period()
        elif self.fluid.box.t in self._graphs:
            wp.capture_launch(self._graphs[self.fluid.box.t])
        else:
            self._period()  # compiles every kernel, which a capture must not
            with wp.ScopedCapture(device=device) as capture:
                self._period()
            self._graphs[self.fluid.box.t] = capture.graph
        self.step_count += 1

    def _period(self) -> None:
        sent = [self._command, self.chain, self.motion, self.fluid.stopped]
        self._launch(send, (self.n_envs, len(self.robot.joints)), sent)
        for _ in range(self.substeps):
            self.bodies.step(FREE)
        self.damp()

    def damp(self) -> None:
        """Damp the water far from the robot, or keep the mass of a box with walls."""
        box, fluid = self.tank, self.fluid
        if box.sponge:
            reach = wp.vec2(*(side / 2 - box.sponge for side in box.size[:2]))
            layer = [self.bodies.grid.position, reach, float(box.sponge), _SPONGE]
            cells = self.n_envs * fluid.cells
            self._launch(fluid.kernels.damp, cells, [fluid.f, fluid.box, *layer])
        elif self.bodies.wall.slip:
            fluid.level()


def _check(robot: Robot, hull: Hull, box_m: tuple[float, float, float], cell_m: float) -> None:
    where = robot.path or "robot"
    if np.any(hull.length <= 0):
        k = int(np.argmax(hull.length <= 0))
        found = f"{robot.links[k].length_m:g} m long, {robot.links[k].width_m:g} m wide"
        raise InputError(where, f"links {k}", found, "longer than its round end: joints overlap")
    if hull.body_length >= min(box_m[:2]):
        found = f"a robot {hull.body_length:g} m long"
        raise InputError(where, "links", found, f"shorter than the box, {min(box_m[:2]):g} m")
    if 2 * hull.half_height.max() >= box_m[2]:
        found = f"a robot {2 * hull.half_height.max():g} m high"
        raise InputError(where, "links", found, f"lower than the water, {box_m[2]:g} m")
    if not cell_m > 0:
        raise InputError("swimmer", "cell_m", f"{cell_m:g}", "above 0")
