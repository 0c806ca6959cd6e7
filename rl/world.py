"""Batch of robots with simulator and task, as tensors; all environments wrap ``Decisions``.

Observations, rewards and noise are computed on the device of the simulator; the state of the fluid
is never copied to the host.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.utils.dlpack import from_dlpack

from rl.observer import Observer, View, observation_bounds, observed
from rl.task import Task, reward
from sim.robot.live import Simulator
from sim2real.arrays import Array
from sim2real.model import Model
from sim2real.velocity import NEWEST, slope_weights

FAST_M_S = 5.0
"""Speed limit: a faster robot has diverged numerically, and its episode is truncated."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measurement noise, drawn at every step."""

    position_m: float = 0.0  # x and y of the head
    yaw_rad: float = 0.0  # heading of the head
    # measured joint angles, one value for all or one per joint
    joint_rad: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Draws:
    """What episodes of an environment are drawn from: models, and the sensor noise of a step."""

    models: Sequence[Model]
    noise: Noise = Noise()


@dataclass(frozen=True)
class Step:
    """Result of a step of E environments."""

    observation: Tensor  # input of the next action, shape (E, O)
    reward: Tensor  # shape (E,)
    effort: Tensor  # energy before weighting, rad^2/s^2, shape (E,)
    bonus: Tensor  # reward for arriving (positive) or leaving the pool (negative), shape (E,)
    terminated: Tensor  # the robot arrived at the last waypoint or left the pool, shape (E,)
    truncated: Tensor  # time limit reached, or simulation stopped by its guard, shape (E,)
    reached: Tensor  # waypoints reached so far in the episode that this step belongs to, shape (E,)
    # observation at the end of this step; differs from ``observation`` where an episode ended. If
    # the guard stopped the simulation, the observation before it
    final: Tensor


class World:
    """Robots at a task; true ``pose`` (E, 3), ``joint`` and ``rate`` (E, J) after the last step."""

    def __init__(self, simulator: Simulator, task: Task, draws: Sequence[Draws], seed: int) -> None:
        """Place the robots at their starts; several ``draws`` share them evenly, in blocks."""
        self.simulator, self.task, self.n_envs = simulator, task, simulator.n_envs
        self._draws = [draws[e * len(draws) // self.n_envs] for e in range(self.n_envs)]
        live = simulator.live()
        self._command, self._q, self._v = map(from_dlpack, (live.command, live.q, live.v))
        rest = (live.measured, live.clock, live.stopped)
        self._measured, self._clock, self._guard = map(from_dlpack, rest)
        self.device = self._command.device
        E, J = self._command.shape
        limits = np.array([joint.limits_rad for joint in simulator.robot.joints])
        # actions, shape (J,)
        self.low, self.high = self._tensor(limits[:, 0]), self._tensor(limits[:, 1])
        self._half = self._tensor(np.array(task.domain_m) / 2)
        self._bound = self._tensor(np.array(observation_bounds(J)))
        self._weights = self._tensor(slope_weights())
        noise = [one.noise for one in self._draws]
        body = [[n.position_m, n.position_m, n.yaw_rad] for n in noise]
        joint = [np.broadcast_to(n.joint_rad, J) for n in noise]
        self._sd = self._tensor(np.concatenate([body, joint], axis=1))
        self._past = torch.zeros(E, NEWEST, 3 + J, device=self.device)
        self.targets = torch.zeros(E, task.waypoints, 2, device=self.device)  # in m
        self._row = torch.arange(E, device=self.device)
        counts = torch.zeros(2, E, dtype=torch.long, device=self.device)
        self.waypoint, self.elapsed = counts.unbind(0)  # to swim to; steps of the episode
        self._distance = torch.zeros(E, device=self.device)
        self._last = torch.zeros(E, len(self._bound), device=self.device)
        self.seed(seed)
        self.reset()

    def seed(self, seed: int) -> None:
        """Reset all random number generators."""
        self.rng = np.random.default_rng(seed)
        self.generator = torch.Generator(self.device).manual_seed(seed)

    def reset(self) -> Tensor:
        """Start an episode in all environments; the first observations, shape (E, O)."""
        return self.begin(torch.ones(self.n_envs, dtype=torch.bool, device=self.device))

    def step(self, action: Tensor, *, begin: bool = True) -> Step:
        """Send set-points in rad (E, J), clipped to the limits, and simulate a control period."""
        self._command.copy_(torch.clamp(action, self.low, self.high))
        self.simulator.advance()
        self.elapsed += 1
        self._read()
        distance = self._target_distance()
        left_pool = (self.pose[:, :2].abs() > self._half).any(dim=1)
        reached = distance < self.task.arrive_m
        stopped = self._stopped
        active = (~stopped).float()
        energy = active * (self.rate**2).sum(dim=1)
        ending = active * (self.task.bonus * (reached.float() - left_pool.float()))
        value = reward(self.task, active * (self._distance - distance), energy, ending)
        self.waypoint += reached
        done = self.waypoint >= self.task.waypoints
        terminated = (done | left_pool) & ~stopped
        truncated = ((self.elapsed >= self.task.steps) | stopped) & ~terminated
        count = self.waypoint.clone()
        self.waypoint.clamp_(max=self.task.waypoints - 1)
        self._distance = self._target_distance()
        self._remember()
        final = torch.where(stopped[:, None], self._last, self._observed())
        self._last = final
        observed = self.begin(terminated | truncated) if begin else final
        return Step(observed, value, energy, ending, terminated, truncated, count, final)

    def begin(self, mask: Tensor) -> Tensor:
        """Start an episode where ``mask`` (E,) is true; the observations of all environments."""
        rows = torch.nonzero(mask)[:, 0]
        if not len(rows):
            return self._last
        simulator, rng, begun = self.simulator, self.rng, rows.cpu().numpy()
        J = len(simulator.robot.joints)
        drawn = [self._draws[e].models for e in begun]
        simulator.adopt(begun, [models[rng.integers(len(models))] for models in drawn])
        start, bent, targets = self.task.place(rng, len(begun), J)
        pose, joint = np.zeros((self.n_envs, 3)), np.zeros((self.n_envs, J))
        pose[begun], joint[begun] = start, bent
        simulator.reset(mask.cpu().numpy(), pose, joint)
        self._current = self._tensor(np.pad(simulator.current, ((0, 0), (0, 1))))
        self.targets[rows] = self._tensor(targets)
        self.waypoint[rows] = self.elapsed[rows] = 0
        self._read()
        self._distance[rows] = self._target_distance()[rows]
        for _ in range(NEWEST):
            self._remember(rows)
        self._last = torch.where(mask[:, None], self._observed(), self._last)
        return self._last

    def _read(self) -> None:
        """Read the true state from the simulator."""
        q, v = self._q.float(), self._v.float()
        lost = ~torch.isfinite(q).all(dim=1) | (v[:, :2].abs() > FAST_M_S).any(dim=1)
        self._stopped = lost | (self._guard >= 0)
        q = torch.nan_to_num(q)
        # from the water's frame to the pool's
        self.pose = q[:, :3] + self._current * self._clock[:, None].float()
        self.joint, self.rate = q[:, 3:], torch.nan_to_num(v[:, 3:])

    def _remember(self, rows: Tensor | None = None) -> None:
        """Append the newest noisy measurement, in all environments or in ``rows``."""
        angles = torch.nan_to_num(self._measured.float())
        measured = torch.cat([self.pose, angles], dim=1)
        measured = measured + self._sd * torch.randn(
            measured.shape, generator=self.generator, device=self.device, dtype=measured.dtype
        )
        shifted = torch.cat([self._past[:, 1:], measured[:, None]], dim=1)
        if rows is None:
            self._past = shifted
        else:
            self._past[rows] = shifted[rows]

    def _observed(self) -> Tensor:
        target = self.targets[self._row, self.waypoint]
        return observed(self._past, self._weights, target, self._bound)  # type: ignore[no-any-return]

    def _target_distance(self) -> Tensor:
        """True distance from each head to its target."""
        target = self.targets[self._row, self.waypoint]
        away: Tensor = torch.linalg.vector_norm(target - self.pose[:, :2], dim=1)
        return away

    def _tensor(self, values: Array) -> Tensor:
        return torch.as_tensor(np.array(values), dtype=torch.float32).to(self.device)


class Decisions:
    """Robots that take a decision every few control periods, seen through an ``Observer``.

    If an episode ends between two decisions, later rewards are ignored and the next episode starts
    with the next decision, so that the decisions of all robots are synchronous.
    """

    def __init__(self, world: World, view: View) -> None:
        self.world, self.view = world, view
        self.observer = Observer(view, world.low, world.high, world.n_envs)

    def reset(self) -> Tensor:
        """Start an episode in all environments; the first observations, shape (E, F)."""
        return self.begin(torch.ones_like(self.world.elapsed, dtype=torch.bool))

    def begin(self, mask: Tensor) -> Tensor:
        """Start an episode where ``mask`` (E,) is true; the observations of all environments."""
        raw = self.world.begin(mask)
        self.observer.begin(raw, mask)
        return self.observer.observe(raw)  # type: ignore[no-any-return]

    def step(self, action: Tensor, *, begin: bool = True) -> Step:
        """Apply a decision (E, J), clipped to -1 and 1; as ``World.step``, summed over periods."""
        self.observer.decide(action.clamp(-1.0, 1.0))
        total = self.world.step(self.observer.set_points(0), begin=False)
        for tick in range(1, self.view.period):
            step = self.world.step(self.observer.set_points(tick), begin=False)
            active = ~(total.terminated | total.truncated)
            total = Step(
                step.observation,
                total.reward + active * step.reward,
                total.effort + active * step.effort,
                total.bonus + active * step.bonus,
                total.terminated | active & step.terminated,
                total.truncated | active & step.truncated,
                torch.where(active, step.reached, total.reached),
                torch.where(active[:, None], step.final, total.final),
            )
        final = self.observer.observe(total.final)
        ended = total.terminated | total.truncated
        seen = self.begin(ended) if begin and ended.any() else final
        return replace(total, observation=seen, final=final)
