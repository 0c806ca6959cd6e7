"""A reduced-order twin of the swimmer: the same robots and servos in water that is a force law.

Thousands of times faster than the fluid, for fits, sampling, tests and quick training. Its
coefficients are fitted to the fluid (``benchmarks/twin_fit.py``, which states the error); it is
never passed off as the fluid. Where the robot floats, only what is under water counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim.chain import RING, Chain, Motion
from sim.control import remember
from sim.effects import outside
from sim.shape import Hull, afloat, draught, hull_of
from sim.swimmer import CONTROL_S, State, _servos, masses
from sim.tank import POOL_M
from sim.twin_kernel import Water, start_twin, swim_twin
from sim.units import WATER_KG_M3
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.servo.parameters import CELLS, COLUMNS
from sim2real.servo.rollout import active_effects

Array = NDArray[np.float64]

SUBSTEPS = 8
"""Sub-steps of a control period: halving them moves a swim of 10 s by less than 1 % of its way."""
POINTS = 3


@dataclass(frozen=True)
class Coefficients:
    """The water's law; pure numbers, 1 where the textbook's value is right.

    Attributes:
        across: Drag coefficient of a link that moves across its axis.
        along: Drag coefficient of the head's cross-section along it.
        added_mass: Of the mass of the ellipse's circle (Lamb, Hydrodynamics, 1932, art. 71).
        thrust: Of Lighthill's reactive force at the tail's end.
        linear: Drag in N s/m, shared by the links according to their lengths.
    """

    across: float = 1.5
    along: float = 0.3
    added_mass: float = 1.0
    thrust: float = 1.0
    linear: float = 0.0

    @classmethod
    def of(cls, body: Mapping[str, Any]) -> Coefficients:
        """Those of a model's body, the fitted ones of ``FITTED`` where it names none."""
        given = body.get("twin", {})
        return replace(FITTED, **{k: float(v) for k, v in given.items()})


FITTED = Coefficients(8.228, 2.661, 0.998, 0.0, 1.676)
"""Fitted to the fluid in cells of 1 cm: ``reports/twin``."""


class Twin:
    """A batch of swimming robots with one robot file, each with its own parameters.

    The interface is that of ``sim.swimmer.Swimmer``.

    Attributes:
        robot: The robot.
        n_envs: Number of robots E.
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
    ) -> None:
        """Put robots into the water, straight, at rest, at the origin, heading along x.

        Args:
            robot: Links, joints and data sheets.
            model: Servos and body; one for all, or one for each robot.
            n_envs: Number of robots.
            device: Warp device.
            coefficients: The water's law; the model's (``body.twin``) or the fitted one where None.
            substeps: Sub-steps of a control period.
            threads: CPU threads.
            hull: The links' shape; from the robot's file where None.

        Raises:
            InputError: If robot and model do not go together.
        """
        self.robot, self.n_envs, self.substeps, self.threads = robot, n_envs, substeps, threads
        models = [model] * n_envs if isinstance(model, Model) else list(model)
        if len(models) != n_envs:
            raise InputError("twin", "model", f"{len(models)} models", f"{n_envs}, one a robot")
        self.device: Any = wp.get_device(device)
        self.hull = hull if hull is not None else hull_of(robot)
        self._above = draught(self.hull, sum(link.mass_kg for link in robot.links))
        if self._above is None:
            self.hull, _ = afloat(self.hull, sum(link.mass_kg for link in robot.links), False)
        self.outside = outside(robot, models, self.hull)
        if coefficients is None:
            laws = [Coefficients.of(one.body) for one in models]
        elif isinstance(coefficients, Coefficients):
            laws = [coefficients] * n_envs
        else:
            laws = list(coefficients)
        self._build(models, laws)
        self.step_count = 0
        self.reset()

    def _build(self, models: list[Model], laws: list[Coefficients]) -> None:
        E, L = self.n_envs, len(self.robot.links)
        J, N, more = L - 1, L + 2, self.outside
        own = masses(self.robot, models, self.hull)
        com = np.broadcast_to(own.com + more.com, (E, L))
        rows = _servos(self.robot, models)
        place, water, across, along, tip = self._geometry(com)

        def put(values: NDArray[Any], kind: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
            return wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device)

        def room(shape: tuple[int, ...], kind: Any) -> Any:  # noqa: ANN401
            return wp.zeros(shape, dtype=kind, device=self.device)

        resist = np.array(np.broadcast_to(more.resist, (E, L, 4)))
        scale = np.array([[c.across, c.along, c.added_mass, c.thrust] for c in laws])
        scale[:, 2] *= 1 + resist[:, 0, 2]  # added mass belongs to the law here
        resist[:, :, 2:] = 0.0
        share = self.hull.length / self.hull.length.sum()
        resist[:, :, 0] += np.array([c.linear for c in laws])[:, None] * share
        chain = self.chain = Chain()
        chain.mass = put(np.stack([own.mass, own.inertia], axis=-1), wp.vec2d)
        chain.water = room((E, L), wp.vec2d)
        chain.com, chain.length = put(com, wp.float64), put(self.hull.length, wp.float64)
        chain.side = put(np.broadcast_to(more.side, (E, L)), wp.float64)
        chain.resist, chain.push = put(resist, wp.vec4d), room((E, N), wp.float64)
        chain.skin = put(np.broadcast_to(more.skin, (E, J, 4)), wp.vec4d)
        chain.coupling = put(np.broadcast_to(more.coupling, (E,)), wp.float64)
        chain.tether = put(np.broadcast_to(more.tether, (E, 3)), wp.vec3d)
        chain.current = put(np.broadcast_to(more.current, (E, 2)), wp.vec2d)
        chain.trim = put(np.broadcast_to(more.trim, (E, J)), wp.float64)
        limits = np.array([joint.limits_rad for joint in self.robot.joints])
        chain.limits = put(limits.reshape(J, 2), wp.vec2d)
        chain.servo = put(rows, wp.float64)
        active = active_effects(rows.reshape(E * J, len(COLUMNS))).reshape(E, J)
        chain.active = put(active, wp.int32)
        chain.memory = room((E, J, CELLS), wp.float64)
        s = self.motion = Motion()
        s.q, s.v, s.b = (room((E, N), wp.float64) for _ in range(3))
        s.link, s.twist, s.before, s.force = (room((E, L), wp.vec3d) for _ in range(4))
        s.torque, s.impulse, s.stop = (room((E, J), wp.float64) for _ in range(3))
        s.measured, s.strain = (room((E, J), wp.float64) for _ in range(2))
        s.clock = room((E,), wp.float64)
        s.sent, s.arrival = (room((E, J, RING), wp.float64) for _ in range(2))
        s.newest = wp.full((E, J), -1, dtype=wp.int32, device=self.device)
        s.A, s.inverse = (room((E, N, N), wp.float64) for _ in range(2))
        law = self.water = Water()
        law.place, law.mass = put(place, wp.float64), put(water, wp.float64)
        law.across, law.along = put(across, wp.float64), put(along, wp.float64)
        law.tip, law.scale = put(tip, wp.vec2d), put(scale, wp.vec4d)
        law.wall = put(np.broadcast_to(more.wall, (E,)), wp.float64)
        law.pool = wp.vec3d(POOL_M[0] / 2, POOL_M[1] / 2, self.hull.body_length)
        law.carried = room((E, L), wp.vec3d)
        self._friction = room((E, J), wp.float64)

    def _geometry(self, com: Array) -> tuple[Array, Array, Array, Array, Array]:
        """What the water sees of each link: places, masses, drags, the tail's end."""
        nodes, weights = np.polynomial.legendre.leggauss(POINTS)
        s = (nodes + 1) / 2
        curve = np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)], axis=1)
        high = self.hull.half_height @ curve.T  # (L, POINTS), from front to back
        above = high if self._above is None else np.full_like(high, self._above)
        wet = high + np.clip(above, -high, high)  # height under water
        part = np.asarray(weights / 2)[None] * self.hull.length[:, None]
        water = WATER_KG_M3 * np.pi / 4 * wet * 2 * high * part
        across = 0.5 * WATER_KG_M3 * wet * part
        place = com[:, :, None] - s[None, None] * self.hull.length[None, :, None]
        wide = self.hull.half_width @ curve.T
        along = np.zeros(self.hull.length.size)
        along[0] = 0.5 * WATER_KG_M3 * float((np.pi / 2 * wide * wet).max())
        end = float(self.hull.half_height[-1, 2])
        wet_end = end + (end if self._above is None else float(np.clip(self._above, -end, end)))
        mass = WATER_KG_M3 * np.pi / 4 * wet_end * 2 * end
        behind = self.hull.length[-1] + self.hull.half_width[-1, 2] - com[:, -1]
        tip = np.stack([np.full_like(behind, mass), behind], axis=1)
        return place, water, across, along, tip

    def reset(
        self,
        mask: NDArray[np.bool_] | None = None,
        pose: Array | None = None,
        joint: Array | None = None,
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
        v[:, :2] = -self.outside.current
        for array, values in ((self.motion.q, q), (self.motion.v, v)):
            held = array.numpy()
            held[chosen] = values[chosen]
            array.assign(held)
        there: Any = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=self.device)
        for kernel, inputs in (
            (start_twin, [self.chain, self.motion, self.water, there]),
            (remember, [there, self.chain, self.motion]),
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
        self._swim(values[:, None], np.arange(E), 0)
        self.step_count += 1

    def swim(self, commands: Array, which: NDArray[np.intp] | None = None) -> Array:
        """Send whole signals in one launch, from where the robots are.

        Args:
            commands: Set-points in rad, one row a control period, shape (signals, T, J) or (T, J).
            which: Signal of each robot, shape (E,); the first where None.

        Returns:
            x, y, heading and measured angles at the end of each period, shape (E, T, 3 + J); the
            world frame is the pool's, current and all.
        """
        given = commands[None] if commands.ndim == 2 else commands
        chosen = np.zeros(self.n_envs, dtype=np.intp) if which is None else which
        start = np.array(self.motion.clock.numpy())
        track = self._swim(given, chosen, given.shape[1])
        t = start[:, None] + CONTROL_S * np.arange(1, given.shape[1] + 1)
        current = np.broadcast_to(self.outside.current, (self.n_envs, 2))
        track[:, :, :2] += current[:, None] * t[..., None]
        self.step_count += given.shape[1]
        return track

    def _swim(self, commands: Array, which: NDArray[np.intp], kept: int) -> Array:
        E, J = self.n_envs, len(self.robot.joints)
        signal: Any = wp.array(
            np.ascontiguousarray(commands, np.float64), dtype=wp.float64, device=self.device
        )
        chosen: Any = wp.array(which.astype(np.int32), dtype=wp.int32, device=self.device)
        track: Any = wp.zeros((E, max(kept, 0), 3 + J), dtype=wp.float64, device=self.device)
        h = wp.float64(CONTROL_S / self.substeps)

        def part(first: int, last: int) -> None:
            wp.launch(
                swim_twin,
                dim=last - first,
                inputs=[
                    first, signal, chosen, commands.shape[1], self.substeps, h, self.chain,
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
        return np.array(track.numpy())

    def state(self) -> State:
        """Where the robots are and how they move; forces of the water are not kept here."""
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
