"""How late commands take effect, episode by episode, and how far that varies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sim2real.identification.servo_problem import Fits, Servos, minimise, plain_servos
from sim2real.model import JointModel, Model
from sim2real.posterior.likelihood import loaded
from sim2real.ranges.episodes import labelled
from sim2real.recording import Recording
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace, traces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LatencySettings:
    """How latencies are fitted, and which of them count.

    Attributes:
        gain_sd: How far the gains of one episode may be from those shared, as a share of them.
        iterations: Iterations of a fit.
        rounds: Steps of the shared gains.
        largest_change: Largest change of a gain by one step, as a share of it.
        smallest_spread_s: Half-widths below it are all one: a tenth of a millisecond.
        law_sd_s: Standard deviation that no law of a servo gets better than.
        enough_recordings: With fewer recordings, windows of them count as episodes: latency may
            drift within one.
        window_s: Length of such a window.
        least_samples: Samples of a window that are worth a fit of three parameters and their noise.
        largest_sd_s: A latency less sure than this says nothing of a spread.
    """

    gain_sd: float = 0.02
    iterations: int = 30
    rounds: int = 3
    largest_change: float = 0.5
    smallest_spread_s: float = 1e-4
    law_sd_s: float = 2e-4
    enough_recordings: int = 5
    window_s: float = 6.0
    least_samples: int = 100
    largest_sd_s: float = 0.01


LATENCY_SETTINGS = LatencySettings()
"""The defaults."""


def episode_latencies(
    given: Sequence[Trace],
    joints: Sequence[JointModel],
    group: NDArray[np.intp],
    *,
    settings: LatencySettings = LATENCY_SETTINGS,
) -> tuple[Array, Array]:
    """Latency of each trace and its standard deviation in s, each of shape (N,).

    A sine alone cannot tell latency from damping. So gains are shared by the traces of a group, and
    found together with a latency each, by Gauss-Newton steps from which the latencies are
    eliminated (Golub and Pereyra, SIAM Journal on Numerical Analysis 10 (1973) 413-432). What
    ``gain_sd`` of freedom in the gains would do to each latency counts into its error.

    Args:
        given: The traces.
        joints: The model of each one's joint, where the search starts; its effects stay.
        group: Which traces share gains, shape (N,), from 0 on.
        settings: Settings of the fit.
    """
    batch = Batch([[one] for one in given])
    rows = np.array([joint_row(joint, one.load) for one, joint in zip(given, joints, strict=True)])
    inertia = np.array([one.load.inertia_kgm2 for one in given])
    servos = plain_servos(np.arange(len(given)), rows, inertia, batch.period)
    alone = minimise(batch, servos, iterations=settings.iterations)
    gains = _pooled(alone, _weights(alone, batch.lags), group)
    for _ in range(settings.rounds):
        fits = _with_gains(batch, servos, alone, gains, settings=settings)
        gains = gains * (
            1
            + _step(
                fits,
                _weights(fits, batch.lags),
                group,
                gains / servos.unit[:, :2],
                settings=settings,
            )
        )
    fits = _with_gains(batch, servos, alone, gains, settings=settings)
    return fits.servos.theta[:, 2], _errors(
        fits, _weights(fits, batch.lags), settings=settings
    ) * servos.unit[:, 2]


def _with_gains(
    batch: Batch, servos: Servos, start: Fits, gains: Array, *, settings: LatencySettings
) -> Fits:
    """Latencies fitted under given gains (N, 2), and there the curvature by all three."""
    x = start.servos.values()
    x[:, :2] = gains / servos.unit[:, :2]
    held = servos.at(x)
    only = Servos(
        held.joint, held.theta, held.columns[:, 2:], held.unit[:, 2:], held.low[:, 2:],
        held.high[:, 2:],
    )  # fmt: skip
    late = minimise(batch, only, iterations=settings.iterations)
    x[:, 2] = late.servos.values()[:, 0]
    return minimise(batch, servos.at(x), iterations=1)


def _weights(fits: Fits, lags: int) -> tuple[Array, Array]:
    """Gradient (N, 3) and curvature (N, 3, 3) of minus the log-likelihood, in units."""
    gram = fits.gram.sum(axis=1)
    variance = gram[:, 0, 0] / np.maximum(fits.count - lags, 1)
    ridge = 1e-9 * np.einsum("nff->n", gram[:, 1:, 1:])[:, None, None] * np.eye(3)
    curvature = (gram[:, 1:, 1:] + ridge) / variance[:, None, None] + 1e-30 * np.eye(3)
    return gram[:, 1:, 0] / variance[:, None], curvature


def _eliminated(weights: tuple[Array, Array]) -> tuple[Array, Array]:
    """Gradient (N, 2) and curvature (N, 2, 2) by the gains, each latency at its best."""
    slope, curvature = weights
    across = curvature[:, :2, 2] / curvature[:, 2, 2][:, None]
    inner = curvature[:, :2, :2] - across[:, :, None] * curvature[:, None, 2, :2]
    return slope[:, :2] - across * slope[:, 2:], inner


def _pooled(alone: Fits, weights: tuple[Array, Array], group: NDArray[np.intp]) -> Array:
    """Gains (N, 2) of each one's group: the mean of what each found, by how sure it is."""
    _, inner = _eliminated(weights)
    value, unit = alone.servos.values()[:, :2], alone.servos.unit[:, :2]
    out = np.empty_like(value)
    for g in np.unique(group):
        mine = group == g
        known = np.einsum("nij,nj->i", inner[mine], value[mine])
        out[mine] = np.linalg.lstsq(inner[mine].sum(axis=0), known)[0]
    return np.asarray(np.maximum(out, 1e-3) * unit)


def _step(
    fits: Fits,
    weights: tuple[Array, Array],
    group: NDArray[np.intp],
    gains: Array,
    *,
    settings: LatencySettings,
) -> Array:
    """Relative change of the gains, shape (N, 2), by one Gauss-Newton step of each group."""
    slope, inner = _eliminated(weights)
    out = np.empty_like(slope)
    for g in np.unique(group):
        mine = group == g
        change = np.linalg.lstsq(inner[mine].sum(axis=0), -slope[mine].sum(axis=0))[0]
        out[mine] = change / gains[mine]
    return np.clip(out, -settings.largest_change, settings.largest_change)


def _errors(fits: Fits, weights: tuple[Array, Array], *, settings: LatencySettings) -> Array:
    """Standard deviation of each latency in units, were its gains known to ``gain_sd``."""
    _, curvature = weights
    known = curvature.copy()
    gains = np.maximum(fits.servos.values()[:, :2], 1e-9)
    known[:, [0, 1], [0, 1]] += 1 / (settings.gain_sd * gains) ** 2
    return np.asarray(np.sqrt(np.linalg.inv(known)[:, 2, 2]))


@dataclass(frozen=True)
class Spread:
    """A uniform distribution that latencies were drawn from, as far as they tell.

    Attributes:
        centre: In s.
        half_width: In s.
        half_width_90: 90 % interval of the half-width in s.
    """

    centre: float
    half_width: float
    half_width_90: tuple[float, float]


def spread(seconds: Array, sd: Array, *, settings: LatencySettings = LATENCY_SETTINGS) -> Spread:
    """The uniform distribution behind latencies (E,) that are known to within ``sd`` (E,).

    Posterior medians of centre and half-width, on a grid, under a prior that is flat in the centre
    and in the logarithm of the half-width. The likelihood of each latency is the uniform density
    smeared by its own error, so that errors of the fit are not counted as spread.

    Args:
        seconds: Latencies in s, shape (E,).
        sd: Their standard deviations in s, shape (E,).
        settings: Settings of the fit.
    """
    reach = float(np.ptp(seconds)) + 3 * float(np.median(sd)) + 10 * settings.smallest_spread_s
    half = np.geomspace(settings.smallest_spread_s, 3 * reach, 160)
    middle = 0.5 * float(seconds.max() + seconds.min())
    centre = middle + np.linspace(-1.0, 1.0, 201) * reach
    log_density = np.zeros((half.size, centre.size))  # the prior is flat in the grid's steps
    for value, error in zip(seconds, np.maximum(sd, settings.law_sd_s), strict=True):
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
        episodes: What each is: a recording, or a window of one.
        seconds: Latency that all joints share, shape (E,).
        sd: How sure each is, shape (E,).
        offset: What each joint has beyond it in s, and how sure that is.
        windows: Whether episodes are windows.
        dropped: Fits that were too unsure to count.
    """

    episodes: Sequence[str]
    seconds: Array
    sd: Array
    offset: Mapping[str, tuple[float, float]]
    windows: bool
    dropped: int


def latencies(
    recordings: Sequence[Recording], model: Model, *, settings: LatencySettings = LATENCY_SETTINGS
) -> Latencies | None:
    """Find the latency of every episode; None where no joint of the model moves.

    Gains are found anew, shared by all episodes of a joint on one load, in one medium: in the water
    they are not those of the bench. Effects stay as the model has them.

    Args:
        recordings: Recordings of any kind with commands and measured angles.
        model: The fitted servos.
        settings: Settings of the fit.
    """
    labels = labelled(recordings)
    given = [
        (recording, labels[recording.file], joint, loaded(one, model.joints[joint]))
        for recording in recordings
        for joint in model.joints
        for one in traces([recording], joint)
    ]
    windows = len({name for _, name, _, _ in given}) < settings.enough_recordings
    if windows:
        given = [
            (r, n, j, w)
            for r, name, j, one in given
            for n, w in _windows(name, one, settings=settings)
        ]
    if not given:
        return None
    alike = [(joint, r.kind, r.medium, one.load) for r, _, joint, one in given]
    group = np.array([alike.index(one) for one in alike])
    models = [model.joints[joint] for _, _, joint, _ in given]
    value, sd = episode_latencies([one for *_, one in given], models, group, settings=settings)
    sure = sd < settings.largest_sd_s
    if not sure.any():
        return None
    kept = [(n, j) for (_, n, j, _), good in zip(given, sure, strict=True) if good]
    return _combined(kept, value[sure], sd[sure], windows, int(np.sum(~sure)), settings=settings)


def _windows(name: str, whole: Trace, *, settings: LatencySettings) -> list[tuple[str, Trace]]:
    """Segments of one recording, each simulated from its start but scored by itself."""
    found = []
    for start in np.arange(whole.t[0], whole.t[-1], settings.window_s):
        inside = whole.used & (whole.t >= start) & (whole.t < start + settings.window_s)
        moves = (
            np.ptp(whole.command[(whole.t >= start) & (whole.t < start + settings.window_s)]) > 0
        )
        if inside.sum() >= settings.least_samples and moves:
            found.append((f"{name} from {start:.0f} s", replace(whole, used=inside)))
    return found


def _combined(
    kept: Sequence[tuple[str, str]],
    value: Array,
    sd: Array,
    windows: bool,
    dropped: int,
    *,
    settings: LatencySettings,
) -> Latencies:
    """Split latencies into what all joints of an episode share and what each joint adds.

    Weighted least squares on latency = episode + joint, the joints' parts adding up to 0; errors
    are raised to what the fit leaves, where that is more.
    """
    episodes = list(dict.fromkeys(name for name, _ in kept))
    joints = list(dict.fromkeys(joint for _, joint in kept))
    E, J = len(episodes), len(joints)
    design = np.zeros((len(kept), E + J))
    for k, (name, joint) in enumerate(kept):
        design[k, episodes.index(name)] = 1.0
        design[k, E + joints.index(joint)] = 1.0
    weight = 1 / np.maximum(sd, settings.law_sd_s)
    tie = np.concatenate([np.zeros(E), np.full(J, weight.max() * 1e3)])
    matrix = np.vstack([design * weight[:, None], tie])
    target = np.append(value * weight, 0.0)
    covariance = np.linalg.pinv(matrix.T @ matrix)
    answer = covariance @ matrix.T @ target
    freedom = len(kept) - E - J + 1
    left = float(np.sum((matrix @ answer - target) ** 2))
    inflated = np.sqrt(np.diag(covariance) * max(left / freedom if freedom > 0 else 1.0, 1.0))
    offset = {j: (float(answer[E + k]), float(inflated[E + k])) for k, j in enumerate(joints)}
    return Latencies(episodes, answer[:E], inflated[:E], offset, windows, dropped)
