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
from sim2real.design.limits import within as joint_within


@dataclass(frozen=True)
class SwimLimits:
    """Limits of the commands of a swim."""

    joints: tuple[CommandLimits, ...]  # those of each of J joints, of equal periods

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


def within(commands: Array, limits: SwimLimits) -> Array:
    """Set-points (N, T, J) changed as little as needed to keep the limits of each joint."""
    pairs = zip(np.moveaxis(commands, 2, 0), limits.joints, strict=True)
    return np.stack([joint_within(command, joint) for command, joint in pairs], axis=2)


def draw(rng: np.random.Generator, count: int, limits: SwimLimits, seconds: float) -> Array:
    """Random commands of a swim within the limits, shape (N, T, J)."""
    t, joints = limits.joints[0].times(seconds), len(limits.joints)
    shapes = np.array([_swim(rng, t, joints) for _ in range(count)])
    return within(limits.rest_rad + limits.reach_rad * shapes, limits)


def _swim(rng: np.random.Generator, t: Array, joints: int, *, most: int = 6) -> Array:
    """Up to ``most`` parts of random lengths, relative to the reach of the joints, (T, J)."""
    cuts = np.sort(rng.integers(1, t.size, int(rng.integers(0, most))))
    out = np.zeros((t.size, joints))
    for part in np.split(np.arange(t.size), cuts):
        if part.size > 1:
            gait = _square if rng.random() < 0.2 else _wave
            out[part] = gait(rng, t[part] - t[part[0]], joints)
    return out


def _wave(rng: np.random.Generator, t: Array, joints: int) -> Array:
    """A wave that travels to the tail about a random bias, which turns the robot, shape (T, J)."""
    hertz, size = np.exp(rng.uniform(*np.log([(0.7, 1.4), (0.45, 0.85)]).T))
    sizes = size * np.linspace(rng.uniform(0.4, 0.5), 1.0, joints)
    lags = rng.uniform(0.9, 1.3) * np.arange(joints)
    phase = 2 * np.pi * (hertz * t[:, None] + rng.random()) - lags
    bias = rng.choice([0.0, 0.38 * rng.uniform(-1.0, 1.0)])
    ramp = np.clip(t / 0.8, 0.0, 1.0)[:, None]
    return np.asarray(ramp * (sizes * np.sin(phase) + bias))


def _square(rng: np.random.Generator, t: Array, joints: int) -> Array:
    """A square wave of some joints together, shape (T, J)."""
    level = rng.uniform(0.3, 0.6) * np.sign(np.sin(2 * np.pi * rng.uniform(0.4, 0.7) * t))
    return np.asarray(level[:, None] * (rng.random(joints) < 0.7))


def usual(limits: SwimLimits, seconds: float) -> Array:
    """Swims that any robot can make, after the rest at the start, shape (5, T, J).

    Slow and strong strokes, quick and weak ones, a circle, strokes before coasting, and squares.
    """
    t = limits.joints[0].times(seconds)[:, None] - limits.rest_s
    place = np.arange(len(limits.joints))
    shape = np.linspace(0.28, 0.6, place.size)
    swims = []
    for hertz, size, turn, until_s in (
        (0.7, 1.1, 0.0, 12.0), (1.5, 0.5, 0.0, 12.0), (1.0, 0.9, 0.25, 12.0), (1.2, 1.0, 0.0, 6.0)
    ):  # fmt: skip
        wave = size * shape * np.sin(2 * np.pi * hertz * t - 1.1 * place) + turn
        swims.append(np.clip(np.clip(t / 0.8, 0, 1) * (t < until_s) * wave, -0.76, 0.76))
    swims.append(np.tile(0.4 * np.sign(np.sin(np.pi * t)), (1, place.size)))
    return np.where(t < 0, 0.0, swims)
