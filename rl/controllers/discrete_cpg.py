"""A policy that chooses the parameters of a central pattern generator from a table.

Similar to the controller "Zhang et al." of the paper (IEEE Trans. Robot., 2022): reinforcement
learning chooses between a few gaits, and the generator computes joint angles. The table, the
duration of a choice and the network are different. ``discrete_train`` trains it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from rl.controllers.cpg import CentralPatternGenerator, Gait
from rl.sac.policy_zip import SavedAsZip, load_weights, read_policy_zip, read_settings
from rl.sac.sac import Spaces
from sim2real.arrays import Array, Array32, Mask
from sim2real.errors import InputError

LONGEST_HOLD = 1000
"""Longest duration of a choice in control periods."""


@dataclass(frozen=True)
class ActionTable:
    """A table of N gaits, see ``Gait``: three columns (N,), and what they have in common.

    A choice is used for ``hold`` control periods.
    """

    frequency_hz: Array
    amplitude_rad: Array
    offset_rad: Array
    front: float
    lag_rad: float
    hold: int

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def gait(self, choice: NDArray[np.integer]) -> Gait:
        """The gaits of choices (E,)."""
        columns = (self.frequency_hz, self.amplitude_rad, self.offset_rad)
        frequency, amplitude, offset = (column[choice] for column in columns)
        return Gait(frequency, amplitude, self.front, self.lag_rad, offset)

    def content(self) -> dict[str, Any]:
        """The table as JSON values."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> ActionTable:
        """The table in ``content``.

        Raises:
            KeyError, TypeError, ValueError: If it is invalid.
        """
        columns = (content[k] for k in ("frequency_hz", "amplitude_rad", "offset_rad"))
        frequency, amplitude, offset = (np.array(c, dtype=np.float64) for c in columns)
        if frequency.ndim != 1 or {amplitude.shape, offset.shape} != {frequency.shape}:
            raise ValueError("columns of different lengths")
        front, lag, hold = (float(content[k]) for k in ("front", "lag_rad", "hold"))
        if not np.isfinite([*frequency, *amplitude, *offset, front, lag]).all():
            raise ValueError("a number that is not finite")
        if not 1 <= hold <= LONGEST_HOLD:
            raise ValueError(f"a hold of {hold:g}")
        return cls(frequency, amplitude, offset, front, lag, int(hold))


_MOVING = [(f, 0.6, bend) for f in (0.8, 1.6, 2.4) for bend in (-0.6, -0.3, 0.0, 0.3, 0.6)]
_frequency, _amplitude, _offset = np.array([*_MOVING, (0.8, 0.0, 0.0)]).T
TABLE = ActionTable(_frequency, _amplitude, _offset, front=1.2, lag_rad=0.8, hold=10)
"""Sixteen gaits, the last at rest, each used for 0.2 s: half a beat of the fastest."""


class DiscreteCPG:
    """A trained policy as a controller; ``table`` must be that of the training."""

    def __init__(
        self, model: DQN, limits_rad: ArrayLike, n_envs: int = 1, table: ActionTable = TABLE
    ) -> None:
        self.model, self.table = model, table
        self._generator = CentralPatternGenerator(limits_rad, n_envs)
        self._choice, self._left = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask
        self._left[mask] = 0

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        self._generator.reset(self._fresh, observation)
        due = self._left == 0
        if due.any():
            inputs = with_phase(observation[due], self._generator, due)
            self._choice[due] = self.model.predict(inputs, deterministic=True)[0]
            self._left[due] = self.table.hold
        self._left -= 1
        self._fresh[:] = False
        return self._generator.step(self.table.gait(self._choice)).astype(np.float32)


def with_phase(
    observation: NDArray[np.floating],
    generator: CentralPatternGenerator,
    rows: Mask | slice | list[int] = slice(None),
) -> Array32:
    """The observations (E, N) with two columns for the phase of the generator's ``rows``."""
    phase = generator.phase[rows, 0]
    columns = [observation, np.sin(phase)[:, None], np.cos(phase)[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)


class DiscreteCPGEnv(VecEnvWrapper):
    """A vector environment whose actions are rows of a table, each used for ``table.hold`` periods.

    Rewards and their terms are summed over the periods. The observation includes sine and cosine of
    the first joint's phase, which determine the effect of a choice. If an episode ends within a
    choice, its reward until then counts; the reward of the next episode before its own first choice
    is ignored. Actions -1 and 1 of ``venv`` are its joint limits ``low`` and ``high``.
    """

    def __init__(self, venv: VecEnv, table: ActionTable = TABLE) -> None:
        space: Any = venv.observation_space
        low, high = np.append(space.low, [-1, -1]), np.append(space.high, [1, 1])
        box = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        super().__init__(venv, box, spaces.Discrete(len(table)))
        self.table = table
        limits = np.stack([np.asarray(venv.get_attr(name)[0]) for name in ("low", "high")], axis=1)
        self._generator = CentralPatternGenerator(limits, venv.num_envs)
        self._choice = np.zeros(venv.num_envs, dtype=np.int64)

    def reset(self) -> Array32:  # type: ignore[override]
        """As ``VecEnv.reset``."""
        observation: Any = self.venv.reset()
        self._generator.reset(np.ones(self.num_envs, dtype=bool), observation)
        return with_phase(observation, self._generator)

    def step_async(self, actions: NDArray[np.integer]) -> None:  # type: ignore[override]
        """Store the choices (E,)."""
        self._choice = np.asarray(actions, dtype=np.int64)

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate the choices for ``table.hold`` periods."""
        gait, (low, high) = self.table.gait(self._choice), self._generator.limits_rad.T
        observation: Any = None
        reward = np.zeros(self.num_envs, dtype=np.float32)
        ended = np.zeros(self.num_envs, dtype=bool)
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self.table.hold):
            angle = self._generator.step(gait)
            self.venv.step_async((2 * (angle - low) / (high - low) - 1).astype(np.float32))
            observation, rewards, done, infos = self.venv.step_wait()
            reward += np.where(ended, 0.0, rewards).astype(np.float32)
            for e in np.flatnonzero(~ended).tolist():
                terms = {name: x for name, x in infos[e].items() if name.startswith("reward_")}
                sums = {name: told[e].get(name, 0.0) + x for name, x in terms.items()}
                told[e] |= (infos[e] if done[e] else {}) | sums
            for e in np.flatnonzero(done & ~ended).tolist():
                last = np.atleast_2d(told[e]["terminal_observation"])
                told[e]["terminal_observation"] = with_phase(last, self._generator, [e])[0]
            ended |= done
            if done.any():
                self._generator.reset(done, observation)
        return with_phase(observation, self._generator), reward, ended, told


class GaitDQN(SavedAsZip, DQN):
    """Deep Q-learning whose choices are rows of a table, saved without pickled objects.

    Attributes:
        gaits: The table, as ``ActionTable.content``.
        joints: Names of the joints.
    """

    gaits: Mapping[str, Any]
    joints: list[str]

    def content(self) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Settings and further tensors of ``policy.zip``."""
        return {"algorithm": "DQN", "gaits": self.gaits, "joints": self.joints}, {}


def read_table(path: str | os.PathLike[str]) -> ActionTable | None:
    """Read the gaits of a trained policy; None if the file has none.

    Raises:
        InputError: If its gaits are invalid.
    """
    try:
        content = read_settings(path)["gaits"]
    except (InputError, KeyError):
        return None
    try:
        return ActionTable.from_content(content)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        expected = "frequencies, amplitudes and offsets"
        raise InputError(Path(path), "gaits", f"an invalid table ({error})", expected) from None


def read_policy(
    path: str | os.PathLike[str], table: ActionTable, limits_rad: ArrayLike, n_envs: int
) -> DiscreteCPG:
    """Read a policy of ``discrete_train`` as a controller; nothing in the file is executed.

    ``table`` are its gaits, by ``read_table``, ``limits_rad`` those of the joints, shape (J, 2).

    Raises:
        InputError: If it is no policy, or for a robot with another number of joints.
    """
    saved = read_policy_zip(path, "DQN")
    columns, *hidden, choices = saved.widths("q_net.q_net")
    joints = len(np.asarray(limits_rad))
    if columns != 7 + 2 * joints:
        expected = f"{7 + 2 * joints} for the robot's {joints} joints"
        raise InputError(Path(path), "observation", f"{columns} columns", expected)
    if choices != len(table):
        raise InputError(Path(path), "gaits", f"{len(table)}", f"{choices}, as the network has")
    box = spaces.Box(-np.inf, np.inf, (columns,), dtype=np.float32)
    env, network = Spaces(box, spaces.Discrete(choices)), {"net_arch": hidden}
    model = GaitDQN("MlpPolicy", env, buffer_size=1, policy_kwargs=network, device="cpu")
    load_weights(path, model.policy, saved.weights)
    return DiscreteCPG(model, limits_rad, n_envs, table)
