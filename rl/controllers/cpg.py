"""A central pattern generator of coupled phase oscillators, one per joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rl.observer import CONTROL_S
from sim2real.arrays import Array, Mask

SETTLE_PER_S = 12.0
"""Rate at which amplitudes and offsets approach their goals: 90 % in 0.32 s."""
COUPLING_PER_S = 5.0
"""Weight of the coupling between neighbours."""


@dataclass(frozen=True)
class Gait:
    """A travelling wave along the body; each value a number or an array (E,)."""

    frequency_hz: ArrayLike  # beats per second
    amplitude_rad: ArrayLike  # amplitude of the last joint
    front: ArrayLike = 0.5  # amplitude of the first joint relative to the last; linear in between
    lag_rad: ArrayLike = 1.2  # phase lag of a joint relative to the previous one
    # mean angle of every joint; for negative values the robot turns left
    offset_rad: ArrayLike = 0.0


class Gliding:
    """Values that approach their goals without overshoot: critically damped, second order."""

    def __init__(self, value: Array) -> None:
        self.value, self.rate = value, np.zeros_like(value)

    def step(self, goal: Array) -> Array:
        """Advance by a control period, exact for a constant goal; returns the value."""
        error = self.value - goal
        push = self.rate + SETTLE_PER_S * error
        fade = np.exp(-SETTLE_PER_S * CONTROL_S)
        self.value = goal + (error + push * CONTROL_S) * fade
        self.rate = (self.rate - SETTLE_PER_S * push * CONTROL_S) * fade
        return self.value


class CentralPatternGenerator:
    """Oscillators of E robots with J joints each, which start straight and at rest.

    The model of Ijspeert and Crespi (ICRA 2007, "Online trajectory generation in an amphibious
    snake robot using a lamprey-like central pattern generator model"): phases coupled to their
    neighbours, amplitudes and offsets of second order, both critically damped::

        phase_i'  = 2 pi f + w sum_j sin(phase_j - phase_i - lag_ij)
        angle_i   = offset_i + amplitude_i sin(phase_i)

    Their output is ``r (1 + cos phase)``; here it is symmetric about the offset.
    """

    def __init__(self, limits_rad: ArrayLike, n_envs: int) -> None:
        self.limits_rad = np.asarray(limits_rad, dtype=np.float64)  # shape (J, 2)
        self.phase = np.zeros((n_envs, len(self.limits_rad)))  # rad
        self._wave = Gliding(np.zeros((2, *self.phase.shape)))  # amplitudes, offsets
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(
        self,
        observation: NDArray[np.floating],
        phase: ArrayLike = 0.0,
        mask: Mask | Literal[True] = True,
    ) -> None:
        """Reset robots in ``mask`` (E,) to the angles of an observation, with ``phase`` in rad."""
        mask = np.broadcast_to(mask, self._fresh.shape)
        self._fresh |= mask
        self.phase[:, 0] = np.where(mask, phase, self.phase[:, 0])
        angle = np.asarray(observation[:, 3 : 3 + len(self.limits_rad)], dtype=np.float64)
        start = np.stack([np.zeros_like(angle), angle])
        self._wave.value = np.where(mask[:, None], start, self._wave.value)
        self._wave.rate = np.where(mask[:, None], 0.0, self._wave.rate)

    def step(self, gait: Gait) -> Array:
        """Advance by a period towards ``gait``; joint angles in rad (E, J), within limits."""
        n_envs, J = self.phase.shape
        values = (gait.frequency_hz, gait.amplitude_rad, gait.front, gait.lag_rad, gait.offset_rad)
        frequency, amplitude, front, lag, offset = (
            np.broadcast_to(np.asarray(x, dtype=np.float64), (n_envs,))[:, None] for x in values
        )
        locked = self.phase[:, :1] - lag * np.arange(J)
        self.phase = np.where(self._fresh[:, None], locked, self.phase)
        self._fresh[:] = False
        lead = np.sin(self.phase[:, 1:] - self.phase[:, :-1] + lag)
        pull = np.zeros_like(self.phase)
        pull[:, :-1] += lead
        pull[:, 1:] -= lead
        turn = 2 * np.pi * frequency + COUPLING_PER_S * pull
        self.phase = np.mod(self.phase + CONTROL_S * turn, 2 * np.pi)
        position = np.linspace(0.0, 1.0, J) if J > 1 else np.ones(1)
        size = amplitude * (front + (1.0 - front) * position)
        height, middle = self._wave.step(np.stack([size, np.broadcast_to(offset, size.shape)]))
        return np.asarray(np.clip(middle + height * np.sin(self.phase), *self.limits_rad.T))
