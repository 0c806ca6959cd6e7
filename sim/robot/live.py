"""What simulators of a batch of robots share, in the fluid and in the twin: commands and state."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import warp as wp

from sim.robot.effects import Outside, outside
from sim.robot.joints import remember
from sim.robot.shape import Hull
from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.velocity import turned


@dataclass(frozen=True)
class State:
    """State of the robots, copied from the device; world frame, SI units."""

    pose: Array  # x, y of the head's centre of mass and its heading, shape (E, 3)
    velocity: Array  # surge, sway and yaw rate of the head, in its body frame, shape (E, 3)
    joint: Array  # joint angles, shape (E, J)
    rate: Array  # joint rates, shape (E, J)
    measured: Array  # angles measured by the joints' sensors, shape (E, J)
    torque: Array  # torques of the servos in N m, shape (E, J)
    # force of the fluid on each link in N and torque about its centre of mass in N m, world frame,
    # shape (E, L, 3)
    force: Array
    time: Array  # seconds since the start, shape (E,)
    stopped: Integers  # cell of supersonic flow at which a box was stopped, or -1, shape (E,)


@dataclass(frozen=True)
class Live:
    """Warp arrays that a simulator reads and writes; take them by DLPack, without a copy."""

    command: Any  # set-points of the next period in rad, shape (E, J), float64; write here
    # x, y of the head's centre of mass and heading in the water's frame, joint angles, shape
    # (E, 3 + J), float64
    q: Any
    v: Any  # their rates, likewise
    measured: Any  # angles measured by the joints' sensors, shape (E, J), float64
    clock: Any  # seconds since the robot's start, shape (E,), float64
    stopped: Any  # cell of supersonic flow at which a box was stopped, or -1, shape (E,), int32


class Simulator(Protocol):
    """What environments need of ``Robots``, which has the documentation."""

    robot: Robot
    n_envs: int

    @property
    def current(self) -> Array: ...  # noqa: D102
    def live(self) -> Live: ...  # noqa: D102
    def advance(self) -> None: ...  # noqa: D102
    def adopt(self, which: Index, models: Sequence[Model]) -> None: ...  # noqa: D102
    def reset(  # noqa: D102
        self, mask: Mask | None = None, pose: Array | None = None, joint: Array | None = None
    ) -> None: ...


class Robots(ABC):
    """A batch of robots in a simulator: one robot file, separate parameters for each."""

    robot: Robot
    n_envs: int  # number of robots E
    hull: Hull
    surface_m: float  # height of the water's surface above the robot's middle
    step_count: int  # control periods since the start
    chain: Any  # ``sim.robot.chain.Chain``
    motion: Any  # ``sim.robot.chain.Motion``
    device: Any
    current: Array  # velocity of the pool's water, shape (E, 2)
    _command: Any
    _stopped: Any

    def _take(self, model: Model | Sequence[Model]) -> tuple[list[Model], Outside]:
        """One model for each robot, and the effects of their bodies."""
        E = self.n_envs
        models = [model] * E if isinstance(model, Model) else list(model)
        if len(models) != E:
            where, found = type(self).__name__.lower(), f"{len(models)} models"
            raise InputError(where, "model", found, f"{E}, one for each robot")
        effects = outside(self.robot, models, self.hull, self.surface_m)
        self.current, self.step_count = effects["current"].copy(), 0
        return models, effects

    @abstractmethod
    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""

    @abstractmethod
    def _adopt(self, which: Index, models: Sequence[Model], effects: Outside) -> None:
        """Overwrite the parameters of some robots."""

    @abstractmethod
    def _place(self, q: Array, chosen: Mask, on_device: Any) -> None:  # noqa: ANN401
        """Put the chosen robots at coordinates (E, 3 + J), at rest in water at rest."""

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Assign other models to some robots, shape (n,), before their ``reset``.

        The water keeps its viscosity.
        """
        effects = outside(self.robot, models, self.hull, self.surface_m)
        self._adopt(which, models, effects)
        self.current[which] = effects["current"]

    def reset(
        self, mask: Mask | None = None, pose: Array | None = None, joint: Array | None = None
    ) -> None:
        """Put robots, by a mask (E,), at rest in water at rest; with a current, both move with it.

        ``pose`` is x, y of the head's centre of mass and heading, shape (E, 3) or (3,); with the
        body's middle at the origin, heading along x, where None. ``joint`` are angles, (E, J) or
        (J,); straight where None.
        """
        E = self.n_envs
        chosen = np.ones(E, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        on_device: Any = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=self.device)
        q = np.zeros((E, 2 + self.hull.length.size))
        q[:, 0] = self.hull.length.sum() / 2 - self.chain.com.numpy()[:, 0]
        if pose is not None:
            q[:, :3] = pose
        q[:, 3:] = (0.0 if joint is None else joint) + self.chain.trim.numpy()
        self._place(q, chosen, on_device)
        self._launch(remember, E, [on_device, self.chain, self.motion])

    def step(self, command: Array | Any) -> None:  # noqa: ANN401 - a Warp array too
        """Send desired angles in rad, shape (E, J) or (J,), and advance by one control period.

        A Warp array of float64 on the device is taken as it is, without waiting for the device.

        Raises:
            InputError: If a set-point is not finite.
        """
        if isinstance(command, wp.array):
            wp.copy(self._command, command)
        else:
            values = np.broadcast_to(np.asarray(command, np.float64), self._command.shape)
            if not np.all(np.isfinite(values)):
                row = int(np.argwhere(~np.isfinite(values))[0, 0])
                found = f"{values[row].tolist()} in environment {row}"
                raise InputError(type(self).__name__.lower(), "command", found, "finite angles")
            self._command.assign(np.ascontiguousarray(values))
        self.advance()

    def live(self) -> Live:
        """The live state, on the device."""
        s = self.motion
        return Live(self._command, s.q, s.v, s.measured, s.clock, self._stopped)

    def state(self) -> State:
        """The state, copied from the device; the twin does not store forces of the water.

        In the twin robots count as stopped that are not finite.
        """
        s, stopped = self.motion, np.array(self._stopped.numpy())
        q, v, clock = (np.array(x.numpy()) for x in (s.q, s.v, s.clock))
        q[:, :2] += self.current * clock[:, None]
        v[:, :2] += self.current
        stopped[(stopped < 0) & ~np.isfinite(q).all(axis=1)] = 0
        velocity = np.concatenate([turned(v[:, :2], -q[:, 2]), v[:, 2:3]], axis=1)
        measured, torque, force = (np.array(x.numpy()) for x in (s.measured, s.torque, s.force))
        joints = q[:, 3:], v[:, 3:], measured, torque
        return State(q[:, :3], velocity, *joints, force, clock, stopped)

    def track(self) -> Array:
        """Poses and measured angles, shape (E, 3 + J); NaN of a stopped robot."""
        state = self.state()
        track = np.concatenate([state.pose, state.measured], axis=1)
        track[state.stopped >= 0] = np.nan
        return track

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> None:  # noqa: ANN401
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device)


@cache
def _wrapped(device: str, pointer: int) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Warp's view of another library's stream; cached, as a freed view would destroy the stream."""
    return wp.Stream(wp.get_device(device), cuda_stream=pointer)


def use_stream(device: str, pointer: int) -> None:
    """Use another library's stream for all further work on a CUDA device."""
    chosen: Any = wp.get_device(device)
    wp.set_stream(_wrapped(device, pointer), chosen)
