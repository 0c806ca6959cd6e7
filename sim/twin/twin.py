"""The twin: the robots and servos of the swimmer, with a reduced-order force law for the fluid.

Thousands of times faster than the fluid, for fits, sampling, tests and quick training. Its
coefficients are fitted to the fluid (``benchmarks/twin_fit.py`` states the error). Of a floating
robot, the forces act on the submerged part.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim.fluid.tank import POOL_M
from sim.robot.chain import RING, Chain, Motion
from sim.robot.control import remember
from sim.robot.effects import Outside, outside, surface_drag
from sim.robot.live import Live
from sim.robot.rows import chain_rows, change_rows, changed, make_rows, masses, servo_rows
from sim.robot.shape import Hull, hull_of
from sim.robot.swimmer import CONTROL_S, State
from sim.twin.kernel import Water, start_twin, swim_twin
from sim.twin.law import FITTED, POINTS, Coefficients, hull_in_water, law_rows, sections
from sim2real.arrays import Array, Index, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import CELLS

SUBSTEPS = 8
"""Sub-steps per control period: doubling them changes a path of 10 s by less than 1 %."""


class Twin:
    """A batch of robots in the twin: one robot file, separate parameters for each.

    The interface is that of ``sim.robot.swimmer.Swimmer``.

    Attributes:
        robot: The robot.
        n_envs: Number of robots E.
        period_s: Control period in s.
        surface_m: Height of the water's surface above the robot's middle; infinite under water.
        step_count: Control periods since the start.
    """

    def __init__(
        self,
        robot: Robot,
        model: Model | Sequence[Model],
        *,
        n_envs: int = 1,
        device: str = "cpu",
        coefficients: Coefficients | Sequence[Coefficients] | None = None,
        substeps: int = SUBSTEPS,
        threads: int = 2,
        hull: Hull | None = None,
        period_s: float = CONTROL_S,
    ) -> None:
        """Create the robots, straight, at rest, at the origin, heading along x.

        Args:
            robot: Links, joints and data sheets.
            model: Servos and body; one for all, or one for each robot.
            n_envs: Number of robots.
            device: Warp device.
            coefficients: Coefficients of the force law; by default the model's (``body.twin``) or
                those fitted to the fluid.
            substeps: Sub-steps per control period.
            threads: CPU threads.
            hull: Shape of the links; by default from the robot's file.
            period_s: Control period in s.

        Raises:
            InputError: If robot and model do not agree.
        """
        self.robot, self.n_envs, self.substeps, self.threads = robot, n_envs, substeps, threads
        self.period_s = period_s
        models = [model] * n_envs if isinstance(model, Model) else list(model)
        if len(models) != n_envs:
            raise InputError("twin", "model", f"{len(models)} models", f"{n_envs}, one a robot")
        self.device: Any = wp.get_device(device)
        shape = hull if hull is not None else hull_of(robot)
        self.hull, self.surface_m = hull_in_water(robot, shape)
        self._sections = sections(self.hull, self.surface_m)
        self.outside = outside(robot, models, self.hull, self.surface_m)
        if coefficients is None:
            laws = [Coefficients.of(body_model.body) for body_model in models]
        elif isinstance(coefficients, Coefficients):
            laws = [coefficients] * n_envs
        else:
            laws = list(coefficients)
        self._build(models, laws)
        self.step_count = 0
        self.reset()

    def _rows(
        self, models: Sequence[Model], laws: Sequence[Coefficients], effects: Outside
    ) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
        """The arrays of robots with these models, for the chain and for the force law."""
        E, L = len(models), len(self.robot.links)
        inertial = masses(self.robot, models, self.hull)
        chain = chain_rows(inertial, servo_rows(self.robot, models), effects, E)
        chain["mass"] = np.stack([inertial.mass, inertial.inertia], axis=-1)
        chain["water"] = np.zeros((E, L, 2))
        resist = np.array(np.broadcast_to(effects.resist, (E, L, 4)))
        water = law_rows(self._sections, self.hull, chain["com"], laws, resist[:, 0, 2])
        resist[:, :, 2:] = 0.0  # added mass is a part of the force law
        resist[:, :, 1] += surface_drag(effects, self.hull)
        chain["resist"] = resist
        return chain, {**water, "wall": np.array(np.broadcast_to(effects.wall, (E,)))}

    def _build(self, models: list[Model], laws: list[Coefficients]) -> None:
        E, L = self.n_envs, len(self.robot.links)
        J, N = L - 1, L + 2

        def put(values: NDArray[Any], kind: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
            return wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device)

        def zeros(shape: tuple[int, ...], kind: Any) -> Any:  # noqa: ANN401
            return wp.zeros(shape, dtype=kind, device=self.device)

        rows, law_rows = self._rows(models, laws, self.outside)
        chain, law = Chain(), Water()
        self.chain, self.water = chain, law
        make_rows(chain, rows, self.device)
        make_rows(law, law_rows, self.device)
        chain.length = put(self.hull.length, wp.float64)
        chain.push = zeros((E, N), wp.float64)
        limits = np.array([joint.limits_rad for joint in self.robot.joints])
        chain.limits = put(limits.reshape(J, 2), wp.vec2d)
        chain.memory = zeros((E, J, CELLS), wp.float64)
        s = self.motion = Motion()
        s.q, s.v, s.b = (zeros((E, N), wp.float64) for _ in range(3))
        s.link, s.twist, s.before, s.force = (zeros((E, L), wp.vec3d) for _ in range(4))
        s.held, s.joint = zeros((E, L), wp.vec3d), zeros((E, J), wp.vec2d)
        s.torque, s.impulse, s.stop = (zeros((E, J), wp.float64) for _ in range(3))
        s.measured, s.strain = (zeros((E, J), wp.float64) for _ in range(2))
        s.clock = zeros((E,), wp.float64)
        s.sent, s.arrival = (zeros((E, J, RING), wp.float64) for _ in range(2))
        s.newest = wp.full((E, J), -1, dtype=wp.int32, device=self.device)
        s.A, s.inverse = (zeros((E, N, N), wp.float64) for _ in range(2))
        law.pool = wp.vec3d(POOL_M[0] / 2, POOL_M[1] / 2, self.hull.body_length)
        law.late = zeros((E, L, POINTS), wp.float64)
        law.carried, law.moved = zeros((E, L), wp.vec3d), zeros((E, L), wp.vec2d)
        self._friction = zeros((E, J), wp.float64)
        self._signal = zeros((E, 1, J), wp.float64)
        self._command = self._signal.reshape((E, J))
        self._own = put(np.arange(E), wp.int32)
        self._no_track = zeros((E, 0, 3 + J), wp.float64)
        self._stopped = wp.full(E, -1, dtype=wp.int32, device=self.device)

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Assign other models to some robots, before their ``reset``; as ``Swimmer.adopt``."""
        laws = [Coefficients.of(model.body) for model in models]
        effects = outside(self.robot, models, self.hull, self.surface_m)
        chain, water = self._rows(models, laws, effects)
        change_rows(self.chain, chain, which)
        change_rows(self.water, water, which)
        self.outside = changed(self.outside, effects, which, self.n_envs)

    def reset(
        self, mask: Mask | None = None, pose: Array | None = None, joint: Array | None = None
    ) -> None:
        """Put robots at rest; as ``Swimmer.reset``."""
        E, J = self.n_envs, len(self.robot.joints)
        chosen = np.ones(E, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        q, v = np.zeros((E, 3 + J)), np.zeros((E, 3 + J))
        if pose is None:
            q[:, 0] = self.hull.length.sum() / 2 - self.chain.com.numpy()[:, 0]
        else:
            q[:, :3] = pose
        q[:, 3:] = (0.0 if joint is None else joint) + self.outside.trim
        at_rest = np.zeros((E, J + 1, POINTS))
        for array, values in (
            (self.motion.q, q),
            (self.motion.v, v),
            (self.water.moved, at_rest[..., :2]),
            (self.water.late, at_rest),
        ):
            content = array.numpy()
            content[chosen] = values[chosen]
            array.assign(content)
        on_device: Any = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=self.device)
        for kernel, inputs in (
            (start_twin, [self.chain, self.motion, self.water, on_device]),
            (remember, [on_device, self.chain, self.motion]),
        ):
            wp.launch(kernel, dim=E, inputs=inputs, device=self.device)

    def step(self, command: Array) -> None:
        """Send set-points and advance by one control period; as ``Swimmer.step``.

        Raises:
            InputError: If a set-point is not finite.
        """
        E, J = self.n_envs, len(self.robot.joints)
        values = np.broadcast_to(np.asarray(command, dtype=np.float64), (E, J))
        if not np.all(np.isfinite(values)):
            row = int(np.argwhere(~np.isfinite(values))[0, 0])
            found = f"{values[row].tolist()} in environment {row}"
            raise InputError("twin", "command", found, "finite angles")
        self._command.assign(np.ascontiguousarray(values))
        self.advance()

    def live(self) -> Live:
        """The live state, on the device; as ``Swimmer.live``."""
        s = self.motion
        return Live(self._command, s.q, s.v, s.measured, s.clock, self._stopped)

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""
        self._launch(self._signal, self._own, self._no_track)
        self.step_count += 1

    def swim(self, commands: Array, which: Index | None = None) -> Array:
        """Simulate whole signals in one launch, from the current state.

        Args:
            commands: Set-points in rad, one row a control period, shape (signals, T, J) or (T, J).
            which: Signal of each robot, shape (E,); the first where None.

        Returns:
            x, y, heading and measured angles at the end of each period, shape (E, T, 3 + J), in the
            pool's frame.
        """
        signals = commands[None] if commands.ndim == 2 else commands
        chosen = np.zeros(self.n_envs, dtype=np.intp) if which is None else which
        start = np.array(self.motion.clock.numpy())
        track = self._swim(signals, chosen, signals.shape[1])
        t = start[:, None] + self.period_s * np.arange(1, signals.shape[1] + 1)
        current = np.broadcast_to(self.outside.current, (self.n_envs, 2))
        track[:, :, :2] += current[:, None] * t[..., None]
        self.step_count += signals.shape[1]
        return track

    def _swim(self, commands: Array, which: Index, kept: int) -> Array:
        E, J = self.n_envs, len(self.robot.joints)
        signal: Any = wp.array(
            np.ascontiguousarray(commands, np.float64), dtype=wp.float64, device=self.device
        )
        chosen: Any = wp.array(which.astype(np.int32), dtype=wp.int32, device=self.device)
        track: Any = wp.zeros((E, kept, 3 + J), dtype=wp.float64, device=self.device)
        self._launch(signal, chosen, track)
        return np.array(track.numpy())

    def _launch(self, signal: Any, which: Any, track: Any) -> None:  # noqa: ANN401 - Warp arrays
        h, E = wp.float64(self.period_s / self.substeps), self.n_envs

        def part(first: int, last: int) -> None:
            wp.launch(
                swim_twin,
                dim=last - first,
                inputs=[
                    first, signal, which, signal.shape[1], self.substeps, h, self.chain,
                    self.motion, self.water, self._friction, track,
                ],
                device=self.device,
            )  # fmt: skip

        threads = min(self.threads, E) if not self.device.is_cuda and E > 1 else 1
        edges = np.linspace(0, E, threads + 1).astype(int)
        if threads == 1:
            part(0, E)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(part, edges[:-1], edges[1:]))

    def state(self) -> State:
        """The state of the robots; forces of the water are not stored in the twin."""
        s = self.motion
        q, v, clock = (np.array(x.numpy()) for x in (s.q, s.v, s.clock))
        q[:, :2] += self.outside.current * clock[:, None]
        v[:, :2] += self.outside.current
        c, d = np.cos(q[:, 2]), np.sin(q[:, 2])
        surge, sway = c * v[:, 0] + d * v[:, 1], c * v[:, 1] - d * v[:, 0]
        finite = np.isfinite(q).all(axis=1)
        return State(
            pose=q[:, :3],
            velocity=np.stack([surge, sway, v[:, 2]], axis=1),
            joint=q[:, 3:],
            rate=v[:, 3:],
            measured=np.array(s.measured.numpy()),
            torque=np.array(s.torque.numpy()),
            force=np.array(s.force.numpy()),
            time=clock,
            stopped=np.where(finite, -1, 0).astype(np.int32),
        )


__all__ = ["FITTED", "SUBSTEPS", "Coefficients", "Twin"]
