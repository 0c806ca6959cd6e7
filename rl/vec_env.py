"""Stable-Baselines3 vector environment of a batch of swimming robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv

from rl.decisions import Decisions
from rl.env import action_space, observation_space, reward_terms, succeeded
from rl.observer import View
from rl.world import Step, World
from sim2real.arrays import Array32, Index, Mask


class FishVecEnv(VecEnv):
    """Vector environment of a batch of robots in one simulator; a step is one decision of ``view``.

    ``infos[e]`` has the terms of the reward (see ``rl.env.reward_terms``). At the end of an episode
    it also has ``is_success``, the last observation as ``terminal_observation``, and the statistics
    of Monitor as ``episode``.
    """

    def __init__(self, world: World, view: View = View()) -> None:  # noqa: B008 - frozen
        self.world, self.decisions = world, Decisions(world, view)
        super().__init__(world.n_envs, observation_space(world, view), action_space(world))
        self._return = np.zeros(world.n_envs)
        self._length = np.zeros(world.n_envs, dtype=int)
        self._action = torch.zeros(world.n_envs, len(world.low), device=world.device)

    def reset(self) -> Array32:
        """Start all episodes; the first seed of ``seed`` is used for the whole batch."""
        if self._seeds[0] is not None:
            self.world.seed(self._seeds[0])
            self._reset_seeds()
        self._return[:], self._length[:] = 0.0, 0
        return self.decisions.reset().cpu().numpy()

    def step_async(self, actions: Array32) -> None:
        """Take the actions of the next step."""
        self._action = torch.as_tensor(actions, dtype=torch.float32, device=self.world.device)

    def step_wait(self) -> tuple[Array32, Array32, Mask, list[dict[str, Any]]]:
        """Simulate until the next decision."""
        step = self.decisions.step(self._action)
        value = step.reward.cpu().numpy()
        ended = (step.terminated | step.truncated).cpu().numpy()
        self._return += value
        self._length += 1
        terms = reward_terms(self.world.task, step)
        columns = [term.cpu().tolist() for term in terms.values()]
        infos: list[dict[str, Any]] = [
            dict(zip(terms, row, strict=True)) for row in zip(*columns, strict=True)
        ]
        if ended.any():
            self._tell(step, np.flatnonzero(ended), infos)
        return step.observation.cpu().numpy(), value, ended, infos

    def _tell(self, step: Step, ended: Index, infos: list[dict[str, Any]]) -> None:
        final, late = step.final.cpu().numpy(), step.truncated.cpu().numpy()
        success = succeeded(self.world.task, step).cpu().numpy()
        for e in ended:
            infos[e]["terminal_observation"] = final[e]
            infos[e]["TimeLimit.truncated"] = bool(late[e])
            infos[e]["is_success"] = bool(success[e])
            infos[e]["episode"] = {"r": float(self._return[e]), "l": int(self._length[e])}
            self._return[e], self._length[e] = 0.0, 0

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ANN401 - SB3's
        """The attribute of the shared world, once for each of the environments."""
        if attr_name == "render_mode":
            return [None for _ in self._get_indices(indices)]
        return [getattr(self.world, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ANN401
        """Environments of one world cannot differ.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(f"{attr_name}: the environments share one world")

    def env_method(
        self,
        method_name: str,
        *method_args: Any,  # noqa: ANN401
        indices: Any = None,  # noqa: ANN401
        **method_kwargs: Any,  # noqa: ANN401
    ) -> list[Any]:
        """Environments of one world have no methods of their own.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(f"{method_name}: the environments share one world")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:  # noqa: ANN401
        """False for all; ``step_wait`` returns the statistics of ``Monitor``."""
        return [False for _ in self._get_indices(indices)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the world at its next reset."""
        return super().seed(seed)
