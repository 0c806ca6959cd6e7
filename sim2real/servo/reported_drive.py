"""The controller of a servo that reports its drive, as a duty cycle or pulse width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array


@dataclass(frozen=True)
class ReportedDrive:
    """Controller that the reported drive shows: ``drive = gain (u(t - latency) - q - lead v)``.

    Attributes:
        per_rad: Gain, as a share of the full drive per radian.
        latency_s: Latency of the set-point u, s.
        lead_s: Derivative time of the controller, s; 0 for a proportional controller.
        period_s: Sampling period: a sample's columns may be read at times this far apart.
    """

    per_rad: float
    latency_s: float
    lead_s: float
    period_s: float


def reported_drive(
    t: Array,
    command: Array,
    position: Array,
    load: Array,
    sample_delay_s: float = 0.0,
    *,
    fewest: int = 50,
    saturated: float = 0.95,
    rounding: float = 0.01,
    unexplained: float = 0.02,
) -> ReportedDrive | None:
    """The controller, if the reported load is the drive.

    The load counts as the drive, as a share of the full drive, if it is between -1 and 1 and
    proportional to the control error until it saturates; a measured torque or current is not.
    Gain, latency and derivative time then follow by least squares from the samples below the limit,
    to first order in the latency. The prior of both times is 0 with a sampling period as standard
    deviation, which decides where one frequency alone cannot tell them from the gain.

    Args:
        t: Times in s, shape (T,).
        command: Set-points in rad, shape (T,).
        position: Measured angles in rad, shape (T,), NaN where missing.
        load: Reported load, shape (T,), NaN where missing.
        sample_delay_s: Time from ``t`` to the sampling of angles and loads, s.
        fewest: Smallest number of samples.
        saturated: Drive from which it counts as saturated.
        rounding: Excess over the full drive that counts as rounding.
        unexplained: Largest share of the drive's power that the error does not explain.
    """
    error = command - position
    valid = np.isfinite(error) & np.isfinite(load)
    if np.count_nonzero(valid) < fewest or np.abs(load[valid]).max() > 1 + rounding:
        return None
    t, command, position, error, drive = (x[valid] for x in (t, command, position, error, load))
    unsaturated = (np.abs(drive) < saturated) & (np.abs(error) > 0)
    if np.count_nonzero(unsaturated) < fewest:
        return None
    slope = float(error[unsaturated] @ drive[unsaturated] / np.sum(error[unsaturated] ** 2))
    residual = drive - np.clip(slope * error, -1.0, 1.0)
    power = float(np.sum(drive**2))
    if slope <= 0 or power == 0 or np.sum(residual**2) > unexplained * power:
        return None
    period = float(np.median(np.diff(t)))
    terms = np.stack([error, np.gradient(command, t), np.gradient(position, t)], axis=1)
    noise = np.sqrt(np.mean(residual[unsaturated] ** 2))
    # u(t + delay - latency) has the coefficient gain (delay - latency) of the command's rate
    prior = np.array([[-sample_delay_s, 1.0, 0.0], [0.0, 0.0, 1.0]]) * noise / (slope * period)
    matrix = np.concatenate([terms[unsaturated], prior])
    target = np.concatenate([drive[unsaturated], np.zeros(len(prior))])
    gain, *rates = np.linalg.lstsq(matrix, target, rcond=None)[0]
    sooner, lead = (float(-rate / gain) for rate in rates)
    latency = max(sooner + sample_delay_s, 0.0)
    return ReportedDrive(float(gain), latency, max(lead, 0.0), period)
