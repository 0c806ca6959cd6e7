"""A trained policy that acts as it learned: with noise of the size that it chose itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rl.deploy.export import policy_of, read_agent
from rl.sac.agents import Settings
from rl.task import CONTROL_S


class SampledController:
    """Samples the actor's own distribution, its noise correlated in time as in training.

    The mean action cannot choose a side: to a robot with like sides that learned from mirror images
    a target right behind is as far to the left as to the right, and it keeps still.
    """

    def __init__(self, path: Path | str, seed: int = 0, noise_s: float = Settings.noise_s) -> None:
        """Read an agent.

        Args:
            path: ``policy.zip``.
            seed: Of the noise.
            noise_s: Its correlation time; 0 for white noise.

        Raises:
            InputError: If there is none.
        """
        agent = read_agent(path)
        self.policy = policy_of(agent, where=str(path))
        self._actor: Any = agent.actor
        self._rng = np.random.default_rng(seed)
        self._kept = math.exp(-CONTROL_S / noise_s) if noise_s > 0 else 0.0
        self._noise: NDArray[np.float64] | None = None

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """New noise for the robots that begin anew."""
        fresh = self._rng.standard_normal((len(mask), len(self.policy.low)))
        self._noise = fresh if self._noise is None else np.where(mask[:, None], fresh, self._noise)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """An action of its distribution, in rad."""
        if self._noise is None or len(self._noise) != len(observation):
            self._noise = None
            self.reset(np.ones(len(observation), dtype=bool))
        assert self._noise is not None
        with torch.no_grad():
            seen = torch.as_tensor(observation)
            mean, log_std, _ = self._actor.get_action_dist_params(seen)
        drawn = np.tanh(mean.numpy() + np.exp(log_std.numpy()) * self._noise)
        fresh = self._rng.standard_normal(self._noise.shape)
        self._noise = self._kept * self._noise + math.sqrt(1 - self._kept**2) * fresh
        low, high = self.policy.low, self.policy.high
        return np.asarray(low + (drawn + 1) / 2 * (high - low), dtype=np.float32)
