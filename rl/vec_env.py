"""Stable-Baselines3 vector environment of a batch of swimming robots."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from rl.env import FishVectorEnv
from rl.observer import View
from rl.world import World
from sim2real.arrays import Array32, Mask


class FishVecEnv(VecEnv):
    """Vector environment of a batch of robots in one simulator; a step is one decision of ``view``.

    ``infos[e]`` has the terms of the reward (see ``rl.env.told``). At the end of an episode it also
    has ``is_success``, the last observation as ``terminal_observation``, and the statistics of
    Monitor as ``episode``.
    """

    def __init__(self, world: World, view: View = View()) -> None:  # noqa: B008 - frozen
        self.world = world
        self.envs = FishVectorEnv(world, view, autoreset_mode=AutoresetMode.SAME_STEP)
        spaces = self.envs.single_observation_space, self.envs.single_action_space
        super().__init__(world.n_envs, *spaces)
        self._return = np.zeros(world.n_envs)
        self._length = np.zeros(world.n_envs, dtype=int)
        self._action = np.zeros((world.n_envs, len(world.low)), dtype=np.float32)

    def reset(self) -> Array32:
        """Start all episodes; the first seed of ``seed`` is used for the whole batch."""
        observation, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._return[:], self._length[:] = 0.0, 0
        return observation

    def step_async(self, actions: Array32) -> None:
        """Take the actions of the next step."""
        self._action = actions

    def step_wait(self) -> tuple[Array32, Array32, Mask, list[dict[str, Any]]]:
        """Simulate until the next decision."""
        observation, value, terminated, truncated, told = self.envs.step(self._action)
        ended = terminated | truncated
        self._return += value
        self._length += 1
        names = [name for name in told if name.startswith("reward_")]
        rows = zip(*(told[name].tolist() for name in names), strict=True)
        infos: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in rows]
        for e in np.flatnonzero(ended):
            infos[e] |= {
                "terminal_observation": told["final_obs"][e],
                "TimeLimit.truncated": bool(truncated[e]),
                "is_success": bool(told["is_success"][e]),
                "episode": {"r": float(self._return[e]), "l": int(self._length[e])},
            }
        self._return[ended], self._length[ended] = 0.0, 0
        return observation, value, ended, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ANN401 - SB3's
        """The attribute of the shared world, once for each of the environments."""
        value = None if attr_name == "render_mode" else getattr(self.world, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ANN401
        """Refuse: environments of one world cannot differ."""
        raise NotImplementedError(f"{attr_name}: the environments share one world")

    def env_method(self, method_name: str, *_: Any, **__: Any) -> list[Any]:  # noqa: ANN401
        """Refuse: environments of one world have no methods of their own."""
        raise NotImplementedError(f"{method_name}: the environments share one world")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:  # noqa: ANN401
        """False for all; ``step_wait`` returns the statistics of ``Monitor``."""
        return [False for _ in self._get_indices(indices)]
