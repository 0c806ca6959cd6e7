"""Gymnasium environments of one swimming robot and of a batch."""

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
from sim2real.arrays import Array32
from sim2real.errors import library


def observation_space(world: World, view: View) -> spaces.Box:
    """Space of the observations, which are clipped to its bounds."""
    J = len(world.low)
    others = [1.25, *[1.0] * view.size(J)] if view.sides else [1.0] * view.size(J)
    bounds = [LARGEST] * view.size(J) if view.scaled else [*observation_bounds(J), *others]
    bound = np.array(bounds[: view.size(J)], dtype=np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(world: World) -> spaces.Box:
    """Desired joint angles, -1 and 1 at the ends of each joint's range."""
    return spaces.Box(-1.0, 1.0, (len(world.low),), dtype=np.float32)


def told(task: Task, step: Step) -> dict[str, Tensor]:
    """What ``info`` has of a step, each of shape (E,); the three terms sum up to the reward.

    ``reached`` are the waypoints so far, ``is_success`` whether the last is among them;
    ``reward_progress`` is for the approach to the target, ``reward_bonus`` for arrival (positive)
    or leaving the pool (negative), ``reward_energy`` for squared joint rates; see ``rl.task``.
    """
    energy = -task.energy * step.effort
    return {
        "reached": step.reached,
        "is_success": step.reached >= task.waypoints,
        "reward_progress": step.reward - energy - step.bonus,
        "reward_bonus": step.bonus,
        "reward_energy": energy,
    }


class FishEnv(gymnasium.Env[Array32, Array32]):
    """Environment of one robot, in the fluid or in the twin.

    A step is one decision of ``view``: 80 ms, or 20 ms for ``PAPER``. Observations are the columns
    of the view; actions are desired joint angles, -1 and 1 at the ends of each joint's range.
    ``info`` has the values of ``told``.
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
        """Wrap a world with one environment; with ``rgb_array`` there are images of it from above.

        Raises:
            ValueError: If the world has several environments, or there is no such mode.
        """
        if world.n_envs != 1:
            raise ValueError(f"a world of {world.n_envs} environments, not of one")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: {render_mode!r}, not 'rgb_array' or None")
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
        """Apply a decision and simulate until the next; ``reset`` starts the next episode.

        ``action`` may be of any type that NumPy reads, and is clipped to its space.
        """
        decision = torch.as_tensor(action, dtype=torch.float32, device=self.world.device)
        step = self.decisions.step(decision[None], begin=False)
        info = {name: values[0].item() for name, values in told(self.world.task, step).items()}
        ends = bool(step.terminated[0]), bool(step.truncated[0])
        return step.final[0].cpu().numpy(), float(step.reward[0]), *ends, info

    def render(self) -> Any:  # noqa: ANN401 - Gymnasium's
        """Image of the pool from above, shape (height, width, 3), 8 bits per channel.

        None without a render mode.
        """
        from rl.experiments.film import still

        return None if self.render_mode is None else still(self.world)


class FishVectorEnv(VectorEnv[Array32, Array32, Array32]):
    """Vector environment of a batch of robots in one simulator.

    With ``autoreset_mode`` ``NEXT_STEP``, Gymnasium's default, the step after the last one of an
    episode resets it: its action is ignored, its reward is zero. With ``SAME_STEP`` an episode is
    reset in the step in which it ends; its last observation is in ``infos["final_obs"]``. ``infos``
    has the values of ``told``, each of shape (E,).
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        world: World,
        view: View = View(),  # noqa: B008 - frozen
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Wrap a world; ``autoreset_mode`` may also be a value, ``NextStep`` or ``SameStep``.

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
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        decisions = torch.as_tensor(actions, dtype=torch.float32, device=self.world.device)
        step = self.decisions.step(decisions, begin=same_step)
        active, observed = ~self._over, step.observation
        terminated, truncated = step.terminated & active, step.truncated & active
        infos: dict[str, Any] = {}
        for name, values in told(self.world.task, step).items():
            infos |= {name: (values * active).cpu().numpy(), f"_{name}": active.cpu().numpy()}
        ended = terminated | truncated
        if same_step:
            if ended.any():
                final, infos["_final_obs"] = step.final.cpu().numpy(), ended.cpu().numpy()
                infos["final_obs"] = np.full(self.num_envs, None, dtype=object)
                for e in np.flatnonzero(infos["_final_obs"]):
                    infos["final_obs"][e] = final[e]
        else:
            if self._over.any():
                observed = self.decisions.begin(self._over)
            self._over = ended
        results = (observed, step.reward * active, terminated, truncated)
        return *(one.cpu().numpy() for one in results), infos  # type: ignore[return-value]


def make_fish(
    *,
    render_mode: str | None = None,
    view: View = View(),  # noqa: B008 - frozen
    **options: Any,  # noqa: ANN401
) -> gymnasium.Env[Array32, Array32]:
    """The environment of ``gymnasium.make("sim2real/Fish-v0")``; options as for ``world_of``."""
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
