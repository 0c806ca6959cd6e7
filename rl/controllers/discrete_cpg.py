"""A policy that chooses the parameters of a central pattern generator from a table.

Similar to the controller "Zhang et al." of the paper (IEEE Trans. Robot., 2022): reinforcement
learning chooses between a few gaits, and the generator computes joint angles. The table, the
duration of a choice and the network are different. ``discrete_train`` trains it.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import DQN

from rl.controllers.cpg import CentralPatternGenerator, Gait
from rl.sac.policy_zip import read_policy_zip, read_settings, write_policy_zip
from rl.sac.sac import Spaces
from rl.task import CONTROL_S
from sim2real.arrays import Array, Array32, Mask
from sim2real.errors import InputError

LONGEST_HOLD = 1000
"""Longest duration of a choice in control periods."""


@dataclass(frozen=True)
class ActionTable:
    """A table of N gaits.

    Attributes:
        frequency_hz: Beats per second, shape (N,).
        amplitude_rad: Amplitude of the last joint, shape (N,).
        offset_rad: Bend, shape (N,); negative to the left.
        front: Amplitude of the first joint relative to the last.
        lag_rad: Phase lag of a joint relative to the previous one.
        hold: Duration of a choice in control periods.
    """

    frequency_hz: Array
    amplitude_rad: Array
    offset_rad: Array
    front: float
    lag_rad: float
    hold: int

    @classmethod
    def of(
        cls,
        frequencies: Sequence[float],
        amplitude: float,
        offsets: Sequence[float],
        *,
        front: float,
        lag_rad: float,
        hold: int,
    ) -> ActionTable:
        """All combinations of frequency and offset, and as last gait straight joints at rest."""
        rows = [(f, amplitude, b) for f, b in product(frequencies, offsets)]
        frequency, height, offset = np.array([*rows, (frequencies[0], 0.0, 0.0)]).T
        return cls(frequency, height, offset, front, lag_rad, hold)

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def gait(self, choice: NDArray[np.integer]) -> Gait:
        """The gaits of choices (E,)."""
        return Gait(
            frequency_hz=self.frequency_hz[choice],
            amplitude_rad=self.amplitude_rad[choice],
            front=self.front,
            lag_rad=self.lag_rad,
            offset_rad=self.offset_rad[choice],
        )

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


TABLE = ActionTable.of(
    (0.8, 1.6, 2.4), 0.6, (-0.6, -0.3, 0.0, 0.3, 0.6), front=1.2, lag_rad=0.8, hold=10
)
"""Sixteen gaits, each used for 0.2 s: half a beat of the fastest."""


class DiscreteCPG:
    """A trained policy as a controller.

    Attributes:
        model: The policy, of Stable-Baselines3.
        table: The gaits.
    """

    def __init__(
        self,
        model: DQN,
        limits_rad: ArrayLike,
        n_envs: int = 1,
        table: ActionTable = TABLE,
        *,
        dt: float = CONTROL_S,
    ) -> None:
        """``table`` must be that of the training."""
        self.model, self.table = model, table
        self._generator = CentralPatternGenerator(limits_rad, n_envs, dt=dt)
        self._choice, self._left = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask
        self._left[mask] = 0

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        joints = self._generator.phase.shape[1]
        self._generator.reset(self._fresh, angle=observation[:, 3 : 3 + joints])
        due = self._left == 0
        if due.any():
            inputs = with_phase(observation[due], self._generator, np.flatnonzero(due))
            self._choice[due] = self.model.predict(inputs, deterministic=True)[0]
            self._left[due] = self.table.hold
        self._left -= 1
        self._fresh[:] = False
        return self._generator.step(self.table.gait(self._choice)).astype(np.float32)


def with_phase(
    observation: NDArray[np.floating],
    generator: CentralPatternGenerator,
    rows: ArrayLike | None = None,
) -> Array32:
    """The observations (E, N) with two columns for the phase of the generator's ``rows``."""
    phase = generator.first_phase()
    phase = phase if rows is None else phase[np.asarray(rows, dtype=np.intp)]
    columns = [observation, np.sin(phase)[:, None], np.cos(phase)[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)


class GaitDQN(DQN):
    """Deep Q-learning whose choices are rows of a table, saved without pickled objects.

    Attributes:
        gaits: The table, as ``ActionTable.content``.
        joints: Names of the joints.
    """

    gaits: Mapping[str, Any]
    joints: list[str]

    def save(
        self,
        path: str | os.PathLike[str] | io.BufferedIOBase,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """Write ``policy.zip`` atomically.

        Args:
            path: Name of the file.
            exclude: Unused.
            include: Unused.
        """
        del exclude, include
        settings = {"algorithm": "DQN", "gaits": self.gaits, "joints": self.joints}
        file = cast("str | os.PathLike[str]", path)
        write_policy_zip(file, settings, self.policy.state_dict(), {})


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
    """Read a policy of ``discrete_train`` as a controller.

    Nothing in the file is executed, see ``rl.sac.policy_zip``.

    Args:
        path: The file.
        table: Its gaits, by ``read_table``.
        limits_rad: Lowest and highest angle of each joint, shape (J, 2).
        n_envs: Number of robots E.

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
    options = {"net_arch": hidden}
    env = Spaces(box, spaces.Discrete(choices))
    model = GaitDQN("MlpPolicy", env, buffer_size=1, policy_kwargs=options, device="cpu")
    saved.load_into(model.policy)
    return DiscreteCPG(model, limits_rad, n_envs, table)
