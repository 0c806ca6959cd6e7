"""The servo linearised about its motion: responses to torques and set-points, and their inverse.

I q'' + kd q' + (kp + gravity) q = kp u + torque, the pendulum linearised about the mean set-point.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from sim2real.arrays import Array
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT, ROTOR_INERTIA
from sim2real.servo.rollout import longest_substep, rollout_on
from sim2real.servo.trace import Trace

_APART = 0.03
_DRIFT = COLUMNS.index("clock_drift.s_per_s")


def residual_torque(
    t: Array, residual: Array, servo: tuple[float, float, float], noise_rad: float
) -> tuple[Array, Array]:
    """Torque in N m to add to the model so that it follows the measurement, and its sd, both (T,).

    ``-(inertia r'' + kd r' + stiffness r)``, r the simulated minus measured angle in rad (T,), NaN
    where none was measured, smoothed by cubic polynomials over 0.18 s: Savitzky, Golay, Analytical
    Chemistry 36 (1964) 1627-1639. ``servo``: inertia in kg m2, kd in N m s/rad, and stiffness (kp
    and the weight's) in N m/rad; ``noise_rad``: standard deviation of the measurement noise.
    """
    step, degree = float(np.median(np.diff(t))), 3
    half = max(2, round(0.18 / step / 2))
    length = int(min(2 * half + 1, t.size - 1 + t.size % 2))
    grid = t[0] + step * np.arange(int(round((t[-1] - t[0]) / step)) + 1)
    measured = np.isfinite(residual)
    resampled = np.interp(grid, t[measured], residual[measured])
    torque: Array = np.zeros(grid.size)
    taps: Array = np.zeros(length)
    for order, weight in zip((2, 1, 0), servo, strict=True):
        torque -= weight * savgol_filter(resampled, length, degree, deriv=order, delta=step)
        taps += weight * savgol_coeffs(length, degree, deriv=order, delta=step)
    sd = noise_rad * float(np.sqrt(np.sum(taps**2)))
    return np.interp(t, grid, torque), np.full(t.size, sd)


@dataclass(frozen=True)
class Residual:
    """Residual of the fit of a servo, for one joint in one recording."""

    trace: Trace
    residual: Array  # simulated minus measured angle in rad, shape (T,); arbitrary where not used
    kp: float  # fitted gains in N m/rad and N m s/rad, and latency
    kd: float
    latency_s: float
    drift_s_per_s: float = 0.0  # by which the latency grows with time

    @property
    def arrival_s(self) -> Array:
        """Time from each row to the effect of its set-point on the sampled angles, shape (T,)."""
        elapsed = self.trace.t - self.trace.t[0]
        return np.asarray(self.latency_s - self.trace.sample_delay_s + self.drift_s_per_s * elapsed)


@dataclass(frozen=True)
class Modes:
    """A second-order system, gain / ((s - fast) (s - slow)), with distinct poles."""

    fast: complex
    slow: complex
    gain: float


def gain_derivatives(residual: Residual) -> Array:
    """Derivatives (T, 3) of the angle in rad by the latency in s and the logarithms of kd, kp.

    Central differences of simulations, by 0.1 ms and by a thousandth of the gains.
    """
    latency_s, share = 1e-4, 1e-3
    servo = np.array([residual.kp, residual.kd, residual.latency_s])
    sides = np.concatenate([side * np.eye(3)[[2, 1, 0]] for side in (-1, 1)])
    rows = np.zeros((6, len(COLUMNS)))
    rows[:, _DRIFT] = residual.drift_s_per_s
    rows[:, :3] = servo + sides * (share * servo[0], share * servo[1], latency_s)
    longest = longest_substep(rows, np.full(6, residual.trace.load.inertia_kgm2)).min()
    low, high = np.split(rollout_on(residual.trace, rows, substep_s=float(longest)), 2)
    return np.asarray(((high - low) / (2 * np.array([[latency_s], [share], [share]]))).T)


def servo_modes(residual: Residual) -> Modes:
    """Poles and gain of the linearised servo."""
    kp, load = residual.kp, residual.trace.load
    weight = load.gravity_Nm * float(np.cos(np.mean(residual.trace.command)))
    stiffness = max(kp + weight, 1e-3 * kp) / load.inertia_kgm2
    half = residual.kd / (2 * load.inertia_kgm2)
    root = complex(half**2 - stiffness) ** 0.5
    if abs(root) < _APART * half:
        root = complex(_APART * half)
    return Modes(-half - root, -half + root, kp / load.inertia_kgm2)


def ringing_rad_s(traces: Sequence[Trace], row: Array) -> float:
    """Frequency of the damped oscillation of a servo (P,) in rad/s, the largest of its recordings.

    0 where it does not oscillate. With kp, kd and the inertia I it is sqrt(kp/I - (kd/2I)^2), the
    imaginary part of the poles of I s^2 + kd s + kp.
    """
    largest = 0.0
    for trace in traces:
        inertia = trace.load.inertia_kgm2 + float(row[INERTIA_LEFT_OUT] + row[ROTOR_INERTIA])
        kp, kd = float(row[0]) * trace.gain_factor, float(row[1])
        largest = max(largest, kp / inertia - (kd / (2 * inertia)) ** 2)
    return float(np.sqrt(largest))


def fastest_visible_rad_s(traces: Sequence[Trace]) -> float:
    """Half the sampling rate in rad/s, the largest of the recordings: pi / period."""
    return float(np.pi / min(trace.period_s for trace in traces))
