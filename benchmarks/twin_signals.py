"""The swims that the twin is fitted to and judged by: waves, turns, sines, squares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array

Signal = Callable[[float], Array]

SECONDS = 10.0
_SIZE, _LAG = np.array([0.30, 0.45, 0.60]), 1.2 * np.arange(3)
_MOST = 0.78


def wave(hertz: float, scale: float, bias: float = 0.0, lag: float = 1.0) -> Signal:
    """A travelling wave about a bend."""
    return lambda t: np.clip(
        min(1.0, t)
        * (scale * _SIZE * np.sin(2 * np.pi * hertz * t - lag * _LAG) + bias * np.ones(3)),
        -_MOST,
        _MOST,
    )


def sine(hertz: float, size: float) -> Signal:
    """The same sine in all joints."""
    return lambda t: np.full(3, size * np.sin(2 * np.pi * hertz * t))


def square(hertz: float, size: float) -> Signal:
    """The same square in all joints, as in the paper."""
    return lambda t: np.full(3, size * np.sign(np.sin(2 * np.pi * hertz * t)))


def rests(moving: Signal, start: float, end: float) -> Signal:
    """A signal that fades to straight joints between two times, in half a second each way."""

    def fading(t: float) -> Array:
        out = np.clip((t - start) / 0.5, 0, 1) * np.clip((end - t) / 0.5, 0, 1)
        return np.asarray((1 - out) * moving(t))

    return fading


SIGNALS: dict[str, Signal] = {
    "wave 1 Hz": wave(1.0, 1.0),
    "wave 1.5 Hz": wave(1.5, 0.8),
    "wave 0.75 Hz": wave(0.75, 1.2),
    "weak wave": wave(1.0, 0.6),
    "left turn": wave(1.2, 0.7, 0.3),
    "square 0.5 Hz": square(0.5, 0.52),
    "long wave": wave(1.2, 0.9, 0.0, 0.5),
    "right turn": wave(1.5, 0.8, -0.4),
    "wave 1.75 Hz": wave(1.75, 0.7),
    "wave 2.25 Hz": wave(2.25, 0.5),
    "slow wave": wave(0.5, 1.3),
    "strong wave": wave(1.0, 1.25),
    "short wave": wave(1.2, 0.9, 0.0, 1.4),
    "sine 0.8 Hz, all joints": sine(0.8, 0.4),
    "sine 1.3 Hz, all joints": sine(1.3, 0.45),
    "tight left turn": wave(1.0, 0.8, 0.4),
    "slight right turn": wave(1.3, 0.9, -0.15),
    "wave that rests": rests(wave(1.2, 0.9), 4.0, 7.0),
    "sine 1 Hz, all joints": sine(1.0, 0.52),
    "wave 1.25 Hz": wave(1.25, 0.9),
    "gentle turn": wave(1.0, 1.0, 0.2),
    "wave 2 Hz": wave(2.0, 0.6),
    "longer wave 0.9 Hz": wave(0.9, 1.1, 0.0, 0.75),
    "right turn 1.1 Hz": wave(1.1, 0.9, -0.25),
}
HELD_OUT = tuple(SIGNALS)[18:]
"""Swims that the fit does not see: other waves, turns and sines than those before them."""
UNSTEADY = ("square 0.5 Hz", "wave that rests")
"""Swims that are no steady waves; the bar is on the others."""


def set_points(names: list[str]) -> Array:
    """Set-points in rad of the swims that are named, shape (signals, T, 3)."""
    times = CONTROL_S * np.arange(round(SECONDS / CONTROL_S))
    return np.array([[SIGNALS[name](t) for t in times] for name in names])
