"""Latency of each recording or window, and the distribution of latencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array
from sim2real.identification.priors import gains, scale_inertia
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import fit
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.inference.variance_components import grid_quantiles
from sim2real.model import JointModel, Model
from sim2real.posterior.servo import loaded
from sim2real.ranges.sources import labelled
from sim2real.recording import Recording
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace, traces

_LAW_SD_S = 2e-4
"""Smallest standard deviation of a latency, due to errors of the servo's law."""


def episode_latencies(
    traces: Sequence[Trace],
    joint: JointModel,
    *,
    gain_sd: float = 0.02,
    latency_sd_s: float = 0.05,
    rounds: int = 3,
) -> tuple[Array, Array]:
    """Latency of each trace of a joint and its standard deviation in s, each of shape (N,).

    Latency and damping are not distinguishable in the response to a sine. Gains are therefore
    shared by the traces and fitted together with one latency per trace, in ``rounds``: a fit of
    gains and a common latency, and a Gauss-Newton step of all. The standard deviation includes the
    gains of one episode about the shared ones, by a share ``gain_sd``. A prior of
    ``latency_sd_s`` about the common latency keeps that of a trace that hardly moves. The search
    starts from the joint's model, whose effects are fixed.
    """
    row = joint_row(joint, traces[0].load)
    own = np.zeros(len(traces))  # latency of each beyond the common one
    for _ in range(rounds):
        shifted = [
            replace(trace, sample_delay_s=trace.sample_delay_s - later)
            for trace, later in zip(traces, own, strict=True)
        ]
        problem = ServoProblem(shifted, row, gains(scale_inertia(traces, row)))
        best = fit(problem, row[None], rounds=2)
        row, unit = best.row, problem.unit
        loose = np.append(unit[:2] / gain_sd, unit[2] / latency_sd_s) ** 2
        normal = np.diag([0.0, 0.0, *np.full(own.size, loose[2])])
        slope = np.array([0.0, 0.0, *own / unit[2] * loose[2]])
        sd = np.empty(own.size)
        parts = zip(best.residuals, problem.by_trace(best.slopes), strict=True)
        for k, (error, slopes) in enumerate(parts):
            weight = 1 / (1 + (error / (OUTLIER_SD * best.scale_rad)) ** 2) ** 0.5
            weight /= best.scale_rad**2 * correlation_samples(error)
            curvature = slopes.T @ (slopes * weight[:, None])
            place = [0, 1, 2 + k]
            normal[np.ix_(place, place)] += curvature
            slope[place] += slopes.T @ (weight * error)
            sd[k] = np.linalg.inv(curvature + np.diag(loose))[2, 2] ** 0.5 * unit[2]
        own -= np.linalg.lstsq(normal, slope)[0][2:] * unit[2]
    return float(row[2]) + own, sd


@dataclass(frozen=True)
class Spread:
    """Estimate of the uniform distribution of latencies."""

    centre: float  # centre in s
    half_width: float  # half-width in s
    half_width_90: tuple[float, float]  # 90 % interval of the half-width in s


def spread(seconds: Array, sd: Array, *, smallest_s: float = 1e-4) -> Spread:
    """Posterior of uniformly distributed latencies with errors ``sd``, in s, shape (E,) both.

    Medians of centre and half-width, above ``smallest_s``, under a prior that is flat in the centre
    and in the logarithm of the half-width.
    """
    reach = float(np.ptp(seconds)) + 3 * float(np.median(sd)) + 10 * smallest_s
    half = np.geomspace(smallest_s, 3 * reach, 160)
    middle = 0.5 * float(seconds.max() + seconds.min())
    centre = middle + np.linspace(-1.0, 1.0, 201) * reach
    log_density = np.zeros((half.size, centre.size))  # the prior is uniform on the grid
    for value, error in zip(seconds, np.maximum(sd, _LAW_SD_S), strict=True):
        above = ndtr((centre[None] + half[:, None] - value) / error)
        below = ndtr((centre[None] - half[:, None] - value) / error)
        log_density += np.log(np.maximum(above - below, 1e-300)) - np.log(2 * half[:, None])
    weight = np.exp(log_density - log_density.max())
    low, median, high = grid_quantiles(half, weight.sum(axis=1))
    _, best, _ = grid_quantiles(centre, weight.sum(axis=0))
    return Spread(best, median, (low, high))


@dataclass(frozen=True)
class Latencies:
    """Latency of the commands of each episode."""

    episodes: Sequence[str]  # description of each episode: a recording, or a window of one
    seconds: Array  # latency that all joints share in s, shape (E,)
    sd: Array  # its standard deviations in s, shape (E,)
    # deviation of each joint in s, and its standard deviation
    offset: Mapping[str, tuple[float, float]]
    windows: bool  # whether episodes are windows
    dropped: int  # number of fits that were too uncertain to be used
    spread: Spread  # distribution of the latencies


def latencies(
    recordings: Sequence[Recording], model: Model, *, enough: int = 5, largest_sd_s: float = 0.01
) -> Latencies | None:
    """Fit the latency of every episode; None where no joint of the model moves.

    Gains are shared by all episodes of a joint with the same load and medium. Below ``enough``
    recordings windows of them count as episodes. Latencies with a standard deviation above
    ``largest_sd_s`` are not used.
    """
    labels = labelled(recordings)
    episodes = [
        (recording, labels[recording.file], joint, loaded(trace, model.joints[joint]))
        for recording in recordings
        for joint in model.joints
        for trace in traces([recording], joint)
    ]
    windows = len({name for _, name, _, _ in episodes}) < enough
    if windows:
        episodes = [
            (r, n, j, part) for r, name, j, trace in episodes for n, part in _windows(name, trace)
        ]
    if not episodes:
        return None
    conditions = [(joint, r.kind, r.medium, trace.load) for r, _, joint, trace in episodes]
    value, sd = np.empty(len(episodes)), np.empty(len(episodes))
    for condition in set(conditions):
        alike = [k for k, one in enumerate(conditions) if one == condition]
        of_joint = model.joints[condition[0]]
        value[alike], sd[alike] = episode_latencies([episodes[k][3] for k in alike], of_joint)
    used = sd < largest_sd_s
    if not used.any():
        return None
    kept = [(n, j) for (_, n, j, _), good in zip(episodes, used, strict=True) if good]
    return _combined(kept, value[used], sd[used], windows, int(np.sum(~used)))


def _windows(
    name: str, whole: Trace, *, length_s: float = 6.0, fewest: int = 100
) -> list[tuple[str, Trace]]:
    """Windows of one recording, simulated from its start but scored separately."""
    windows = []
    for start in np.arange(whole.t[0], whole.t[-1], length_s):
        within = (whole.t >= start) & (whole.t < start + length_s)
        inside = whole.used & within
        if inside.sum() >= fewest and np.ptp(whole.command[within]) > 0:
            windows.append((f"{name} from {start:.0f} s", replace(whole, used=inside)))
    return windows


def _combined(
    kept: Sequence[tuple[str, str]], value: Array, sd: Array, windows: bool, dropped: int
) -> Latencies:
    """Split latencies into a part common to an episode's joints and one for each, of sum 0.

    Weighted least squares; errors are increased to match the residual, if that is larger.
    """
    episodes = list(dict.fromkeys(name for name, _ in kept))
    joints = list(dict.fromkeys(joint for _, joint in kept))
    E, J = len(episodes), len(joints)
    design = np.zeros((len(kept), E + J))
    for k, (name, joint) in enumerate(kept):
        design[k, episodes.index(name)] = 1.0
        design[k, E + joints.index(joint)] = 1.0
    weight = 1 / np.maximum(sd, _LAW_SD_S)
    tie = np.concatenate([np.zeros(E), np.full(J, weight.max() * 1e3)])
    matrix = np.vstack([design * weight[:, None], tie])
    target = np.append(value * weight, 0.0)
    covariance = np.linalg.pinv(matrix.T @ matrix)
    answer = covariance @ matrix.T @ target
    freedom = len(kept) - E - J + 1
    residual = float(np.sum((matrix @ answer - target) ** 2))
    inflated = np.sqrt(np.diag(covariance) * max(residual / freedom if freedom > 0 else 1.0, 1.0))
    offset = {j: (float(answer[E + k]), float(inflated[E + k])) for k, j in enumerate(joints)}
    common, sd = answer[:E], inflated[:E]
    return Latencies(episodes, common, sd, offset, windows, dropped, spread(common, sd))
