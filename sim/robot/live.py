"""What simulators of a batch of robots share, in the fluid and in the twin: commands and state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import warp as wp

from sim.robot.chain import Motion
from sim.robot.effects import Outside
from sim.robot.shape import Hull
from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.robot import Robot


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
    # x, y of the head's centre of mass and heading in the water's frame, joint angles, shape (E, 3
    # + J), float64
    q: Any
    v: Any  # their rates, likewise
    measured: Any  # angles measured by the joints' sensors, shape (E, J), float64
    clock: Any  # seconds since the robot's start, shape (E,), float64
    stopped: Any  # cell of supersonic flow at which a box was stopped, or -1, shape (E,), int32


class Simulator(Protocol):
    """Interface of the fluid's swimmer and the twin."""

    robot: Robot
    n_envs: int

    @property
    def outside(self) -> Outside:
        """Effects on the robots."""

    def live(self) -> Live:
        """The live state."""

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Assign other models to some robots, before their reset."""

    def reset(
        self,
        mask: Mask | None = None,
        pose: Array | None = None,
        joint: Array | None = None,
    ) -> None:
        """Put robots at rest."""


def models_of(model: Model | Sequence[Model], n_envs: int, where: str) -> list[Model]:
    """One model for each robot.

    Raises:
        InputError: If there are more or fewer.
    """
    models = [model] * n_envs if isinstance(model, Model) else list(model)
    if len(models) != n_envs:
        raise InputError(where, "model", f"{len(models)} models", f"{n_envs}, one for each robot")
    return models


def set_points(command: Array, shape: tuple[int, ...], where: str) -> Array:
    """Set-points of each robot and joint, of what broadcasts to them.

    Raises:
        InputError: If one is not finite.
    """
    values = np.broadcast_to(np.asarray(command, dtype=np.float64), shape)
    if not np.all(np.isfinite(values)):
        row = int(np.argwhere(~np.isfinite(values))[0, 0])
        found = f"{values[row].tolist()} in environment {row}"
        raise InputError(where, "command", found, "finite angles")
    return np.ascontiguousarray(values)


def at_rest(hull: Hull, com: Array, trim: Array, pose: Array | None, joint: Array | None) -> Array:
    """Coordinates (E, 3 + J) of a pose and joint angles, or of the middle at the origin, straight.

    ``com`` are the distances of the head's centre of mass behind the front of its axis, (E,).
    """
    q = np.zeros((com.size, 2 + hull.length.size))
    if pose is None:
        q[:, 0] = hull.length.sum() / 2 - com
    else:
        q[:, :3] = pose
    q[:, 3:] = (0.0 if joint is None else joint) + trim
    return q


def state_of(s: Motion, current: Array, stopped: Integers | None = None) -> State:
    """The state, copied from the device; stopped are robots that are not finite where None."""
    q, v, clock = (np.array(x.numpy()) for x in (s.q, s.v, s.clock))
    q[:, :2] += current * clock[:, None]
    v[:, :2] += current
    c, d = np.cos(q[:, 2]), np.sin(q[:, 2])
    surge, sway = c * v[:, 0] + d * v[:, 1], c * v[:, 1] - d * v[:, 0]
    if stopped is None:
        stopped = np.where(np.isfinite(q).all(axis=1), -1, 0).astype(np.int32)
    return State(
        pose=q[:, :3],
        velocity=np.stack([surge, sway, v[:, 2]], axis=1),
        joint=q[:, 3:],
        rate=v[:, 3:],
        measured=np.array(s.measured.numpy()),
        torque=np.array(s.torque.numpy()),
        force=np.array(s.force.numpy()),
        time=clock,
        stopped=np.array(stopped),
    )


@cache
def _wrapped(device: str, pointer: int) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Warp's view of another library's stream; cached, as a freed view would destroy the stream."""
    return wp.Stream(wp.get_device(device), cuda_stream=pointer)


def use_stream(device: str, pointer: int) -> None:
    """Use another library's stream for all further work on a CUDA device."""
    chosen: Any = wp.get_device(device)
    wp.set_stream(_wrapped(device, pointer), chosen)
