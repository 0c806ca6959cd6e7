"""Run one episode of every robot under a controller, and measure the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from rl.controllers import Controller
from rl.task import CONTROL_S, Task
from rl.world import World
from sim2real.arrays import Array, Mask


class Measure(NamedTuple):
    """How a figure is shown and compared: label, unit in files, 1 where more is better else -1."""

    label: str
    unit: str
    better: int
    digits: str


FIGURES = {
    "success": Measure("share that arrives", "", 1, ".2f"),
    "time_s": Measure("time (s)", "s", -1, ".2f"),
    "energy": Measure("energy (rad²/s²)", "rad2/s2", -1, ",.0f"),
    "reward": Measure("reward", "", 1, ".1f"),
    "path_m": Measure("path (m)", "m", -1, ".2f"),
}
"""The figures of a trial by name, in the order of tables; see ``measured``."""


@dataclass(frozen=True)
class Episodes:
    """E episodes; rows after the end of an episode are NaN, the first row is the start."""

    pose: Array  # x, y in m and heading in rad of the head, shape (T, E, 3)
    rate: Array  # joint rates in rad/s, shape (T, E, J)
    value: Array  # reward of each control period, shape (T, E), 0 in the first row
    reached: NDArray[np.int64]  # waypoints reached, shape (E,)
    steps: NDArray[np.int64]  # length in control periods, shape (E,)
    targets: Array  # waypoints in m, shape (E, W, 2)

    @property
    def reward(self) -> Array:
        """Sum of the rewards, shape (E,)."""
        return np.asarray(np.nansum(self.value, axis=0))

    def discounted(self, discount: float) -> Array:
        """Sum of the rewards, discounted by ``discount`` per control period, shape (E,)."""
        worth = discount ** np.maximum(np.arange(len(self.value)) - 1.0, 0.0)
        return np.asarray(worth @ np.nan_to_num(self.value))

    @property
    def success(self) -> Mask:
        """Whether the last waypoint was reached, shape (E,)."""
        return np.asarray(self.reached >= self.targets.shape[1])

    @property
    def time_s(self) -> Array:
        """Seconds until the last waypoint, shape (E,); NaN where it was not reached."""
        return np.where(self.success, CONTROL_S * self.steps, np.nan)

    def faced_s(self, within_rad: float = np.pi / 6) -> Array:
        """Seconds until the head points at the first target, shape (E,); NaN if it never does."""
        way = self.targets[None, :, 0] - self.pose[:, :, :2]
        bearing = np.arctan2(way[..., 1], way[..., 0]) - self.pose[:, :, 2]
        faced = np.abs((bearing + np.pi) % (2 * np.pi) - np.pi) <= within_rad
        return np.where(faced.any(axis=0), CONTROL_S * faced.argmax(axis=0), np.nan)

    def of(self, mask: Mask) -> Episodes:
        """The episodes of some of the robots, ``mask`` of shape (E,)."""
        pose, rate, value = (x[:, mask] for x in (self.pose, self.rate, self.value))
        counts = self.reached[mask], self.steps[mask]
        return Episodes(pose, rate, value, *counts, self.targets[mask])


def run_episodes(
    world: World,
    controller: Controller,
    *,
    name: str = "swim",
    watch: Callable[[Mask], None] = lambda going: None,
) -> Episodes:
    """Run one episode of every robot; ``watch`` is called with those that took part, (E,).

    A robot whose episode is over is commanded to straight joints.
    """
    E = world.n_envs
    observation = world.reset()
    targets = world.targets.cpu().double().numpy()
    controller.reset()
    pose, rate = ([x.cpu().double().numpy()] for x in (world.pose, world.rate))
    value, going = [np.zeros(E)], np.ones(E, dtype=bool)
    reached, steps = np.zeros((2, E), dtype=np.int64)
    watch(going)
    for _ in tqdm(range(world.task.steps), desc=name, unit="step", disable=None, leave=False):
        action = np.where(going[:, None], controller.act(observation.cpu().numpy()), 0.0)
        step = world.step(torch.as_tensor(action, device=world.device), begin=False)
        observation = step.observation
        value.append(np.where(going, step.reward.cpu().double().numpy(), np.nan))
        steps += going
        reached = np.where(going, step.reached.cpu().numpy(), reached)
        for recorded, values in ((pose, world.pose), (rate, world.rate)):
            recorded.append(np.where(going[:, None], values.cpu().double().numpy(), np.nan))
        watch(going)
        going &= ~(step.terminated | step.truncated).cpu().numpy()
        if not going.any():
            break
    return Episodes(np.array(pose), np.array(rate), np.array(value), reached, steps, targets)


def energy(rate: Array) -> Array:
    """The paper's energy: squared rates (T, E, J), summed over steps of 20 ms, rad^2/s^2, (E,)."""
    finite = np.asarray(np.isfinite(rate).all(axis=2))
    total = np.where(finite, np.square(rate).sum(axis=2), 0.0).sum(axis=0)
    return np.where(finite.any(axis=0), total, np.nan)


def path_length(position: Array) -> Array:
    """Length in m of the path through the finite rows of (T, E, 2), shape (E,)."""
    step = np.linalg.norm(np.diff(position, axis=0), axis=2)
    return np.where(np.isfinite(position).all(axis=2).any(axis=0), np.nansum(step, axis=0), np.nan)


def measured(episodes: Episodes, task: Task) -> dict[str, Array]:
    """Each of ``FIGURES``, shape (E,); ``success`` is 1 or 0.

    An episode without arrival counts with the full time of the task, and its mean power until then.
    Means over arrivals only would favour policies that rarely arrive.
    """
    won, used = episodes.success, energy(episodes.rate)
    return {
        "success": won.astype(np.float64),
        "time_s": np.where(won, episodes.steps, task.steps) * CONTROL_S,
        "energy": np.where(won, used, used * (task.steps / np.maximum(episodes.steps, 1))),
        "reward": episodes.reward,
        "path_m": path_length(episodes.pose[:, :, :2]),
    }


def summary(episodes: Episodes, task: Task) -> dict[str, Any]:
    """The metrics of the paper over all episodes: means, some with standard errors."""
    figures, won = measured(episodes, task), episodes.success
    time, used, reward = (figures[name] for name in ("time_s", "energy", "reward"))

    def mean(values: Array) -> float | None:
        chosen = values[np.isfinite(values)]
        return float(chosen.mean()) if chosen.size else None

    return {
        "episodes": len(won),
        "success": float(won.mean()),
        "waypoints": float(episodes.reached.mean()),
        "reward": float(reward.mean()),
        "reward_sd": float(reward.std()),
        "time_s": float(time.mean()),
        "time_error_s": float(time.std() / np.sqrt(len(time))),
        "energy": float(used.mean()),
        "energy_error": float(used.std() / np.sqrt(len(used))),
        "arrivals": {name: mean(figures[name][won]) for name in ("time_s", "energy", "path_m")},
        "faced_target_s": mean(episodes.faced_s()),
    }
