"""A policy that picks a central pattern generator's parameters from a table.

The controller "Zhang et al." of the paper in spirit (IEEE Trans. Robot., 2022): reinforcement
learning that decides between a few gaits and leaves the joints to the generator. The table, the
time for which a choice holds and the network are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from rl.controllers.cpg import CentralPatternGenerator, Gait
from rl.task import CONTROL_S

Array = NDArray[np.float64]

HOLD = 10
"""Control periods for which a choice holds: 0.2 s."""
FRONT, LAG_RAD = 1.2, 0.8
_PHASE = 2


@dataclass(frozen=True)
class ActionTable:
    """Gaits to choose from, each field of shape (N,).

    Attributes:
        frequency_hz: Beats a second.
        amplitude_rad: Amplitude of the last joint.
        offset_rad: Bend; below zero to the left.
    """

    frequency_hz: Array
    amplitude_rad: Array
    offset_rad: Array

    @classmethod
    def of(
        cls, frequencies: Sequence[float], amplitude: float, offsets: Sequence[float]
    ) -> ActionTable:
        """Every frequency with every offset, and last of all straight and still, to glide."""
        rows = [(f, amplitude, b) for f, b in product(frequencies, offsets)]
        return cls(*np.array([*rows, (frequencies[0], 0.0, 0.0)]).T)

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def gait(self, choice: NDArray[np.integer]) -> Gait:
        """The gaits of choices (E,)."""
        return Gait(
            frequency_hz=self.frequency_hz[choice],
            amplitude_rad=self.amplitude_rad[choice],
            front=FRONT,
            lag_rad=LAG_RAD,
            offset_rad=self.offset_rad[choice],
        )


TABLE = ActionTable.of((0.8, 1.6, 2.4), 0.6, (-0.6, -0.3, 0.0, 0.3, 0.6))
"""Sixteen gaits."""


class DiscreteCPGEnv(VecEnvWrapper):
    """A vector environment whose actions are rows of a table, each held for ``hold`` periods.

    Rewards of the periods add up. The observation gets the sine and cosine of the first joint's
    phase, without which it would not tell what a choice does next. An episode that ends within a
    choice gives its reward until then; what the next one earns before its own first choice, with
    the same gait, is not counted.
    """

    def __init__(self, venv: VecEnv, table: ActionTable = TABLE, hold: int = HOLD) -> None:
        """Wrap ``venv``, whose actions -1 and 1 are the ends ``low`` and ``high`` of its joints."""
        seen = venv.observation_space
        if not isinstance(seen, spaces.Box):
            raise TypeError(f"observations in {seen}, a box is needed")
        low, high = (np.append(x, [y] * _PHASE) for x, y in ((seen.low, -1), (seen.high, 1)))
        box = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        super().__init__(venv, box, spaces.Discrete(len(table)))
        self.table, self.hold = table, hold
        ends = (np.asarray(venv.get_attr(name)[0]) for name in ("low", "high"))
        self._generator = CentralPatternGenerator(np.stack(list(ends), axis=1), venv.num_envs)
        self._choice = np.zeros(venv.num_envs, dtype=np.int64)

    def reset(self) -> NDArray[np.float32]:  # type: ignore[override]
        """As ``VecEnv.reset``."""
        observation: Any = self.venv.reset()
        self._begin(np.ones(self.num_envs, dtype=bool), observation)
        return with_phase(observation, self._generator)

    def step_async(self, actions: NDArray[np.integer]) -> None:  # type: ignore[override]
        """Take the choices (E,)."""
        self._choice = np.asarray(actions, dtype=np.int64)

    def step_wait(self) -> VecEnvStepReturn:
        """Swim them for ``hold`` periods."""
        gait = self.table.gait(self._choice)
        observation: Any = None
        reward = np.zeros(self.num_envs, dtype=np.float32)
        over = np.zeros(self.num_envs, dtype=bool)
        ends: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self.hold):
            self.venv.step_async(self._scaled(self._generator.step(gait)))
            observation, gained, done, infos = self.venv.step_wait()
            reward += np.where(over, 0.0, gained).astype(np.float32)
            for e in np.flatnonzero(done & ~over):
                ends[e] = dict(infos[e])
                last = np.atleast_2d(ends[e]["terminal_observation"])
                ends[e]["terminal_observation"] = with_phase(last, self._generator, [e])[0]
            over |= done
            if done.any():
                self._begin(done, observation)
        return with_phase(observation, self._generator), reward, over, ends

    def _scaled(self, angle: Array) -> NDArray[np.float32]:
        low, high = self._generator.limits_rad.T
        return np.asarray(2 * (angle - low) / (high - low) - 1, dtype=np.float32)

    def _begin(self, mask: NDArray[np.bool_], observation: Any) -> None:  # noqa: ANN401
        joints = self._generator.phase.shape[1]
        self._generator.reset(mask, angle=observation[:, 3 : 3 + joints])


class DiscreteCPG:
    """A trained policy as a controller.

    Attributes:
        model: The policy, by stable-baselines3.
    """

    def __init__(
        self,
        model: PPO | str | Path,
        limits_rad: ArrayLike,
        n_envs: int = 1,
        table: ActionTable = TABLE,
        hold: int = HOLD,
        *,
        dt: float = CONTROL_S,
    ) -> None:
        """``model`` is a PPO or its file; table and hold have to be those of its training."""
        self.model = model if isinstance(model, PPO) else PPO.load(model, device="cpu")
        self.table, self.hold = table, hold
        self._generator = CentralPatternGenerator(limits_rad, n_envs, dt=dt)
        self._choice, self._left = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask
        self._left[mask] = 0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Desired joint angles; see ``Controller``."""
        joints = self._generator.phase.shape[1]
        self._generator.reset(self._fresh, angle=observation[:, 3 : 3 + joints])
        due = self._left == 0
        if due.any():
            seen = with_phase(observation[due], self._generator, np.flatnonzero(due))
            self._choice[due] = self.model.predict(seen, deterministic=True)[0]
            self._left[due] = self.hold
        self._left -= 1
        self._fresh[:] = False
        return self._generator.step(self.table.gait(self._choice)).astype(np.float32)


def with_phase(
    observation: NDArray[np.floating],
    generator: CentralPatternGenerator,
    rows: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """The observations (E, N) of the generator's ``rows`` with two columns for its phase."""
    phase = generator.first_phase()
    phase = phase if rows is None else phase[np.asarray(rows, dtype=np.intp)]
    columns = [observation, np.sin(phase)[:, None], np.cos(phase)[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)


def train(env: VecEnv, steps: int, *, seed: int, log: str | None = None) -> PPO:
    """Train on ``env``, which this wraps, for ``steps`` choices in all environments together."""
    model = PPO(
        "MlpPolicy", DiscreteCPGEnv(env), n_steps=64, batch_size=1024, n_epochs=8, gamma=0.98,
        ent_coef=0.005, learning_rate=5e-4, policy_kwargs={"net_arch": [64, 64]}, seed=seed,
        tensorboard_log=log, device="cpu",
    )  # fmt: skip
    return model.learn(steps)
