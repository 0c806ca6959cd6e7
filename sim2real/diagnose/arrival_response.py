"""What the angle of a plain servo does when single set-points come late or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SETTLED = 0.003
"""Share of a response that may be left where it is cut off."""
LONGEST = 80
"""Samples after which a response is cut off at the latest."""
EARLIEST_S = 0.04
"""Most that a set-point's response is followed ahead of the latency."""
LARGEST_MOVE = np.array([0.01, 0.5, 0.5])
"""Largest change of latency in s and of the logarithms of kd and kp at a time."""
_FORGOTTEN, _MOST = 1e-4, 500
_LEAST_RATE = 0.1
_APART = 0.03
"""Least distance of the two poles, relative to their size."""


@dataclass(frozen=True)
class Residual:
    """What the fit of a plain servo leaves of one joint in one recording.

    Attributes:
        t: Times in s, shape (T,), increasing.
        command: Set-points in rad, sent at ``t``, shape (T,).
        used: Samples that may be seen, shape (T,).
        residual: Simulated minus measured angle in rad, shape (T,); anything where not used.
        kp: Fitted proportional gain in N m/rad.
        kd: Fitted derivative gain in N m s/rad.
        latency_s: Fitted latency.
        inertia_kgm2: Inertia on the shaft.
        gravity_Nm: Torque of the load's weight when held level.
    """

    t: Array
    command: Array
    used: NDArray[np.bool_]
    residual: Array
    kp: float
    kd: float
    latency_s: float
    inertia_kgm2: float
    gravity_Nm: float = 0.0

    def moved(self, refit: Array) -> Residual:
        """The residual of a servo with another latency, kd and kp.

        Args:
            refit: Change of the latency in s and of the logarithms of kd and kp, shape (3,); at
                most a step that can be trusted is made.
        """
        late, kd, kp = np.clip(refit, -LARGEST_MOVE, LARGEST_MOVE)
        after = replace(
            self,
            latency_s=max(self.latency_s + float(late), 0.0),
            kd=self.kd * float(np.exp(kd)),
            kp=self.kp * float(np.exp(kp)),
        )
        return replace(after, residual=self.residual + _simulated(after) - _simulated(self))


@dataclass(frozen=True)
class Modes:
    """A second-order system, gain / ((s - fast) (s - slow)).

    Attributes:
        fast: One pole in 1/s.
        slow: The other, kept a little apart.
        gain: In 1/s2.
    """

    fast: complex
    slow: complex
    gain: float

    def lasting(self, share: float) -> float:
        """Time in s after which at most about a ``share`` of a response is left."""
        rate = min(-self.slow.real, -self.fast.real)
        return float(-np.log(share) / max(rate, _LEAST_RATE))

    def impulse(self, x: Array) -> Array:
        """Response to an impulse ``x`` s ago, 0 before it."""
        _, a, b = self._decays(x)
        return np.asarray(self.gain * ((a - b) / (self.fast - self.slow)).real)

    def step(self, x: Array) -> Array:
        """Response to a step ``x`` s ago: the integral of ``impulse``."""
        p, r = self.fast, self.slow
        _, a, b = self._decays(x)
        return np.asarray(self.gain * ((1 + (r * a - p * b) / (p - r)) / (p * r)).real)

    def twice(self, x: Array) -> tuple[Array, Array]:
        """Inverse Laplace transform of 1 / ((s - fast) (s - slow))2 at ``x``, and its derivative.

        By partial fractions with two double poles.
        """
        p, r = self.fast, self.slow
        y, a, b = self._decays(x)
        value = y * (a + b) - 2 * (a - b) / (p - r)
        slope = (a + b) + y * (p * a + r * b) - 2 * (p * a - r * b) / (p - r)
        size = (p - r) ** 2
        return np.asarray((value / size).real), np.asarray((slope / size).real * (x > 0))

    def _decays(self, x: Array) -> tuple[Array, Any, Any]:
        """Positive part of ``x``, and what is left of the fast and the slow mode then."""
        y = np.maximum(x, 0.0)
        if self.fast.imag == 0:
            return y, np.exp(self.fast.real * y), np.exp(self.slow.real * y)
        a = np.exp(self.fast * y)
        return y, a, a.conj()


@dataclass(frozen=True)
class Response:
    """Responses of one angle to single set-points.

    All tables have one row a set-point; column m of row k is sample ``k + first + m``.

    Attributes:
        first: Samples from a set-point to the first that it can move.
        late: Simulated minus measured angle per s that a set-point is late, in rad/s, shape (K, W).
        missing: Simulated minus measured angle per rad by which the set-point in force, from this
            one to the next, is below the one sent, shape (K, W).
        change: Set-points minus those before them in rad, shape (K,).
        refit: Change of the angle in rad with the latency in s and with the logarithms of kd and
            kp, shape (T, 3).
        period_s: Usual time between set-points.
        modes: The joint.
        since: Time since a set-point arrived in s; negative before, shape (K, W).
    """

    first: int
    late: Array
    missing: Array
    change: Array
    refit: Array
    period_s: float
    modes: Modes
    since: Array

    def late_by(self, delay: Array) -> tuple[Array, Array]:
        """What delays of any size do: simulated minus measured angle, and its derivative.

        Args:
            delay: Of each set-point in s, shape (K,).

        Returns:
            Angles in rad, shape (T,), and a table like ``late``.
        """
        change, then = self.change[:, None], self.since - delay[:, None]
        gap = (self._on_time - self.modes.step(then)) * change
        return spread(gap, self.first), self.modes.impulse(then) * change

    @cached_property
    def _on_time(self) -> Array:
        return self.modes.step(self.since)

    @property
    def speed(self) -> Array:
        """Size of the angle's rate in rad/s, shape (T,)."""
        return np.abs(self.refit[:, 0])


def spread(rows: Array, first: int) -> Array:
    """Sum of a table (K, W) over its set-points, by sample, shape (K,)."""
    K, W = rows.shape
    total = np.zeros(K + first + W)
    for m in range(W):
        total[first + m : first + m + K] += rows[:, m]
    return total[:K]


def response(given: Residual) -> Response:
    """The exact responses of I q'' + kd q' + (kp + gravity) q = kp u, at the true times.

    From the transfer function kp / (I s2 + kd s + kp + gravity), the pendulum linearised about the
    mean set-point. A late set-point is taken to first order in its delay.
    """
    modes = _modes(given)
    t, K = given.t, given.t.size
    period = float(np.median(np.diff(t)))
    change = np.diff(given.command, prepend=given.command[0])
    arrival = t + given.latency_s
    seen = arrival <= t[-1]
    offset = (np.searchsorted(t, arrival) - np.arange(K))[seen]
    first = int(offset.min()) if offset.size else 0
    first -= min(first, int(np.ceil(EARLIEST_S / period)))
    lasting = modes.lasting(SETTLED) + period + EARLIEST_S
    W = int(np.clip(np.ceil(lasting / period), 2, LONGEST))
    sample = np.arange(K)[:, None] + first + np.arange(W)
    since = np.where(sample < K, t[np.minimum(sample, K - 1)] - arrival[:, None], -1.0)
    slot = np.append(np.diff(t), period)[:, None]
    late = modes.impulse(since) * change[:, None]
    missing = modes.step(since) - modes.step(since - slot)
    kd, kp = _gains(given, modes, since, change[:, None])
    refit = np.stack([-spread(late, first), spread(kd, first), spread(kp, first)], axis=1)
    return Response(first, late, missing, change, refit, period, modes, since)


def _modes(given: Residual) -> Modes:
    weight = given.gravity_Nm * float(np.cos(np.mean(given.command)))
    stiffness = max(given.kp + weight, 1e-3 * given.kp) / given.inertia_kgm2
    half = given.kd / (2 * given.inertia_kgm2)
    root = complex(half**2 - stiffness) ** 0.5
    if abs(root) < _APART * half:
        root = complex(_APART * half)
    return Modes(-half - root, -half + root, given.kp / given.inertia_kgm2)


def _simulated(given: Residual) -> Array:
    """Angle of the linear servo in rad, from rest on its first set-point, shape (T,)."""
    modes, t, u = _modes(given), given.t, given.command
    period = float(np.median(np.diff(t)))
    lasting = modes.lasting(_FORGOTTEN) + given.latency_s
    W = int(np.ceil(min(lasting / period, _MOST))) + 1
    older = np.arange(t.size)[:, None] - np.arange(W)
    sent = np.maximum(older, 0)
    change = np.diff(u, prepend=u[0])[sent] * (older > 0)
    moved = np.sum(modes.step(t[:, None] - t[sent] - given.latency_s) * change, axis=1)
    settled = modes.gain / (modes.fast * modes.slow).real
    return np.asarray(settled * u[np.maximum(older[:, -1] - 1, 0)] + moved)


def _gains(given: Residual, modes: Modes, since: Array, change: Array) -> tuple[Array, Array]:
    """What each set-point adds to the last two columns of ``Response.refit``, each (K, W).

    The change of the weight's torque with kp is left out.
    """
    inertia, kp, kd = given.inertia_kgm2, given.kp, given.kd
    twice, rate = (x * change / inertia**2 for x in modes.twice(since))
    return -kp * kd * twice, kp * (inertia * rate + kd * twice)
