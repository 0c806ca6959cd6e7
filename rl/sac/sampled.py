"""A trained policy that acts as it learned: with noise of the size that it chose itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rl.deploy.controller import PolicyController
from rl.deploy.export import policy_of, read_agent, set_price
from rl.sac.agents import Settings


class SampledController(PolicyController):
    """Samples the actor's own distribution, its noise correlated in time as in training."""

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
            seed: Of the noise.
            noise_s: Its correlation time; 0 for white noise.
            price: What energy costs it, over the training's own; that of the file where None.

        Raises:
            InputError: If there is none, or it did not learn for this price.
        """
        agent = read_agent(path)
        if price is not None:
            set_price(agent, price, where=str(path))
        super().__init__(policy_of(agent, where=str(path)))
        self._actor: Any = agent.actor
        self._rng = np.random.default_rng(seed)
        self._kept = math.exp(-self.policy.view.decision_s / noise_s) if noise_s > 0 else 0.0
        self._noise = np.empty((0, len(self.policy.low)))

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """New noise for the robots that begin anew."""
        super().reset(mask)
        fresh = self._rng.standard_normal((len(mask), len(self.policy.low)))
        same = len(self._noise) == len(mask)
        self._noise = np.where(mask[:, None], fresh, self._noise) if same else fresh

    def decided(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """An action of its distribution."""
        if len(self._noise) != len(inputs):
            self._noise = self._rng.standard_normal((len(inputs), len(self.policy.low)))
        with torch.no_grad():
            mean, log_std, _ = self._actor.get_action_dist_params(torch.as_tensor(inputs))
        drawn = np.tanh(mean.numpy() + np.exp(log_std.numpy()) * self._noise)
        fresh = self._rng.standard_normal(self._noise.shape)
        self._noise = self._kept * self._noise + math.sqrt(1 - self._kept**2) * fresh
        return np.asarray(drawn, dtype=np.float32)
