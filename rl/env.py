"""The swimming robot as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from rl.decisions import Decisions
from rl.observer import LARGEST, View
from rl.task import observation_bounds
from rl.world import World

Array = NDArray[np.float32]


def observation_space(world: World, view: View) -> spaces.Box:
    """What a policy sees of a world: cut to these bounds."""
    J = len(world.low)
    if view.scaled:
        bound = np.full(view.size(J), LARGEST, dtype=np.float32)
    else:
        sides = [1.25] if view.sides else []
        more = [*sides, *[1.0] * (view.size(J) - 5 - 2 * J - len(sides))]
        bound = np.array([*observation_bounds(J), *more], dtype=np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(world: World) -> spaces.Box:
    """Desired joint angles, -1 and 1 at the ends of each joint's range."""
    return spaces.Box(-1.0, 1.0, (len(world.low),), dtype=np.float32)


class FishEnv(gymnasium.Env[Array, Array]):
    """One robot at its task, in the fluid or in the twin.

    A step is one decision of ``view``: 80 ms unless it is the paper's. Observations are the view's
    columns; actions are desired joint angles, -1 and 1 at the ends of each joint's range.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own way

    def __init__(self, world: World, view: View = View()) -> None:  # noqa: B008 - frozen
        """Wrap a world.

        Args:
            world: Of one environment.
            view: How a policy looks at it.

        Raises:
            ValueError: If it has several.
        """
        if world.n_envs != 1:
            raise ValueError(f"a world of {world.n_envs} environments, not of one")
        self.world, self.decisions = world, Decisions(world, view)
        self.observation_space: Any = observation_space(world, view)
        self.action_space: Any = action_space(world)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        if seed is not None:
            self.world.seed(seed)
        return self.decisions.reset()[0].cpu().numpy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take a decision and go on to the next."""
        given = torch.as_tensor(action, device=self.world.device)[None]
        step = self.decisions.step(given, begin=False)
        return (
            step.final[0].cpu().numpy(),
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            {"reached": int(step.reached[0])},
        )
