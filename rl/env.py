"""The swimming robot as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from rl.task import observation_bounds
from rl.world import World

Array = NDArray[np.float32]


def observation_space(world: World) -> spaces.Box:
    """That of ``rl.task``, in SI units."""
    bound = np.array(observation_bounds(len(world.low)), dtype=np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(world: World) -> spaces.Box:
    """Desired joint angles, -1 and 1 at the ends of each joint's range."""
    return spaces.Box(-1.0, 1.0, (len(world.low),), dtype=np.float32)


def desired_angles(world: World, action: Tensor) -> Tensor:
    """Set-points in rad from actions between -1 and 1, shape (E, J)."""
    return world.low + (action + 1) / 2 * (world.high - world.low)


class FishEnv(gymnasium.Env[Array, Array]):
    """One robot at its task, in the fluid or in the twin.

    Observations are those of ``rl.task``; actions are desired joint angles, -1 and 1 at the ends of
    each joint's range.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own way

    def __init__(self, world: World) -> None:
        """Wrap a world.

        Args:
            world: Of one environment.

        Raises:
            ValueError: If it has several.
        """
        if world.n_envs != 1:
            raise ValueError(f"a world of {world.n_envs} environments, not of one")
        self.world = world
        self.observation_space: Any = observation_space(world)
        self.action_space: Any = action_space(world)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        if seed is not None:
            self.world.seed(seed)
        return self.world.reset()[0].cpu().numpy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Send set-points and go on by 20 ms."""
        given = torch.as_tensor(action, device=self.world.device)[None]
        step = self.world.step(desired_angles(self.world, given))
        return (
            step.final[0].cpu().numpy(),
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            {"reached": int(step.reached[0])},
        )
