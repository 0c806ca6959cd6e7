"""One episode of every robot under a controller, recorded and measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from rl.controllers import Controller
from rl.metrics import energy, path_length, turning_radius
from rl.task import CONTROL_S, Task
from rl.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Episodes:
    """E episodes, each recorded until it ended, NaN after that; the first row is the start.

    Attributes:
        pose: x, y in m and heading in rad of the head, shape (T, E, 3).
        rate: Joint rates in rad/s, shape (T, E, J).
        value: The task's reward of each control period, shape (T, E), 0 in the first row.
        reached: Waypoints reached, shape (E,).
        steps: Length in control periods, shape (E,).
        targets: Waypoints in m, shape (E, W, 2).
    """

    pose: Array
    rate: Array
    value: Array
    reached: NDArray[np.int64]
    steps: NDArray[np.int64]
    targets: Array

    @property
    def reward(self) -> Array:
        """Sum of the rewards, shape (E,)."""
        return np.asarray(np.nansum(self.value, axis=0))

    def discounted(self, discount: float) -> Array:
        """Sum of the rewards, one a control period later worth ``discount`` of it, shape (E,).

        What an agent is trained for; the plain sum has no price of time.
        """
        worth = discount ** np.maximum(np.arange(len(self.value)) - 1.0, 0.0)
        return np.asarray(worth @ np.nan_to_num(self.value))

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether the last waypoint was reached, shape (E,)."""
        return np.asarray(self.reached >= self.targets.shape[1])

    @property
    def time_s(self) -> Array:
        """Seconds until the last waypoint, shape (E,); NaN where it was not reached."""
        return np.where(self.success, CONTROL_S * self.steps, np.nan)

    def turned_s(self, angle_rad: float = np.pi / 2) -> Array:
        """Seconds until the heading has changed by so much, shape (E,); NaN where it never does."""
        far = np.abs(self.pose[:, :, 2] - self.pose[0, :, 2]) >= angle_rad
        return np.where(far.any(axis=0), CONTROL_S * far.argmax(axis=0), np.nan)

    def faced_s(self, within_rad: float = np.pi / 6) -> Array:
        """Seconds until the head points at the first target, shape (E,); NaN where never."""
        way = self.targets[None, :, 0] - self.pose[:, :, :2]
        off = np.arctan2(way[..., 1], way[..., 0]) - self.pose[:, :, 2]
        near = np.abs((off + np.pi) % (2 * np.pi) - np.pi) <= within_rad
        return np.where(near.any(axis=0), CONTROL_S * near.argmax(axis=0), np.nan)


def run_episodes(
    world: World,
    controller: Controller,
    *,
    name: str = "swim",
    watch: Callable[[], None] | None = None,
) -> Episodes:
    """Let every robot of a world swim one episode.

    Args:
        world: The robots; all begin anew.
        controller: What steers them.
        name: For the progress bar.
        watch: Called at the start and after every step of the first robot's episode.
    """
    E = world.n_envs
    seen = world.reset()
    targets = world.targets.cpu().double().numpy()
    controller.reset(np.ones(E, dtype=bool))
    pose, rate = [_taken(world.pose)], [_taken(world.rate)]
    value, going = [np.zeros(E)], np.ones(E, dtype=bool)
    reached, steps = np.zeros(E, dtype=np.int64), np.zeros(E, dtype=np.int64)
    if watch is not None:
        watch()
    for _ in tqdm(range(world.task.steps), desc=name, unit="step", disable=None, leave=False):
        action = controller.act(seen.cpu().numpy())
        step = world.step(torch.as_tensor(action, device=world.device), begin=False)
        seen = step.observation
        value.append(np.where(going, _taken(step.reward), np.nan))
        steps += going
        reached = np.where(going, step.reached.cpu().numpy(), reached)
        for kept, now in ((pose, world.pose), (rate, world.rate)):
            kept.append(np.where(going[:, None], _taken(now), np.nan))
        if watch is not None and going[0]:
            watch()
        going &= ~(step.terminated | step.truncated).cpu().numpy()
        if not going.any():
            break
    return Episodes(np.array(pose), np.array(rate), np.array(value), reached, steps, targets)


def _taken(tensor: torch.Tensor) -> Array:
    return np.array(tensor.cpu().numpy(), dtype=np.float64)


def spent(episodes: Episodes, task: Task) -> tuple[Array, Array]:
    """Time in s and energy of every episode, shape (E,) each, arrived or not.

    One that does not arrive takes the task's whole time; where a robot was taken out before that,
    its energy is what it would have used by then at its own mean rate. Means over arrivals alone
    would flatter who arrives seldom.
    """
    whole = task.steps / np.maximum(episodes.steps, 1)
    time = np.where(episodes.success, episodes.steps, task.steps) * CONTROL_S
    used = energy(episodes.rate)
    return time, np.where(episodes.success, used, used * whole)


def summary(episodes: Episodes, task: Task) -> dict[str, Any]:
    """What the paper counts, over all episodes: means, and standard errors of the first few."""
    heading = episodes.pose[:, :, 2]
    radius = turning_radius(episodes.pose[:, :, :2], heading)
    won = episodes.success
    time, used = spent(episodes, task)

    def mean(values: Array, where: NDArray[np.bool_] | None = None) -> float | None:
        chosen = values if where is None else values[where]
        chosen = chosen[np.isfinite(chosen)]
        return float(chosen.mean()) if chosen.size else None

    def error(values: Array) -> float:
        return float(values.std() / np.sqrt(len(values)))

    return {
        "episodes": len(won),
        "success": float(won.mean()),
        "waypoints": float(episodes.reached.mean()),
        "reward": float(episodes.reward.mean()),
        "reward_sd": float(episodes.reward.std()),
        "time_s": float(time.mean()),
        "time_error_s": error(time),
        "energy": float(used.mean()),
        "energy_error": error(used),
        "arrivals": {
            "time_s": mean(episodes.time_s),
            "energy": mean(used, won),
            "path_m": mean(path_length(episodes.pose[:, :, :2]), won),
        },
        "turned_90_s": mean(episodes.turned_s()),
        "faced_target_s": mean(episodes.faced_s()),
        "turning_radius_m": mean(radius),
    }
