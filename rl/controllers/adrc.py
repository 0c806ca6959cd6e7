"""Active disturbance rejection control of the heading, guided by proportional navigation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rl.controllers.cpg import CentralPatternGenerator
from rl.controllers.guidance import LineOfSight
from rl.controllers.stroke import Stroke, begin
from rl.controllers.tuned import tuned
from rl.task import CONTROL_S
from sim2real.arrays import Array, Array32, Mask


@dataclass(frozen=True)
class ADRCGains(Stroke):
    """Gains; each a number or an array (E,).

    Attributes:
        navigation: Rate of the desired heading relative to that of the line of sight.
        memory_s: Time constant with which the resulting lead decays, in s.
        agility_rad_s2: Largest angular acceleration of the transient profile.
        bandwidth_rad_s: Bandwidth of the closed loop of the heading.
        observer_rad_s: Bandwidth of the extended state observer.
        effect_per_s2: Angular acceleration per rad of bend.
    """

    navigation: ArrayLike
    memory_s: ArrayLike
    agility_rad_s2: ArrayLike
    bandwidth_rad_s: ArrayLike
    observer_rad_s: ArrayLike
    effect_per_s2: ArrayLike


def fhan(error: Array, rate: Array, limit: ArrayLike, h: float) -> Array:
    """Time-optimal acceleration that brings ``error`` and ``rate`` to zero, in steps of ``h``.

    Han's function of that name (IEEE Trans. Ind. Electron. 56 (2009) 900, section on the
    tracking differentiator), with magnitude up to ``limit``.
    """
    r = np.asarray(limit, dtype=np.float64)
    d = r * h * h
    a0 = h * rate
    y = error + a0
    a1 = np.sqrt(d * (d + 8 * np.abs(y)))
    a2 = a0 + np.sign(y) * (a1 - d) / 2
    a = np.where(np.abs(y) < d, a0 + y, a2)
    return np.asarray(np.where(np.abs(a) < d, -r * a / d, -r * np.sign(a)))


class TransientProfile:
    """Han's tracking differentiator, which approaches a goal with bounded acceleration.

    Attributes:
        value, rate: The profile and its slope, shape (E,).
    """

    def __init__(self, n_envs: int, limit: ArrayLike, *, dt: float) -> None:
        """``limit`` is the largest acceleration, a number or an array (E,)."""
        self.value, self.rate = np.zeros(n_envs), np.zeros(n_envs)
        self._limit, self._dt = limit, dt

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew from zero."""
        self.value[mask] = self.rate[mask] = 0.0

    def update(self, goal: Array) -> None:
        """Advance by a period towards ``goal``, shape (E,)."""
        push = fhan(self.value - goal, self.rate, self._limit, self._dt)
        self.value = self.value + self._dt * self.rate
        self.rate = self.rate + self._dt * push


class ExtendedStateObserver:
    """Linear observer of ``y'' = disturbance + effect u``, with the disturbance as third state.

    Gains 3 w, 3 w^2, w^3 put all three poles at -w (Gao, "Scaling and bandwidth-parameterization
    based controller tuning", ACC 2003).

    Attributes:
        state: Estimates of y, y' and the disturbance a period after the last measurement, (E, 3).
    """

    def __init__(
        self, n_envs: int, bandwidth_rad_s: ArrayLike, effect: ArrayLike, *, dt: float
    ) -> None:
        """Start at zero; ``bandwidth_rad_s`` times ``dt`` must be below 1."""
        w = np.broadcast_to(np.asarray(bandwidth_rad_s, dtype=np.float64), (n_envs,))
        self._gain = np.stack([3 * w, 3 * w**2, w**3], axis=1)
        self._effect, self._dt = np.asarray(effect, dtype=np.float64), dt
        self.state = np.zeros((n_envs, 3))

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew from zero."""
        self.state[mask] = 0.0

    def update(self, y: Array, u: Array) -> None:
        """Update with a measurement and the input applied until then, each of shape (E,)."""
        z = self.state
        slope = np.stack([z[:, 1], z[:, 2] + self._effect * u, np.zeros_like(u)], axis=1)
        self.state = z + self._dt * (slope + self._gain * (y - z[:, 0])[:, None])


class DisturbanceRejection:
    """The controller "Li et al." of the paper: ADRC of the heading with proportional navigation.

    The components are those of Li et al. (Bioinspir. Biomim. 14, 2019):
    proportional navigation gives the desired heading, a tracking differentiator smooths it, an
    extended state observer estimates heading, yaw rate and disturbance, and the feedback
    compensates the disturbance; its output is the offset of a central pattern generator.
    The equations are those of Han and Gao, the gains are tuned here.

    Proportional navigation turns the desired heading N times as fast as the line of sight. Its
    integral is the line of sight plus a lead, which decays here so that past turns are forgotten;
    N = 1 is pure pursuit::

        desired = line_of_sight + lead,   lead' = (N - 1) line_of_sight' - lead / memory_s

    Headings are integrals of the yaw rate since the start. Their drift cancels: the line of sight
    is heading plus bearing.

    Attributes:
        gains: Gains.
        observer: Observer of heading, yaw rate and disturbance.
    """

    def __init__(
        self,
        limits_rad: ArrayLike,
        n_envs: int = 1,
        gains: ADRCGains | None = None,
        *,
        dt: float = CONTROL_S,
    ) -> None:
        """Arguments as for ``CentralPatternGenerator``; default: the tuned ``gains``."""
        self.gains = g = tuned("adrc", ADRCGains) if gains is None else gains
        self._generator = CentralPatternGenerator(limits_rad, n_envs, dt=dt)
        self._sight = LineOfSight(n_envs, 0.0, dt=dt)
        self._profile = TransientProfile(n_envs, g.agility_rad_s2, dt=dt)
        self.observer = ExtendedStateObserver(n_envs, g.observer_rad_s, g.effect_per_s2, dt=dt)
        self._dt = dt
        self._heading, self._lead, self._turn = (np.zeros(n_envs) for _ in range(3))
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask
        for part in (self._sight, self._profile, self.observer):
            part.reset(mask)
        for signal in (self._heading, self._lead, self._turn):
            signal[mask] = 0.0

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        gains, sight = self.gains, self._sight
        sight.update(observation)
        if self._fresh.any():
            begin(self._generator, self._fresh, sight.bearing > 0, observation)
        yaw_rate = np.asarray(observation[:, 2], dtype=np.float64)
        self._heading = self._heading + np.where(self._fresh, 0.0, self._dt * yaw_rate)
        self._fresh[:] = False
        fade = self._lead / np.asarray(gains.memory_s)
        gained = (np.asarray(gains.navigation) - 1.0) * sight.rate
        self._lead = self._lead + self._dt * (gained - fade)
        self._profile.update(self._heading + sight.bearing + self._lead)
        self.observer.update(self._heading, self._turn)
        self._turn = self._feedback()
        return self._generator.step(gains.bent(self._turn)).astype(np.float32)

    def _feedback(self) -> Array:
        """The bend by linear ADRC: poles at the bandwidth, disturbance compensated."""
        w = np.asarray(self.gains.bandwidth_rad_s, dtype=np.float64)
        heading, rate, disturbance = self.observer.state.T
        push = w**2 * (self._profile.value - heading) + 2 * w * (self._profile.rate - rate)
        largest = np.asarray(self.gains.bend_rad, dtype=np.float64)
        bend = (push - disturbance) / np.asarray(self.gains.effect_per_s2, dtype=np.float64)
        return np.asarray(np.clip(bend, -largest, largest))
