"""A trained policy as a controller at 50 Hz, with NumPy only."""

from __future__ import annotations

import numpy as np

from rl.deploy.forward import Policy, forward
from rl.observer import Observer
from sim2real.arrays import Array32, Mask


class PolicyController:
    """The mean action of a policy, with the observer of its training; robots are asynchronous.

    Attributes:
        policy: The policy.
    """

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._start(0)

    def _start(self, n: int) -> None:
        self._observer = Observer(self.policy.view, self.policy.low, self.policy.high, n)
        self._since = np.zeros(n, dtype=np.int64)
        self._fresh = np.ones(n, dtype=bool)

    def reset(self, mask: Mask) -> None:
        """Reset the robots in ``mask``, shape (E,)."""
        if len(mask) != len(self._fresh):
            self._start(len(mask))
        self._fresh = self._fresh | mask

    def act(self, observation: Array32, gone: int = 1) -> Array32:
        """Set-points in rad of this control period, shape (E, J).

        Args:
            observation: The task's columns, shape (E, O).
            gone: Control periods since the last call; more than one if frames were lost.
        """
        if len(observation) != len(self._fresh):
            self._start(len(observation))
        clipped = np.asarray(observation, dtype=np.float32)
        limit = self.policy.observation_limit
        clipped = np.clip(clipped, -limit, limit)
        if self._fresh.any():
            self._observer.begin(clipped, self._fresh)
        period = self.policy.view.period
        self._since = np.where(self._fresh, 0, self._since + gone)
        due = self._fresh | (self._since >= period)
        self._since %= period
        self._fresh = np.zeros_like(self._fresh)
        if due.any():
            inputs = self._observer.observe(clipped, due)
            self._observer.decide(self.decided(inputs), due)
        tick = self._since[:, None].astype(np.float32)
        return np.asarray(self._observer.set_points(tick), dtype=np.float32)

    def decided(self, inputs: Array32) -> Array32:
        """Decisions between -1 and 1 from the policy's columns (E, F)."""
        return forward(self.policy, inputs)
