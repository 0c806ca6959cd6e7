"""Vector environment whose actions are choices between gaits."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from rl.controllers.cpg import CentralPatternGenerator
from rl.controllers.discrete_cpg import TABLE, ActionTable, with_phase
from sim2real.arrays import Array, Array32, Mask

_PHASE = 2


class DiscreteCPGEnv(VecEnvWrapper):
    """A vector environment whose actions are rows of a table, each used for ``table.hold`` periods.

    Rewards and their terms are summed over the periods. The observation includes sine and cosine of
    the first joint's phase, which determine the effect of a choice. If an episode ends within a
    choice, its reward until then counts; the reward of the next episode before its own first choice
    is ignored.
    """

    def __init__(self, venv: VecEnv, table: ActionTable = TABLE) -> None:
        """Wrap ``venv``, whose actions -1 and 1 are the joint limits ``low`` and ``high``."""
        space = venv.observation_space
        if not isinstance(space, spaces.Box):
            raise TypeError(f"observations in {space}, a box is needed")
        low, high = (np.append(x, [y] * _PHASE) for x, y in ((space.low, -1), (space.high, 1)))
        box = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        super().__init__(venv, box, spaces.Discrete(len(table)))
        self.table = table
        ends = (np.asarray(venv.get_attr(name)[0]) for name in ("low", "high"))
        self._generator = CentralPatternGenerator(np.stack(list(ends), axis=1), venv.num_envs)
        self._choice = np.zeros(venv.num_envs, dtype=np.int64)

    def reset(self) -> Array32:  # type: ignore[override]
        """As ``VecEnv.reset``."""
        observation: Any = self.venv.reset()
        self._begin(np.ones(self.num_envs, dtype=bool), observation)
        return with_phase(observation, self._generator)

    def step_async(self, actions: NDArray[np.integer]) -> None:  # type: ignore[override]
        """Store the choices (E,)."""
        self._choice = np.asarray(actions, dtype=np.int64)

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate the choices for ``table.hold`` periods."""
        gait = self.table.gait(self._choice)
        observation: Any = None
        reward = np.zeros(self.num_envs, dtype=np.float32)
        ended = np.zeros(self.num_envs, dtype=bool)
        ends: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        terms: list[dict[str, float]] = [{} for _ in range(self.num_envs)]
        for _ in range(self.table.hold):
            self.venv.step_async(self._scaled(self._generator.step(gait)))
            observation, rewards, done, infos = self.venv.step_wait()
            reward += np.where(ended, 0.0, rewards).astype(np.float32)
            for e in np.flatnonzero(~ended):
                _add_terms(terms[e], infos[e])
            for e in np.flatnonzero(done & ~ended):
                ends[e] = dict(infos[e])
                last = np.atleast_2d(ends[e]["terminal_observation"])
                ends[e]["terminal_observation"] = with_phase(last, self._generator, [e])[0]
            ended |= done
            if done.any():
                self._begin(done, observation)
        infos_out = [{**end, **sums} for end, sums in zip(ends, terms, strict=True)]
        return with_phase(observation, self._generator), reward, ended, infos_out

    def _scaled(self, angle: Array) -> Array32:
        low, high = self._generator.limits_rad.T
        return np.asarray(2 * (angle - low) / (high - low) - 1, dtype=np.float32)

    def _begin(self, mask: Mask, observation: Any) -> None:  # noqa: ANN401
        joints = self._generator.phase.shape[1]
        self._generator.reset(mask, angle=observation[:, 3 : 3 + joints])


def _add_terms(sums: dict[str, float], info: dict[str, Any]) -> None:
    """Add the terms of a period's reward, the numbers of ``info`` named ``reward_...``."""
    for name, value in info.items():
        if name.startswith("reward_"):
            sums[name] = sums.get(name, 0.0) + value
