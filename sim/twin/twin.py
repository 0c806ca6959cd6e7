"""The twin: the robots and servos of the swimmer, with a reduced-order force law for the fluid.

Thousands of times faster than the fluid, to which its coefficients are fitted (``reports/twin``).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from sim.fluid.fluid import POOL_M
from sim.robot.chain import fill, still
from sim.robot.effects import Outside, surface_drag
from sim.robot.live import Robots
from sim.robot.rows import Rows, chain_rows, change_rows, make_chain, masses, servo_rows
from sim.robot.shape import submerged
from sim.robot.swimmer import CONTROL_S
from sim.twin.kernel import Water, start_twin, swim_twin
from sim.twin.law import POINTS, Coefficients, law_rows, warn_unless_fitted
from sim2real.arrays import Array, Index, Mask
from sim2real.model import Model
from sim2real.robot import Robot

SUBSTEPS = 8
"""Sub-steps per control period: doubling them changes a path of 10 s by less than 1 %."""


class Twin(Robots):
    """A batch of robots in the twin."""

    def __init__(
        self,
        robot: Robot,
        model: Model | Sequence[Model],
        *,
        n_envs: int = 1,
        device: str = "cpu",
        substeps: int = SUBSTEPS,
        threads: int = 2,
    ) -> None:
        """Create ``n_envs`` robots, straight, at rest, at the origin, heading along x.

        ``model`` has servos and body, one for all or one for each robot; the coefficients of the
        force law are those in ``body.twin``, or those of the shipped fish; a law that was fitted to
        the fluid for other links is warned of. ``device`` is a Warp device, ``substeps`` are
        sub-steps per control period, ``threads`` those of a CPU.

        Raises:
            InputError: If robot and model do not agree.
        """
        self.robot, self.n_envs, self.substeps, self.threads = robot, n_envs, substeps, threads
        self.device: Any = wp.get_device(device)
        self.hull, _, self.surface_m = submerged(robot, False, np.inf)
        models, effects = self._take(model)
        warn_unless_fitted(robot, models[0].body)
        E, L, J = n_envs, len(robot.links), len(robot.joints)
        rows, law = self._rows(models, effects)
        limits = np.array([joint.limits_rad for joint in robot.joints])
        self.chain = make_chain(rows, self.hull.length, limits, self.device)
        self.motion = still(E, L, self.device)
        more = {"late": (E, L, POINTS), "carried": (E, L), "moved": (E, L)}
        self.water = fill(Water(), self.device, **law, **more)
        self.water.pool = wp.vec3d(POOL_M[0] / 2, POOL_M[1] / 2, self.hull.body_length)
        self._friction = self._zeros(E, J)
        self._signal = self._zeros(E, 1, J)
        self._command = self._signal.reshape((E, J))
        self._no_track = self._zeros(E, 0, 3 + J)
        self._own: Any = wp.array(np.arange(E), dtype=wp.int32, device=self.device)
        self._stopped = wp.full(E, -1, dtype=wp.int32, device=self.device)
        self.reset()

    def _zeros(self, *shape: int) -> Any:  # noqa: ANN401 - Warp has no stubs
        return wp.zeros(shape, dtype=wp.float64, device=self.device)

    def _rows(self, models: Sequence[Model], effects: Outside) -> tuple[Rows, Rows]:
        """The arrays of robots with these models, for the chain and for the force law."""
        E, L = len(models), len(self.robot.links)
        laws = [Coefficients.of(model.body) for model in models]
        inertial = masses(self.robot, models, self.hull)
        chain = chain_rows(inertial, servo_rows(self.robot, models), effects)
        chain["mass"] = np.stack([inertial.mass, inertial.inertia], axis=-1)
        chain["water"], chain["weight"] = np.zeros((E, L, 2)), np.array(inertial.mass)
        resist = np.array(np.broadcast_to(effects["resist"], (E, L, 4)))
        water = law_rows(self.hull, self.surface_m, chain["com"], laws, resist[:, 0, 2])
        resist[:, :, 2:] = 0.0  # added mass is a part of the force law
        resist[:, :, 1] += surface_drag(effects, self.hull)
        chain["resist"] = resist
        return chain, {**water, "wall": effects["wall"]}

    def _adopt(self, which: Index, models: Sequence[Model], effects: Outside) -> None:
        chain, water = self._rows(models, effects)
        change_rows(self.chain, chain, which)
        change_rows(self.water, water, which)

    def _place(self, q: Array, chosen: Mask, on_device: Any) -> None:  # noqa: ANN401
        change_rows(self.motion, {"q": q[chosen], "v": 0.0}, chosen)
        change_rows(self.water, {"moved": 0.0, "late": 0.0}, chosen)
        robots = [self.chain, self.motion, self.water, on_device]
        self._launch(start_twin, self.n_envs, robots)

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""
        self._swim(self._signal, self._own, self._no_track)
        self.step_count += 1

    def swim(self, commands: Array, which: Index | None = None) -> Array:
        """Simulate whole signals in one launch, from the current state.

        From set-points in rad, one row a control period, shape (signals, T, J) or (T, J), and the
        signal of each robot, shape (E,), to x, y, heading in the pool's frame and measured angles
        at the end of each period, shape (E, T, 3 + J).
        """
        signals = commands[None] if commands.ndim == 2 else commands
        E, T = self.n_envs, signals.shape[1]
        start = np.array(self.motion.clock.numpy())
        track = self._zeros(E, T, 3 + len(self.robot.joints))
        content = np.ascontiguousarray(signals, np.float64)
        signal: Any = wp.array(content, dtype=wp.float64, device=self.device)
        of_each = np.zeros(E) if which is None else which
        chosen: Any = wp.array(of_each.astype(np.int32), dtype=wp.int32, device=self.device)
        self._swim(signal, chosen, track)
        out = np.array(track.numpy())
        t = start[:, None] + CONTROL_S * np.arange(1, T + 1)
        out[:, :, :2] += self.current[:, None] * t[..., None]
        self.step_count += T
        return out

    def swum(self, commands: Array, pose: Array, which: Index | None = None) -> Array:
        """Tracks (E, T, 3 + J) from rest at a pose, at the beginning of each control period."""
        self.reset(pose=pose)
        first = self.track()[:, None]
        return np.concatenate([first, self.swim(commands[..., :-1, :], which)], axis=1)

    def _swim(self, signal: Any, which: Any, track: Any) -> None:  # noqa: ANN401 - Warp arrays
        """Simulate signals, on several threads of a CPU."""
        h, E = wp.float64(CONTROL_S / self.substeps), self.n_envs

        def part(first: int, last: int) -> None:
            motion = [self.chain, self.motion, self.water, self._friction, track]
            inputs = [first, signal, which, signal.shape[1], self.substeps, h, *motion]
            self._launch(swim_twin, last - first, inputs)

        threads = min(self.threads, E) if not self.device.is_cuda and E > 1 else 1
        if threads == 1:
            part(0, E)
            return
        edges = np.linspace(0, E, threads + 1).astype(int)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, edges[:-1], edges[1:]))
