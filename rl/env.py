"""Gymnasium environments of one swimming robot and of a batch."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import HumanRendering
from torch import Tensor

from rl.make import world_of
from rl.observer import LARGEST, View, observation_bounds
from rl.task import Task
from rl.world import Decisions, Step, World
from sim2real.arrays import Array32, Mask
from sim2real.extras import library


def observation_space(world: World, view: View) -> spaces.Box:
    """Space of the observations, which are clipped to its bounds."""
    J = len(world.low)
    if view.scaled:
        bound = np.full(view.size(J), LARGEST, dtype=np.float32)
    else:
        sides = [1.25] if view.sides else []
        others = [*sides, *[1.0] * (view.size(J) - 5 - 2 * J - len(sides))]
        bound = np.array([*observation_bounds(J), *others], dtype=np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(world: World) -> spaces.Box:
    """Desired joint angles, -1 and 1 at the ends of each joint's range."""
    return spaces.Box(-1.0, 1.0, (len(world.low),), dtype=np.float32)


def reward_terms(task: Task, step: Step) -> dict[str, Tensor]:
    """Terms of the reward of a step, as in ``info``, each of shape (E,); their sum is the reward.

    ``reward_progress`` rewards the approach to the target, ``reward_bonus`` arrival (positive) or
    leaving the pool (negative), and ``reward_energy`` (never positive) penalises the squared joint
    rates; see ``rl.task``.
    """
    energy = -task.energy * step.effort
    return {
        "reward_progress": step.reward - energy - step.bonus,
        "reward_bonus": step.bonus,
        "reward_energy": energy,
    }


def succeeded(task: Task, step: Step) -> Tensor:
    """Where the last waypoint has been reached, shape (E,)."""
    return step.reached >= task.waypoints


class FishEnv(gymnasium.Env[Array32, Array32]):
    """Environment of one robot, in the fluid or in the twin.

    A step is one decision of ``view``: 80 ms, or 20 ms for ``PAPER``. Observations are the columns
    of the view; actions are desired joint angles, -1 and 1 at the ends of each joint's range.
    ``info`` has ``is_success``, ``reached`` (waypoints so far) and the terms of the reward, see
    ``reward_terms``.
    """

    metadata = {  # noqa: RUF012 - Gymnasium's way
        "render_modes": ["rgb_array"],
        "render_fps": 1 / View().decision_s,
    }

    def __init__(
        self,
        world: World,
        view: View = View(),  # noqa: B008 - frozen
        *,
        render_mode: str | None = None,
    ) -> None:
        """Wrap a world.

        Args:
            world: World with one environment.
            view: Definition of observation and decision period.
            render_mode: ``rgb_array`` for images of the pool from above, which Gymnasium's wrapper
                ``HumanRendering`` shows in a window; None for no rendering.

        Raises:
            ValueError: If it has several environments, or there is no such mode.
        """
        if world.n_envs != 1:
            raise ValueError(f"a world of {world.n_envs} environments, not of one")
        modes = type(self).metadata["render_modes"]
        if render_mode not in (None, *modes):
            raise ValueError(f"render_mode: {render_mode!r}, not one of {modes} or None")
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": 1 / view.decision_s}
        self.world, self.decisions = world, Decisions(world, view)
        self.observation_space: Any = observation_space(world, view)
        self.action_space: Any = action_space(world)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        if seed is not None:
            self.world.seed(seed)
        return self.decisions.reset()[0].cpu().numpy(), {}

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Apply a decision and simulate until the next; ``reset`` starts the next episode."""
        decision = torch.as_tensor(action, device=self.world.device)[None]
        step = self.decisions.step(decision, begin=False)
        terms = reward_terms(self.world.task, step)
        info = {
            "reached": int(step.reached[0]),
            "is_success": bool(succeeded(self.world.task, step)[0]),
            **{name: float(term[0]) for name, term in terms.items()},
        }
        return (
            step.final[0].cpu().numpy(),
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            info,
        )

    def render(self) -> Any:  # noqa: ANN401 - Gymnasium's
        """Image of the pool from above, shape (height, width, 3), 8 bits per channel.

        None without a render mode.
        """
        from rl.experiments.film import still

        return None if self.render_mode is None else still(self.world)


class FishVectorEnv(VectorEnv[Array32, Array32, Array32]):
    """Vector environment of a batch of robots in one simulator.

    With ``autoreset_mode`` ``NEXT_STEP``, Gymnasium's default, the step after the last one of an
    episode resets it: its action is ignored, its reward is zero and its observation is the first of
    the new episode. With ``SAME_STEP`` an episode is reset in the step in which it ends; its last
    observation is in ``infos["final_obs"]``, where ``infos["_final_obs"]`` is true. ``infos`` has
    ``reached``, ``is_success`` and the terms of the reward, each of shape (E,).
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        world: World,
        view: View = View(),  # noqa: B008 - frozen
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Wrap a world.

        Args:
            world: The batch of robots with their task.
            view: Definition of observation and decision period.
            autoreset_mode: Gymnasium's ``AutoresetMode`` or its value, ``NextStep`` or
                ``SameStep``.

        Raises:
            ValueError: If there is no such mode, or it is ``Disabled``.
        """
        mode = AutoresetMode(autoreset_mode)
        if mode is AutoresetMode.DISABLED:
            raise ValueError("autoreset_mode: 'Disabled', not 'NextStep' or 'SameStep'")
        self.autoreset_mode = mode
        self.metadata = {**type(self).metadata, "autoreset_mode": mode}
        self.world, self.num_envs = world, world.n_envs
        self.decisions = Decisions(world, view)
        self.single_observation_space: Any = observation_space(world, view)
        self.single_action_space: Any = action_space(world)
        self.observation_space: Any = batch_space(self.single_observation_space, world.n_envs)
        self.action_space: Any = batch_space(self.single_action_space, world.n_envs)
        self._over = torch.zeros(world.n_envs, dtype=torch.bool, device=world.device)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start all episodes; of several seeds, the first is used for the whole batch."""
        first = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=first)
        if first is not None:
            self.world.seed(first)
        self._over[:] = False
        return self.decisions.reset().cpu().numpy(), {}

    def step(self, actions: Array32) -> tuple[Array32, Array32, Any, Any, dict[str, Any]]:
        """Apply a decision of each robot and simulate until the next."""
        decision = torch.as_tensor(actions, dtype=torch.float32, device=self.world.device)
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        step = self.decisions.step(decision, begin=same_step)
        task, active, observed = self.world.task, ~self._over, step.observation
        terminated, truncated = step.terminated & active, step.truncated & active
        reported = {"reached": step.reached, "is_success": succeeded(task, step)}
        reported |= reward_terms(task, step)
        infos = {name: (values * active).cpu().numpy() for name, values in reported.items()}
        infos |= {f"_{name}": active.cpu().numpy() for name in reported}
        ended = terminated | truncated
        if same_step:
            infos |= _finals(step.final.cpu().numpy(), ended.cpu().numpy())
        else:
            if self._over.any():
                observed = self.decisions.begin(self._over)
            self._over = ended
        return (
            observed.cpu().numpy(),
            (step.reward * active).cpu().numpy(),
            terminated.cpu().numpy(),
            truncated.cpu().numpy(),
            infos,
        )


def _finals(final: Array32, ended: Mask) -> dict[str, Any]:
    """The last observations of the episodes that ended, as Gymnasium keeps them in ``infos``."""
    if not ended.any():
        return {}
    observations = np.full(len(ended), None, dtype=object)
    for e in np.flatnonzero(ended):
        observations[e] = final[e]
    return {"final_obs": observations, "_final_obs": ended}


def make_fish(
    *,
    render_mode: str | None = None,
    view: View = View(),  # noqa: B008 - frozen
    **options: Any,  # noqa: ANN401
) -> gymnasium.Env[Array32, Array32]:
    """The environment of ``gymnasium.make("sim2real/Fish-v0")``; options as for ``world_of``.

    ``render_mode="human"`` shows it in a window (extra ``render``).
    """
    if render_mode != "human":
        return FishEnv(world_of(1, **options), view, render_mode=render_mode)
    library("pygame", "sim2real/Fish-v0")
    return HumanRendering(FishEnv(world_of(1, **options), view, render_mode="rgb_array"))


def make_fish_vec(
    num_envs: int = 1,
    *,
    view: View = View(),  # noqa: B008 - frozen
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,  # noqa: ANN401
) -> FishVectorEnv:
    """That of ``gymnasium.make_vec("sim2real/Fish-v0")``; options as for ``world_of``."""
    return FishVectorEnv(world_of(num_envs, **options), view, autoreset_mode=autoreset_mode)
