"""Swimming robots as Gymnasium's environments: one of them, and a batch."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
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

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        world: World,
        view: View = View(),  # noqa: B008 - frozen
        *,
        render_mode: str | None = None,
    ) -> None:
        """Wrap a world.

        Args:
            world: Of one environment.
            view: How a policy looks at it.
            render_mode: ``rgb_array`` for pictures of the pool from above; None for none.

        Raises:
            ValueError: If it has several environments, or there is no such mode.
        """
        if world.n_envs != 1:
            raise ValueError(f"a world of {world.n_envs} environments, not of one")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode: {render_mode!r}, not 'rgb_array' or None")
        self.render_mode = render_mode
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
        """Take a decision and go on to the next; the next episode is for ``reset`` to begin."""
        given = torch.as_tensor(action, device=self.world.device)[None]
        step = self.decisions.step(given, begin=False)
        return (
            step.final[0].cpu().numpy(),
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            {
                "reached": int(step.reached[0]),
                "is_success": bool(step.reached[0] >= self.world.task.waypoints),
            },
        )

    def render(self) -> Any:  # noqa: ANN401 - Gymnasium's
        """The pool from above, shape (height, width, 3), 8 bits a channel; None without a mode."""
        if self.render_mode is None:
            return None
        from rl.experiments.film import still

        return still(self.world)


class FishVectorEnv(VectorEnv[Array, Array, Array]):
    """All robots of a world, one batched simulator underneath.

    An episode that ends begins anew in the same step; its last observation stands in
    ``infos["final_obs"]``, where ``infos["_final_obs"]`` is true.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - Gymnasium's way

    def __init__(self, world: World, view: View = View()) -> None:  # noqa: B008 - frozen
        """Wrap a world, seen as ``view`` says."""
        self.world, self.num_envs = world, world.n_envs
        self.decisions = Decisions(world, view)
        self.single_observation_space: Any = observation_space(world, view)
        self.single_action_space: Any = action_space(world)
        self.observation_space: Any = batch_space(self.single_observation_space, world.n_envs)
        self.action_space: Any = batch_space(self.single_action_space, world.n_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode everywhere; of several seeds the first counts, for the whole batch."""
        first = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=first)
        if first is not None:
            self.world.seed(first)
        return self.decisions.reset().cpu().numpy(), {}

    def step(self, actions: Array) -> tuple[Array, Array, Any, Any, dict[str, Any]]:
        """Take a decision everywhere and go on to the next."""
        given = torch.as_tensor(actions, dtype=torch.float32, device=self.world.device)
        step = self.decisions.step(given)
        terminated, truncated = step.terminated.cpu().numpy(), step.truncated.cpu().numpy()
        ended = terminated | truncated
        reached = step.reached.cpu().numpy()
        infos: dict[str, Any] = {"reached": reached, "_reached": np.ones(self.num_envs, dtype=bool)}
        if ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            for e in np.flatnonzero(ended):
                final[e] = step.final[e].cpu().numpy()
            infos |= {"final_obs": final, "_final_obs": ended}
        return (
            step.observation.cpu().numpy(),
            step.reward.cpu().numpy(),
            terminated,
            truncated,
            infos,
        )
