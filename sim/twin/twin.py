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

from sim.fluid.fluid import POOL_M
from sim.robot.effects import Outside, outside, surface_drag
from sim.robot.joints import remember
from sim.robot.live import Live, State, at_rest, models_of, set_points, state_of
from sim.robot.rows import (
    chain_rows,
    change_rows,
    changed,
    make_chain,
    make_motion,
    make_rows,
    masses,
    servo_rows,
)
from sim.robot.shape import hull_of
from sim.robot.swimmer import CONTROL_S
from sim.twin.kernel import Water, start_twin, swim_twin
from sim.twin.law import FITTED, POINTS, Coefficients, hull_in_water, law_rows, sections
from sim2real.arrays import Array, Index, Mask
from sim2real.model import Model
from sim2real.robot import Robot

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
            period_s: Control period in s.

        Raises:
            InputError: If robot and model do not agree.
        """
        self.robot, self.n_envs, self.substeps, self.threads = robot, n_envs, substeps, threads
        self.period_s = period_s
        models = models_of(model, n_envs, "twin")
        self.device: Any = wp.get_device(device)
        self.hull, self.surface_m = hull_in_water(robot, hull_of(robot))
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
        chain["water"], chain["weight"] = np.zeros((E, L, 2)), np.array(inertial.mass)
        resist = np.array(np.broadcast_to(effects.resist, (E, L, 4)))
        water = law_rows(self._sections, self.hull, chain["com"], laws, resist[:, 0, 2])
        resist[:, :, 2:] = 0.0  # added mass is a part of the force law
        resist[:, :, 1] += surface_drag(effects, self.hull)
        chain["resist"] = resist
        return chain, {**water, "wall": np.array(np.broadcast_to(effects.wall, (E,)))}

    def _build(self, models: list[Model], laws: list[Coefficients]) -> None:
        E, L = self.n_envs, len(self.robot.links)
        J, device = L - 1, self.device

        def zeros(shape: tuple[int, ...], kind: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
            return wp.zeros(shape, dtype=kind, device=device)

        rows, law_rows = self._rows(models, laws, self.outside)
        law = self.water = Water()
        make_rows(law, law_rows, device)
        limits = np.array([joint.limits_rad for joint in self.robot.joints])
        self.chain = make_chain(rows, self.hull.length, limits, device)
        self.motion = make_motion(E, L, device)
        law.pool = wp.vec3d(POOL_M[0] / 2, POOL_M[1] / 2, self.hull.body_length)
        law.late = zeros((E, L, POINTS), wp.float64)
        law.carried, law.moved = zeros((E, L), wp.vec3d), zeros((E, L), wp.vec2d)
        self._friction = zeros((E, J), wp.float64)
        self._signal = zeros((E, 1, J), wp.float64)
        self._command = self._signal.reshape((E, J))
        self._own: Any = wp.array(np.arange(E), dtype=wp.int32, device=device)
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
        com = self.chain.com.numpy()[:, 0]
        q = at_rest(self.hull, com, self.outside.trim, pose, joint)
        still = np.zeros((E, J + 1, POINTS))
        for array, values in (
            (self.motion.q, q),
            (self.motion.v, np.zeros_like(q)),
            (self.water.moved, still[..., :2]),
            (self.water.late, still),
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
        self._command.assign(set_points(command, self._command.shape, "twin"))
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
        return state_of(self.motion, self.outside.current)


__all__ = ["FITTED", "SUBSTEPS", "Coefficients", "Twin"]
