"""Swimming robots in the lattice-Boltzmann fluid, one robot per box, in a batch of boxes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from sim.fluid.fluid import WINDOW_M, Fluid, Tank, pool, window
from sim.fluid.wall import SLIP, Wall
from sim.lattice.velocities import D2Q9, D3Q19, WATER_M2_S, Units
from sim.robot.bodies import FREE, Bodies
from sim.robot.effects import outside
from sim.robot.joints import calm, remember, send
from sim.robot.live import Live, State, at_rest, models_of, set_points, state_of
from sim.robot.rows import changed, masses, servo_rows
from sim.robot.shape import Hull, afloat, draught, hull_of
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


class Swimmer:
    """A batch of robots in the fluid: one robot file, separate parameters for each.

    Attributes:
        robot: The robot.
        n_envs: Number of boxes E.
        units: Size of a cell and of a time step.
        substeps: Time steps of the fluid per control period.
        surface_m: Height of the water's surface above the robot's middle.
        fluid, bodies: Fluid and robots; their Warp arrays are the current state.
        step_count: Control periods since the start.
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
            model: Servos and body, including the normalised density if present; one for all, or one
                for each box.
            n_envs: Number of boxes.
            device: Warp device.
            cell_m: Side of a cell.
            dimensions: 2 (plan view) or 3.
            box_m: Length, width and depth of a box.
            walls: Whether the box has walls; otherwise it moves with the robot.
            wall: Wall model: by default slip along the surface with skin friction as a stress, for
                robots of decimetres; ``NO_SLIP`` if cells resolve the boundary layer.
            viscosity_m2_s: Viscosity of the fluid away from the wall, one or one for each box, at
                least that of water, 1e-6; by default the model's or ``least_viscosity``.
            smagorinsky: Constant of the sub-grid viscosity.
            substeps: Time steps per control period, even; by default from ``TOP_SPEED_M_S``.
            threads: CPU threads.

        Raises:
            InputError: If robot, model and box do not agree.
        """
        self.robot, self.n_envs = robot, n_envs
        models = models_of(model, n_envs, "swimmer")
        flat = dimensions == 2
        self.hull = hull_of(robot)
        _check(robot, self.hull, box_m, cell_m)
        self.hull, depth, self.surface_m = _submerged(robot, self.hull, flat, box_m[2])
        if substeps is None:
            substeps = steps_of(cell_m)
        if substeps < 2 or substeps % 2:
            raise InputError("swimmer", "substeps", str(substeps), "an even number above 0")
        self.substeps = substeps
        self.units = Units(cell_m, CONTROL_S / substeps, depth if flat else cell_m)
        if viscosity_m2_s is None:
            least = least_viscosity(cell_m, substeps)
            viscosities = [m.body.get("water", {}).get("viscosity_m2_s", least) for m in models]
            viscosity_m2_s = np.maximum(viscosities, WATER_M2_S if wall.slip else least)
        self.viscosity_m2_s = np.broadcast_to(viscosity_m2_s, (n_envs,))
        self.tank: Tank = (pool if walls else window)(box_m, cell_m, flat=flat)
        self.fluid = Fluid(
            D2Q9 if flat else D3Q19,
            self.tank.size,
            viscosity=self.units.viscosity_lu(1.0) * self.viscosity_m2_s,
            boxes=n_envs,
            walls=self.tank.walls,
            normals=self.tank.normals,
            smagorinsky=smagorinsky,
            device=device,
            threads=threads,
        )
        nx, ny, nz = self.tank.size
        self.outside = outside(robot, models, self.hull, self.surface_m)
        if self.outside.wall.any() or (walls and self.outside.current.any()):
            name = "wall_effect" if self.outside.wall.any() else "pool_current with walls"
            raise InputError("model", "body.effects", name, "walls of the tank's own, still water")
        middle = nz - 0.5 - self.surface_m / cell_m
        self.bodies = Bodies(
            self.fluid,
            self.hull,
            masses(robot, models, self.hull),
            self.units,
            servos=servo_rows(robot, models),
            limits=np.array([joint.limits_rad for joint in robot.joints]),
            origin_m=(-cell_m * nx / 2, -cell_m * ny / 2),
            middle=middle,
            wall=wall,
            outside=self.outside,
        )
        self.step_count = 0
        J = len(robot.joints)
        self._command: Any = wp.zeros((n_envs, J), dtype=wp.float64, device=self.fluid.device)
        self._graphs: dict[int, Any] = {}
        self.reset()

    def reset(
        self,
        mask: Mask | None = None,
        pose: Array | None = None,
        joint: Array | None = None,
    ) -> None:
        """Put robots at rest in water at rest; with a current, both move with it.

        Args:
            mask: Boxes to reset, shape (E,); all where None.
            pose: x, y of the head's centre of mass and heading, shape (E, 3) or (3,); with the
                body's middle at the origin where None.
            joint: Joint angles, shape (E, J) or (J,); straight where None.
        """
        E = self.n_envs
        chosen = np.ones(E, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        com = self.bodies.chain.com.numpy()[:, 0]
        q = at_rest(self.hull, com, self.outside.trim, pose, joint)
        on_device: Any = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=self.fluid.device)
        fluid, motion = self.fluid, self.bodies.motion
        self._launch(
            calm(fluid.lattice, fluid.wide),
            (E, fluid.cells),
            [on_device, fluid.f, fluid.flags, fluid.box, fluid.stopped],
        )
        self.bodies.place(q, mask=chosen)
        self._launch(remember, E, [on_device, self.bodies.chain, motion])

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Assign other models to the robots of some boxes, before their ``reset``.

        The water keeps its viscosity.

        Args:
            which: Indices of the boxes, shape (n,).
            models: Their models.
        """
        effects = outside(self.robot, models, self.hull, self.surface_m)
        inertial = masses(self.robot, models, self.hull)
        self.bodies.adopt(which, inertial, servo_rows(self.robot, models), effects)
        self.outside = changed(self.outside, effects, which, self.n_envs)

    def step(self, command: Array | Any) -> None:  # noqa: ANN401 - a Warp array too
        """Send set-points and advance by one control period.

        Args:
            command: Desired joint angles in rad, shape (E, J) or (J,); a Warp array of float64 on
                the device is taken as it is, without waiting for the device.

        Raises:
            InputError: If a set-point is not finite.
        """
        if isinstance(command, wp.array):
            wp.copy(self._command, command)
        else:
            self._command.assign(set_points(command, self._command.shape, "swimmer"))
        self.advance()

    def live(self) -> Live:
        """The live state, on the device."""
        s = self.bodies.motion
        return Live(self._command, s.q, s.v, s.measured, s.clock, self.fluid.stopped)

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""
        device = self.fluid.device
        if not device.is_cuda:
            self._period()
        elif self.fluid.t in self._graphs:
            wp.capture_launch(self._graphs[self.fluid.t])
        else:
            self._period()  # compiles every kernel, which a capture must not
            with wp.ScopedCapture(device=device) as capture:
                self._period()
            self._graphs[self.fluid.t] = capture.graph
        self.step_count += 1

    def _period(self) -> None:
        bodies = self.bodies
        self._launch(
            send,
            (self.n_envs, len(self.robot.joints)),
            [self._command, bodies.chain, bodies.motion, self.fluid.stopped],
        )
        for _ in range(self.substeps):
            bodies.step(FREE)
        self._sponge()

    def _sponge(self) -> None:
        tank, fluid = self.tank, self.fluid
        if not tank.sponge:
            if self.bodies.wall.slip:
                fluid.level()
            return
        reach = wp.vec2(*(side / 2 - tank.sponge for side in tank.size[:2]))
        self._launch(
            fluid.kernels.damp,
            self.n_envs * fluid.cells,
            [fluid.f, fluid.box, self.bodies.grid.position, reach, float(tank.sponge), _SPONGE],
        )

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> None:  # noqa: ANN401
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.fluid.device)

    def state(self) -> State:
        """The state of the robots, copied from the device."""
        stopped = self.fluid.stopped.numpy()
        return state_of(self.bodies.motion, self.outside.current, stopped)


def _submerged(robot: Robot, hull: Hull, flat: bool, water_m: float) -> tuple[Hull, float, float]:
    """The hull, the depth that replaces its heights in 2D, and the depth of its middle.

    A robot floats at the draught of its mass; one that would sink swims at half depth.
    """
    mass = sum(link.mass_kg for link in robot.links)
    depth_m = None if flat else draught(hull, mass, robot.appendages)
    if depth_m is not None:
        return hull, 0.0, depth_m
    return *afloat(hull, mass, flat, robot.appendages), water_m / 2


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
