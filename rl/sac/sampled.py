"""A trained policy with sampled actions, as in training."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.deploy.controller import PolicyController
from rl.deploy.export import policy_of, set_price
from rl.sac.sac import read_agent
from rl.sac.settings import Settings
from sim2real.arrays import Array32, Mask


class SampledController(PolicyController):
    """Samples the distribution of the actor, with noise correlated in time as in training."""

    def __init__(
        self,
        path: Path | str,
        seed: int = 0,
        noise_s: float = Settings.noise_s,
        price: float | None = None,
    ) -> None:
        """Read an agent.

        Args:
            path: ``policy.zip``.
            seed: Seed of the noise.
            noise_s: Correlation time of the noise; 0 for white noise.
            price: Price of energy relative to that of the training; default: that of the file.

        Raises:
            InputError: If there is no agent, or it was not trained for this price.
        """
        agent = read_agent(path)
        if price is not None:
            set_price(agent, price, where=str(path))
        super().__init__(policy_of(agent, where=str(path)))
        self._actor: Any = agent.actor
        self._rng = np.random.default_rng(seed)
        self._decay = math.exp(-self.policy.view.decision_s / noise_s) if noise_s > 0 else 0.0
        self._noise = np.empty((0, len(self.policy.low)))

    def reset(self, mask: Mask) -> None:
        """Draw new noise for the robots that are reset."""
        super().reset(mask)
        fresh = self._rng.standard_normal((len(mask), len(self.policy.low)))
        same_size = len(self._noise) == len(mask)
        self._noise = np.where(mask[:, None], fresh, self._noise) if same_size else fresh

    def decided(self, inputs: Array32) -> Array32:
        """Sample actions."""
        if len(self._noise) != len(inputs):
            self._noise = self._rng.standard_normal((len(inputs), len(self.policy.low)))
        with torch.no_grad():
            mean, log_std, _ = self._actor.get_action_dist_params(torch.as_tensor(inputs))
        drawn = np.tanh(mean.numpy() + np.exp(log_std.numpy()) * self._noise)
        fresh = self._rng.standard_normal(self._noise.shape)
        self._noise = self._decay * self._noise + math.sqrt(1 - self._decay**2) * fresh
        return np.asarray(drawn, dtype=np.float32)
