"""Random commands of all joints of a swim, within the limits of the joints, at rest at both ends.

A swim consists of parts: travelling waves of random frequency, amplitude, phase lag and bias (the
gaits of a fish: Videler, Fish Swimming, Chapman and Hall, 1993) and square waves. Their ranges are
those of the swims on which the error of the twin was measured (``law_error``): outside of them,
with beats above 1.5 Hz, joints that move independently or long glides, residuals were 1.5 times as
large, and both of two effects were found less often after designed swims than after usual ones
(``reports/design/swims.md``). The search that varies these commands may leave the ranges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits


@dataclass(frozen=True)
class SwimLimits:
    """Limits of the commands of a swim.

    Attributes:
        joints: Those of each of J joints, of equal periods.
    """

    joints: tuple[CommandLimits, ...]

    @property
    def period_s(self) -> float:
        """Time between set-points, s."""
        return self.joints[0].period_s

    @property
    def rest_s(self) -> float:
        """Time at rest at either end, s."""
        return self.joints[0].rest_s

    @property
    def rest_rad(self) -> Array:
        """Set-points at rest, rad, shape (J,)."""
        return np.array([joint.rest_rad for joint in self.joints])

    @property
    def reach_rad(self) -> Array:
        """Largest distances of the set-points from rest, rad, shape (J,)."""
        return np.array([joint.reach_rad for joint in self.joints])

    def within(self, commands: Array) -> Array:
        """Set-points (N, T, J) changed as little as needed to keep the limits of each joint."""
        pairs = zip(np.moveaxis(commands, 2, 0), self.joints, strict=True)
        return np.stack([joint.within(command) for command, joint in pairs], axis=2)


def draw(rng: np.random.Generator, count: int, limits: SwimLimits, seconds: float) -> Array:
    """Random commands of a swim within the limits, shape (N, T, J).

    Args:
        rng: Random number generator.
        count: Number N of commands.
        limits: The limits.
        seconds: Duration, s.
    """
    t, joints = limits.joints[0].times(seconds), len(limits.joints)
    shapes = np.array([_swim(rng, t, joints) for _ in range(count)])
    return limits.within(limits.rest_rad + limits.reach_rad * shapes)


def _swim(rng: np.random.Generator, t: Array, joints: int, *, most: int = 6) -> Array:
    """Up to ``most`` parts of random lengths, relative to the reach of the joints, (T, J)."""
    cuts = np.sort(rng.integers(1, t.size, int(rng.integers(0, most))))
    out = np.zeros((t.size, joints))
    for part in np.split(np.arange(t.size), cuts):
        if part.size > 1:
            gait = _GAITS[int(rng.choice(len(_GAITS), p=_SHARES))]
            out[part] = gait(rng, t[part] - t[part[0]], joints)
    return out


def wave(
    rng: np.random.Generator,
    t: Array,
    joints: int,
    *,
    hertz: tuple[float, float] = (0.7, 1.4),
    amplitude: tuple[float, float] = (0.45, 0.85),
    first: tuple[float, float] = (0.4, 0.5),
    lag_rad: tuple[float, float] = (0.9, 1.3),
    most_bias: float = 0.38,
    ramp_s: float = 0.8,
) -> Array:
    """A wave that travels to the tail about a random bias, which turns the robot, shape (T, J).

    Args:
        rng: Random number generator.
        t: Times in s, shape (T,).
        joints: Number J of joints.
        hertz: Range of the frequencies, Hz.
        amplitude: Range of the last joint's amplitude, relative to its reach.
        first: Range of the first joint's amplitude, relative to the last joint's.
        lag_rad: Range of the phase lags from joint to joint, rad.
        most_bias: Largest bias, relative to the reach.
        ramp_s: Time in which the amplitude grows, s.
    """
    beat, size = np.exp(rng.uniform(*np.log([hertz, amplitude]).T))
    sizes = size * np.linspace(rng.uniform(*first), 1.0, joints)
    lags = rng.uniform(*lag_rad) * np.arange(joints)
    phase = 2 * np.pi * (beat * t[:, None] + rng.random()) - lags
    bias = rng.choice([0.0, most_bias * rng.uniform(-1.0, 1.0)])
    ramp = np.clip(t / ramp_s, 0.0, 1.0)[:, None]
    return np.asarray(ramp * (sizes * np.sin(phase) + bias))


def square(rng: np.random.Generator, t: Array, joints: int) -> Array:
    """A square wave of some joints together, shape (T, J)."""
    level = rng.uniform(0.3, 0.6) * np.sign(np.sin(2 * np.pi * rng.uniform(0.4, 0.7) * t))
    return np.asarray(level[:, None] * (rng.random(joints) < 0.7))


def usual(limits: SwimLimits, seconds: float) -> Array:
    """Swims that any robot can make, after the rest at the start, shape (5, T, J).

    Slow and strong strokes, quick and weak ones, a circle, strokes before coasting, and squares.
    """
    t = limits.joints[0].times(seconds) - limits.rest_s
    joints = len(limits.joints)
    swims = [
        _strokes(t.clip(0), joints, 0.7, 1.1),
        _strokes(t.clip(0), joints, 1.5, 0.5),
        _strokes(t.clip(0), joints, 1.0, 0.9, turn=0.25),
        _strokes(t.clip(0), joints, 1.2, 1.0, until_s=6.0),
        np.tile(0.4 * np.sign(np.sin(np.pi * t.clip(0)))[:, None], (1, joints)),
    ]
    return np.where(t[:, None] < 0, 0.0, swims)


def _strokes(
    t: Array, joints: int, hertz: float, size: float, *, turn: float = 0.0, until_s: float = 12.0
) -> Array:
    """A wave of all joints about a bias, rad, shape (T, J)."""
    sizes, lags = size * np.linspace(0.28, 0.6, joints), 1.1 * np.arange(joints)
    ramp = np.clip(t / 0.8, 0, 1)[:, None] * (t[:, None] < until_s)
    sent = ramp * (sizes * np.sin(2 * np.pi * hertz * t[:, None] - lags) + turn)
    return np.asarray(np.clip(sent, -0.76, 0.76))


_GAITS = (wave, square)
_SHARES = (0.8, 0.2)
"""Gaits of parts of a swim, and how often each is drawn."""
