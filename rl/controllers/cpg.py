"""A central pattern generator of coupled phase oscillators, one per joint."""

from __future__ import annotations

from dataclasses import dataclass

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
    """A travelling wave along the body; each value a number or an array (E,).

    Attributes:
        frequency_hz: Beats per second.
        amplitude_rad: Amplitude of the last joint.
        front: Amplitude of the first joint relative to the last; linear in between.
        lag_rad: Phase lag of a joint relative to the previous one.
        offset_rad: Mean angle of every joint; for negative values the robot turns left.
    """

    frequency_hz: ArrayLike
    amplitude_rad: ArrayLike
    front: ArrayLike = 0.5
    lag_rad: ArrayLike = 1.2
    offset_rad: ArrayLike = 0.0


class Gliding:
    """Values (E, J) that approach their goals without overshoot: critically damped, second order.

    Attributes:
        value, rate: Values and their rates of change, 1/s.
    """

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

    Attributes:
        limits_rad: Lowest and highest angle of each joint, shape (J, 2).
        phase: Shape (E, J), in rad.
    """

    def __init__(self, limits_rad: ArrayLike, n_envs: int) -> None:
        self.limits_rad = np.asarray(limits_rad, dtype=np.float64)
        shape = (n_envs, len(self.limits_rad))
        self.phase = np.zeros(shape)
        self._amplitude, self._offset = Gliding(np.zeros(shape)), Gliding(np.zeros(shape))
        self._fresh = np.ones(n_envs, dtype=bool)
        self._start = np.zeros(n_envs)

    def reset(self, mask: Mask, observation: NDArray[np.floating], phase: ArrayLike = 0.0) -> None:
        """Reset the robots in ``mask`` (E,) to their present angles.

        Args:
            mask: Robots to reset, shape (E,).
            observation: The task's columns, shape (E, O).
            phase: Initial phase of the first joint in rad, a number or shape (E,).
        """
        self._fresh |= mask
        self._start = np.where(mask, phase, self._start)
        angle = observation[:, 3 : 3 + len(self.limits_rad)]
        for part, value in ((self._amplitude, 0.0), (self._offset, angle)):
            part.value = np.where(mask[:, None], value, part.value)
            part.rate = np.where(mask[:, None], 0.0, part.rate)

    def first_phase(self) -> Array:
        """Phase of the first joints in rad, shape (E,)."""
        return np.where(self._fresh, self._start, self.phase[:, 0])

    def step(self, gait: Gait) -> Array:
        """Advance by a control period towards ``gait``.

        Returns:
            Joint angles in rad, shape (E, J), clipped to the joint limits.
        """
        n_envs, J = self.phase.shape
        lag = _column(gait.lag_rad, n_envs)
        locked = self._start[:, None] - lag * np.arange(J)
        self.phase[self._fresh] = locked[self._fresh]
        self._fresh[:] = False
        lead = np.sin(self.phase[:, 1:] - self.phase[:, :-1] + lag)
        pull = np.zeros_like(self.phase)
        pull[:, :-1] += lead
        pull[:, 1:] -= lead
        turn = 2 * np.pi * _column(gait.frequency_hz, n_envs) + COUPLING_PER_S * pull
        self.phase = np.mod(self.phase + CONTROL_S * turn, 2 * np.pi)
        goal = np.broadcast_to(_column(gait.offset_rad, n_envs), self.phase.shape)
        position = np.linspace(0.0, 1.0, J) if J > 1 else np.ones(1)
        front = _column(gait.front, n_envs)
        size = _column(gait.amplitude_rad, n_envs) * (front + (1.0 - front) * position)
        wave = self._amplitude.step(size) * np.sin(self.phase)
        return np.clip(self._offset.step(goal) + wave, *self.limits_rad.T)


def _column(value: ArrayLike, n_envs: int) -> Array:
    """A number or an array (E,) as a column (E, 1)."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (n_envs,))[:, None]
