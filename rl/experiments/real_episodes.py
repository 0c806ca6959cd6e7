"""Episodes in a reality: observations, rewards and ends are computed from measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from tqdm import tqdm

from rl.controllers import Controller
from rl.deploy.link import SILENCE_S, Telemetry
from rl.deploy.pilot import Measurements
from rl.experiments.evaluate import Episodes
from rl.experiments.reality import Reality
from rl.observer import observation_bounds
from rl.task import CONTROL_S, Task, reward
from sim2real.arrays import Array, Index, Mask
from sim2real.errors import InputError
from sim2real.robot import Robot


@dataclass(frozen=True)
class Starts:
    """Where n episodes begin: poses (n, 3), joint angles (n, J), waypoints (n, W, 2)."""

    pose: Array
    joint: Array
    targets: Array

    def of(self, rows: Index) -> Starts:
        """The starts of some of the episodes."""
        return Starts(self.pose[rows], self.joint[rows], self.targets[rows])


def same_starts(task: Task, agents: int, repeats: int, seed: int, J: int) -> Starts:
    """Starts and targets of ``repeats`` episodes, the same for each agent, agent by agent."""
    pose, joint, targets = task.place(np.random.default_rng(seed), repeats, J)
    tiled = [np.tile(x, (agents, *[1] * (x.ndim - 1))) for x in (pose, joint, targets)]
    return Starts(*tiled)


def run_real_episodes(
    reality: Reality,
    controller: Controller,
    robot: Robot,
    task: Task,
    starts: Starts,
    *,
    swims: Mask | None = None,
    name: str = "reality",
) -> Episodes:
    """Run one episode of each robot of a reality, as ``evaluate.run_episodes`` does in a world.

    The returned poses are measured. Joint rates, and the energy in the reward, are true values if
    the reality has a method ``rate``, else estimates. An episode also ends if a robot or joint is
    not measured for ``SILENCE_S``.

    Args:
        reality: The robots.
        controller: Their controller.
        robot: The robot, for its joint limits.
        task: The task.
        starts: One for each robot.
        swims: Robots that take part, shape (n,), all by default; the others do not move.
        name: Name of the reality, for errors.

    Raises:
        InputError: If the reality returns arrays of other shapes, or does not measure all robots
            at their starts.
    """
    n, J = starts.joint.shape
    limits = np.array([joint.limits_rad for joint in robot.joints])
    straight = np.clip(0.0, *limits.T)
    going = np.ones(n, dtype=bool) if swims is None else swims.copy()
    observers = Observers(n, J, starts.targets, name)
    shown = observers.look(reality.reset(starts.pose, starts.joint), going)
    controller.reset(np.ones(n, dtype=bool))
    pose, rate = [shown.copy()], [_rate(reality, observers)]
    value, steps = [np.zeros(n)], np.zeros(n, dtype=np.int64)
    for _ in tqdm(range(task.steps), desc="reality", unit="step", disable=None, leave=False):
        before = observers.distance.copy()
        desired = np.clip(controller.act(observers.observation), *limits.T)
        desired[~going] = straight
        shown = observers.look(reality.step(desired), going)
        reached = observers.distance < task.arrive_m
        outside = (np.abs(shown[:, :2]) > np.array(task.domain_m) / 2).any(axis=1)
        rates = _rate(reality, observers)
        parts = (before, observers.distance, rates, reached, outside)
        earned = reward(task, *(torch.as_tensor(x) for x in parts)).numpy()
        value.append(np.where(going, earned, np.nan))
        steps += going
        for recorded, values in ((pose, shown), (rate, rates)):
            recorded.append(np.where(going[:, None], values, np.nan))
        observers.go_on(reached & going)
        going &= ~(observers.arrived | outside | observers.blind())
        if not going.any():
            break
    recordings = (np.array(pose), np.array(rate), np.array(value), observers.reached, steps)
    return Episodes(*recordings, starts.targets)


def _rate(reality: Reality, observers: Observers) -> Array:
    """Joint rates in rad/s, shape (n, J): true values if the reality has them, else estimates."""
    true_rate = getattr(reality, "rate", None)
    if not callable(true_rate):
        return observers.rate
    return np.nan_to_num(np.asarray(true_rate(), dtype=np.float64)).reshape(observers.rate.shape)


class Observers:
    """Observations of n robots, computed from their measurements.

    Attributes:
        observation: Input of the policy, shape (n, O).
        reached: Waypoints reached, shape (n,).
    """

    def __init__(self, n: int, J: int, targets: Array, name: str) -> None:
        limit = np.array(observation_bounds(J), dtype=np.float32)
        self._observers = [Measurements(limit) for _ in range(n)]
        self._targets, self._name, self._count = targets, name, 0
        self.observation = np.zeros((n, 5 + 2 * J), dtype=np.float32)
        self.reached = np.zeros(n, dtype=np.int64)

    @property
    def rate(self) -> Array:
        """Joint rates in rad/s, shape (n, J)."""
        J = (self.observation.shape[1] - 5) // 2
        return self.observation[:, 3 + J : -2].astype(np.float64)

    @property
    def distance(self) -> Array:
        """From each head to its target in m, shape (n,)."""
        return np.asarray(np.hypot(*self.observation[:, -2:].T.astype(np.float64)))

    @property
    def arrived(self) -> Mask:
        """Whether the last waypoint was reached, shape (n,)."""
        return np.asarray(self.reached >= self._targets.shape[1])

    def blind(self) -> Mask:
        """Robots without a measurement for longer than ``SILENCE_S``, shape (n,)."""
        return np.array([observer.blind_s > SILENCE_S for observer in self._observers])

    def look(self, measured: tuple[Array, Array], going: Mask) -> Array:
        """Process measurements of the robots in ``going``; the measured poses, shape (n, 3)."""
        pose, joint = self._checked(measured)
        t = CONTROL_S * self._count
        self._count += 1
        for e in np.flatnonzero(going).tolist():
            self._observers[e].take(Telemetry(t, pose[e], joint[e]))
            if not np.isfinite(self._observers[e].blind_s):
                problem = f"robot {e} not measured at its start"
                raise InputError(self._name, "reset", problem, "a pose and all angles")
            self._observe(e)
        return pose

    def go_on(self, reached: Mask) -> None:
        """Count waypoints, and switch robots that reached one to the next."""
        self.reached += reached
        for e in np.flatnonzero(reached & ~self.arrived).tolist():
            self._observe(e)

    def _observe(self, e: int) -> None:
        target = self._targets[e, min(self.reached[e], self._targets.shape[1] - 1)]
        self.observation[e] = self._observers[e].observation(target)

    def _checked(self, measured: tuple[Array, Array]) -> tuple[Array, Array]:
        n, columns = self.observation.shape
        try:
            pose, joint = (np.array(x, dtype=np.float64) for x in measured)
        except (TypeError, ValueError) as error:
            raise InputError(self._name, "seen", str(error), "poses and joint angles") from None
        expected = ((n, 3), (n, (columns - 5) // 2))
        if (pose.shape, joint.shape) != expected:
            problem = f"arrays of shapes {pose.shape} and {joint.shape}"
            raise InputError(self._name, "seen", problem, f"{expected[0]} and {expected[1]}")
        return pose, joint
