"""Latency of each recording or window, and the distribution of latencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array, Index
from sim2real.identification.servo_problem import Fits, Servos, minimise, plain_servos
from sim2real.model import JointModel, Model
from sim2real.posterior.servo import loaded
from sim2real.ranges.sources import labelled
from sim2real.recording import Recording
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace, traces

_LAW_SD_S = 2e-4
"""Smallest standard deviation of a latency, due to errors of the servo's law."""


def episode_latencies(
    traces: Sequence[Trace],
    joints: Sequence[JointModel],
    group: Index,
    *,
    gain_sd: float = 0.02,
    iterations: int = 30,
    rounds: int = 3,
) -> tuple[Array, Array]:
    """Latency of each trace and its standard deviation in s, each of shape (N,).

    Latency and damping are not distinguishable in the response to a sine. Gains are therefore
    shared by the traces of a group and fitted together with one latency per trace, by Gauss-Newton
    steps from which the latencies are eliminated (Golub and Pereyra, SIAM Journal on Numerical
    Analysis 10 (1973) 413-432).

    Args:
        traces: The traces.
        joints: Models of their joints, from which the search starts; effects are fixed.
        group: Index of the group of each trace that shares gains, shape (N,).
        gain_sd: Relative standard deviation of the gains of one episode about the shared gains,
            which the error of a latency includes.
        iterations: Largest number of iterations of a fit.
        rounds: Number of steps of the shared gains.
    """
    batch = Batch([[trace] for trace in traces])
    rows = np.array([joint_row(joint, x.load) for x, joint in zip(traces, joints, strict=True)])
    inertia = np.array([trace.load.inertia_kgm2 for trace in traces])
    servos = plain_servos(np.arange(len(traces)), rows, inertia, batch.period)
    single_fits = minimise(batch, servos, iterations=iterations)
    gains = _pooled(single_fits, _weights(single_fits, batch.lags), group)
    for _ in range(rounds):
        fits = _with_gains(batch, servos, single_fits, gains, iterations)
        change = _step(_weights(fits, batch.lags), group, gains / servos.unit[:, :2])
        gains = gains * (1 + change)
    fits = _with_gains(batch, servos, single_fits, gains, iterations)
    sd = _errors(fits, _weights(fits, batch.lags)[1], gain_sd)
    return fits.servos.theta[:, 2], sd * servos.unit[:, 2]


def _with_gains(batch: Batch, servos: Servos, start: Fits, gains: Array, iterations: int) -> Fits:
    """Latencies fitted with fixed gains (N, 2), and the curvature by all three parameters."""
    x = start.servos.values()
    x[:, :2] = gains / servos.unit[:, :2]
    fixed = servos.at(x)
    free = {name: getattr(fixed, name)[:, 2:] for name in ("columns", "unit", "low", "high")}
    latency_fits = minimise(batch, replace(fixed, **free), iterations=iterations)
    x[:, 2] = latency_fits.servos.values()[:, 0]
    return minimise(batch, servos.at(x), iterations=1)


def _weights(fits: Fits, lags: int) -> tuple[Array, Array]:
    """Gradient (N, 3) and curvature (N, 3, 3) of minus the log-likelihood, in natural units."""
    gram = fits.gram.sum(axis=1)
    variance = gram[:, 0, 0] / np.maximum(fits.count - lags, 1)
    ridge = 1e-9 * np.einsum("nff->n", gram[:, 1:, 1:])[:, None, None] * np.eye(3)
    curvature = (gram[:, 1:, 1:] + ridge) / variance[:, None, None] + 1e-30 * np.eye(3)
    return gram[:, 1:, 0] / variance[:, None], curvature


def _eliminated(weights: tuple[Array, Array]) -> tuple[Array, Array]:
    """Gradient (N, 2) and curvature (N, 2, 2) by the gains, with latencies eliminated."""
    slope, curvature = weights
    cross = curvature[:, :2, 2] / curvature[:, 2, 2][:, None]
    inner = curvature[:, :2, :2] - cross[:, :, None] * curvature[:, None, 2, :2]
    return slope[:, :2] - cross * slope[:, 2:], inner


def _pooled(fits: Fits, weights: tuple[Array, Array], group: Index) -> Array:
    """Gains (N, 2) of the group of each trace: means of single fits, weighted by precision."""
    _, inner = _eliminated(weights)
    value, unit = fits.servos.values()[:, :2], fits.servos.unit[:, :2]
    out = np.empty_like(value)
    for g in np.unique(group):
        members = group == g
        weighted = np.einsum("nij,nj->i", inner[members], value[members])
        out[members] = np.linalg.lstsq(inner[members].sum(axis=0), weighted)[0]
    return np.asarray(np.maximum(out, 1e-3) * unit)


def _step(
    weights: tuple[Array, Array], group: Index, gains: Array, *, largest: float = 0.5
) -> Array:
    """Relative change of the gains, shape (N, 2), by one Gauss-Newton step of each group."""
    slope, inner = _eliminated(weights)
    out = np.empty_like(slope)
    for g in np.unique(group):
        members = group == g
        change = np.linalg.lstsq(inner[members].sum(axis=0), -slope[members].sum(axis=0))[0]
        out[members] = change / gains[members]
    return np.clip(out, -largest, largest)


def _errors(fits: Fits, curvature: Array, gain_sd: float) -> Array:
    """Standard deviation of each latency in units."""
    penalised = curvature.copy()
    gains = np.maximum(fits.servos.values()[:, :2], 1e-9)
    penalised[:, [0, 1], [0, 1]] += 1 / (gain_sd * gains) ** 2
    return np.asarray(np.sqrt(np.linalg.inv(penalised)[:, 2, 2]))


@dataclass(frozen=True)
class Spread:
    """Estimate of the uniform distribution of latencies.

    Attributes:
        centre: Centre in s.
        half_width: Half-width in s.
        half_width_90: 90 % interval of the half-width in s.
    """

    centre: float
    half_width: float
    half_width_90: tuple[float, float]


def spread(seconds: Array, sd: Array, *, smallest_s: float = 1e-4) -> Spread:
    """Estimate the uniform distribution of latencies with known standard deviations.

    Posterior medians of centre and half-width, on a grid, under a prior that is flat in the centre
    and in the logarithm of the half-width. The likelihood of each latency is the uniform density
    convolved with its error, so that errors of the fit do not increase the width.

    Args:
        seconds: Latencies in s, shape (E,).
        sd: Their standard deviations in s, shape (E,).
        smallest_s: Smallest half-width that is resolved, s.
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
    low, median, high = _quantiles(half, weight.sum(axis=1), (0.05, 0.5, 0.95))
    (best,) = _quantiles(centre, weight.sum(axis=0), (0.5,))
    return Spread(best, median, (low, high))


def _quantiles(grid: Array, weight: Array, shares: Sequence[float]) -> list[float]:
    total = np.cumsum(weight)
    return [float(np.interp(share, (total - 0.5 * weight) / total[-1], grid)) for share in shares]


@dataclass(frozen=True)
class Latencies:
    """Latency of the commands of each episode.

    Attributes:
        episodes: Description of each episode: a recording, or a window of one.
        seconds: Latency that all joints share in s, shape (E,).
        sd: Its standard deviations in s, shape (E,).
        offset: Deviation of each joint in s, and its standard deviation.
        windows: Whether episodes are windows.
        dropped: Number of fits that were too uncertain to be used.
    """

    episodes: Sequence[str]
    seconds: Array
    sd: Array
    offset: Mapping[str, tuple[float, float]]
    windows: bool
    dropped: int


def latencies(
    recordings: Sequence[Recording], model: Model, *, enough: int = 5, largest_sd_s: float = 0.01
) -> Latencies | None:
    """Fit the latency of every episode; None where no joint of the model moves.

    Gains are fitted as well and shared by all episodes of a joint with the same load and medium, as
    they differ between water and bench. Effects are those of the model.

    Args:
        recordings: Recordings of any kind with commands and measured angles.
        model: The fitted servos.
        enough: Number of recordings below which windows of them count as episodes, as latency may
            drift within a recording.
        largest_sd_s: Largest standard deviation of a latency that is used, s.
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
    group = np.array([conditions.index(condition) for condition in conditions])
    models = [model.joints[joint] for _, _, joint, _ in episodes]
    value, sd = episode_latencies([x for *_, x in episodes], models, group)
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
    """Split latencies into a part that all joints of an episode share and one for each joint.

    Weighted least squares for latency = episode + joint, where the parts of the joints sum to 0;
    errors are increased to match the residual of this fit, if that is larger.
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
    return Latencies(episodes, answer[:E], inflated[:E], offset, windows, dropped)
