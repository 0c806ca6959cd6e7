"""Motion of an arm's joints: angles, speeds and accelerations at evenly spaced times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.recording import Recording

STEP_S = 0.002
"""Time between the values of a motion."""


@dataclass(frozen=True)
class ArmMotion:
    """Angles of J joints at evenly spaced times.

    Attributes:
        start_s: Time of the first values.
        angle: Angles in rad, shape (K, J).
        step_s: Time between values.
    """

    start_s: float
    angle: Array
    step_s: float = STEP_S

    @property
    def t(self) -> Array:
        """Times in s, shape (K,)."""
        return np.asarray(self.start_s + self.step_s * np.arange(len(self.angle)))

    @property
    def velocity(self) -> Array:
        """Speeds in rad/s by central differences, shape (K, J)."""
        return np.asarray(np.gradient(self.angle, self.step_s, axis=0))

    @property
    def acceleration(self) -> Array:
        """Accelerations in rad/s2 by second differences, 0 at the ends, shape (K, J).

        Their integral between two times is the change of speed, also across a jump.
        """
        out = np.zeros_like(self.angle)
        out[1:-1] = np.diff(self.angle, 2, axis=0) / self.step_s**2
        return out


def grid(t: Array, step_s: float = STEP_S) -> Array:
    """Evenly spaced times from the first of ``t`` to its last or just beyond, at least two."""
    count = max(2, int(np.ceil((t[-1] - t[0]) / step_s - 1e-9)) + 1)
    return np.asarray(t[0] + step_s * np.arange(count))


def measured_motion(
    recording: Recording, names: Sequence[str], rest: Array, *, cutoff_hz: float = 10.0
) -> ArmMotion:
    """Motion of joints from measured angles alone, smoothed without phase shift.

    Args:
        recording: The recording.
        names: Names of the J joints.
        rest: Angles in rad of joints that were not recorded, shape (J,).
        cutoff_hz: Cut-off frequency of the smoothing.
    """
    t = grid(recording.t)
    angle = np.tile(rest, (t.size, 1))
    for j, name in enumerate(names):
        if name in recording.joints:
            measured = recording.position[:, recording.joints.index(name)]
            angle[:, j] = _interpolated(t, recording.t, measured, rest[j])
    return ArmMotion(float(t[0]), low_pass(angle, STEP_S, cutoff_hz))


def corrected_motion(
    predicted: ArmMotion, recording: Recording, names: Sequence[str], *, cutoff_hz: float = 4.0
) -> ArmMotion:
    """A predicted motion, corrected by its slow error against the measured angles.

    The prediction supplies the accelerations of fast motion, which differences of sampled and noisy
    angles do not resolve.

    Args:
        predicted: Predicted motion of the J joints.
        recording: The recording.
        names: Names of the joints.
        cutoff_hz: Cut-off frequency of the error.
    """
    t, error = predicted.t, np.zeros_like(predicted.angle)
    for j, name in enumerate(names):
        if name in recording.joints:
            measured = recording.position[:, recording.joints.index(name)]
            at_samples = np.interp(recording.t, t, predicted.angle[:, j])
            error[:, j] = _interpolated(t, recording.t, measured - at_samples, 0.0)
    corrected = predicted.angle + low_pass(error, predicted.step_s, cutoff_hz)
    return ArmMotion(predicted.start_s, corrected, predicted.step_s)


def low_pass(values: Array, step_s: float, cutoff_hz: float, *, order: int = 4) -> Array:
    """Values (K, J) filtered forwards and backwards by a Butterworth filter; constant beyond."""
    from scipy.signal import butter, sosfiltfilt  # takes half a second to load

    filtered = butter(order, cutoff_hz, fs=1 / step_s, output="sos")
    ends = min(len(values) - 1, int(2 / (cutoff_hz * step_s)))
    return np.asarray(sosfiltfilt(filtered, values, axis=0, padtype="constant", padlen=ends))


def _interpolated(t: Array, samples: Array, values: Array, otherwise: float) -> Array:
    """Values at times ``t`` by a cubic spline through those present; constant beyond the ends."""
    from scipy.interpolate import CubicSpline  # slow to load

    present = np.isfinite(values)
    if present.sum() < 2:
        return np.full(t.size, float(values[present][0]) if present.any() else otherwise)
    first, last = samples[present][[0, -1]]
    spline = CubicSpline(samples[present], values[present])
    return np.asarray(spline(np.clip(t, first, last)))
