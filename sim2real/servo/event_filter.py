"""The likelihood of when each set-point took effect: a switching Kalman filter.

The linearised servo deviates from its simulation because another set-point is in force than the
simulated one. Which one is a hidden Markov chain, the lag: the number of set-points by which it is
behind. A delay is Gaussian. A hypothesis is a history of lags; those that have become alike are
merged and the least likely pruned, as in the M-algorithm (Anderson and Mohan, IEEE Transactions on
Communications 32 (1984) 169-176). Each hypothesis has a Kalman filter of its own (Ackerson and Fu,
IEEE Transactions on Automatic Control 15 (1970) 10-17).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import warp as wp

from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.inference.correlated_noise import whitened
from sim2real.servo.event_kernels import COUNTS, expect, run_filter
from sim2real.servo.linearised import Modes
from sim2real.servo.rollout import to_warp, zeros


@dataclass(frozen=True)
class Channel:
    """One joint in one recording."""

    t: Array  # times of the samples and of the set-points in s, shape (T,)
    command: Array  # set-points in rad, shape (T,)
    # from each set-point to the time at which the simulation uses it, shape (T,) or one for all
    latency_s: Array | float
    modes: Modes  # of the linearised servo
    residual: Array  # simulated minus measured angle in rad, shape (T,)
    # standard deviation of each innovation, relative to ``variance``; 0 where the sample does not
    # count, shape (T,)
    scale: Array
    rests: Mask  # whether the joint is at rest, shape (T,)
    autoregression: Array  # of the noise, shape (p,)
    variance: float  # of the innovations, rad2


@dataclass(frozen=True)
class Arrivals:
    """How set-points arrive.

    Losses are those of Gilbert, Bell System Technical Journal 39 (1960) 1253-1265; delays are a
    Gaussian autoregression of first order.
    """

    loss: float = 0.0  # probability of losing a set-point after one that arrived
    repeated_loss: float = 0.0  # probability of losing one after one that was lost
    delay_sd_s: float = 0.0  # standard deviation of the delays
    correlation: float = 0.0  # of successive delays

    @property
    def long_run_loss(self) -> float:
        """Share of the set-points that are lost in the long run."""
        return self.loss / (self.loss + 1 - self.repeated_loss)


@dataclass(frozen=True)
class Filtered:
    """Result of one group of channels that share their events."""

    loglikelihood: float  # of the innovations, up to a constant that no ``Arrivals`` changes
    counts: Array  # expected counts, shape (COUNTS,)
    # index of the set-point in force in each slot of the likeliest history, shape (T,)
    active: Integers


@dataclass(frozen=True)
class Deviation:
    """Expected difference between the simulation and the servo as it was commanded."""

    mean: Array  # in rad, shape (T,)
    # sums, over the samples in motion and over those at rest, of the covariance of the deviations
    # at lags 0 to p, in rad2, shape (2, p + 1, p + 1)
    covariance: Array


_MODEL = 9
"""Place of the autoregressions among the inputs of the kernels."""


class EventFilter:
    """Channels, ready to be filtered under any model of arrivals.

    Slot k begins when set-point k would be in force at its usual latency. Channels of one group
    have the same set-point times and share their events. Two deviations are the same that differ by
    less than ``alike`` standard deviations of the noise.
    """

    def __init__(self, groups: Sequence[Sequence[Channel]], alike: float = 0.1) -> None:
        channels = [channel for group in groups for channel in group]
        self.groups = [list(group) for group in groups]
        self.order = max(channel.autoregression.size for channel in channels)
        start = np.cumsum([0, *(channel.t.size for channel in channels)])[:-1]
        lines = [_timeline(channel) for channel in channels]
        self._slots = np.array([min(map(_slots, group)) for group in groups], dtype=np.int32)
        samples = zip(lines, channels, start, strict=True)
        ends = [np.append(first, channel.t.size) + at for (_, _, first), channel, at in samples]
        # Innovations of the residual without any deviation, 0 where not counted.
        innovations = [
            np.where(x.scale > 0, whitened(x.residual, x.autoregression), 0.0) for x in channels
        ]
        model = np.zeros((len(channels), self.order))
        for row, channel in zip(model, channels, strict=True):
            row[: channel.autoregression.size] = channel.autoregression
        self._inputs = [
            np.cumsum([0, *(len(group) for group in groups)]).astype(np.int32),
            self._slots,
            start.astype(np.int32),
            np.concatenate([channel.command for channel in channels]),
            np.concatenate([within for within, _, _ in lines]),
            np.concatenate([tail for _, tail, _ in lines]),
            np.concatenate(ends).astype(np.int32),
            np.concatenate(innovations),
            np.concatenate([channel.scale * np.sqrt(channel.variance) for channel in channels]),
            model,
            np.array([channel.modes.gain for channel in channels]),
        ]
        sd = np.array([alike * np.sqrt(channel.variance) for channel in channels])
        speed = np.array([abs(x.modes.fast * x.modes.slow) ** 0.5 for x in channels])
        self._tolerance = np.stack([sd, sd * speed], axis=1)

    def run(
        self, options: Sequence[Arrivals], *, width: int = 32, threads: int = 2
    ) -> list[list[Filtered]]:
        """Results of each group under each model of arrivals, with ``width`` hypotheses kept."""
        if len(options) == 1:
            return self._run(options, width)
        with ThreadPoolExecutor(threads) as pool:
            parts = pool.map(lambda k: self._run(options[k::threads], width), range(threads))
            shares = list(parts)
        return [shares[k % threads][k // threads] for k in range(len(options))]

    def _run(self, options: Sequence[Arrivals], width: int) -> list[list[Filtered]]:
        G, S, n, K = len(self.groups), len(options), self.order + 3, int(self._slots.max())
        rates = np.array([[x.loss, x.repeated_loss, x.delay_sd_s, x.correlation] for x in options])
        pool = 3 * width  # those kept, and two continuations of each
        joints = max(len(group) for group in self.groups)
        results = zeros((S, G)), zeros((S, G, COUNTS)), zeros((S, G, K), wp.int32)
        scratch = [
            zeros((S * G, pool, joints * n)),
            zeros((S * G, pool, joints * n * (n + 1))),
            zeros((S * G, pool, COUNTS + 1)),
            zeros((S * G, pool, 2), wp.int32),
            zeros((S * G, K, width, 2), wp.int32),
        ]
        arrays = [to_warp(x) for x in (*self._inputs, rates)]
        settings = [*arrays, width, *scratch, to_warp(self._tolerance), *results]
        wp.launch(run_filter, (S, G), settings, device="cpu")
        value, counts, active = (x.numpy() for x in results)
        return [
            [
                Filtered(float(value[s, g]), counts[s, g], active[s, g, : self._slots[g]])
                for g in range(G)
            ]
            for s in range(S)
        ]

    def expected(
        self, active: Sequence[Integers], arrivals: Arrivals, span_s: float = 0.1
    ) -> list[Deviation]:
        """Deviations of each channel along one history of each group, smoothed with a fixed lag.

        Moore, Automatica 9 (1973) 163-173: the state holds the deviations of the last samples, so
        that the filter also estimates those that lie behind, by ``span_s``. ``active``: the
        set-point in force in each slot, for each group; of the arrivals the delays count, losses
        are those of the history.
        """
        p, channels = self.order, [channel for group in self.groups for channel in group]
        period = float(np.median(np.concatenate([np.diff(channel.t) for channel in channels])))
        behind = int(np.clip(round(span_s / period), 2, 12))
        order = p + behind + 1
        model = np.pad(self._inputs[_MODEL], ((0, 0), (0, behind + 1)))
        rest = np.concatenate([channel.rests for channel in channels]).astype(np.int32)
        path = np.zeros((len(active), int(self._slots.max())), dtype=np.int32)
        for row, some in zip(path, active, strict=True):
            row[: some.size] = some
        n, N = order + 3, len(channels)
        mean, covariance = zeros((rest.size,)), zeros((N, 2, (p + 1) ** 2))
        scratch = [zeros((N, 1, n)), zeros((N, 1, n * (n + 1)))]
        inputs = *self._inputs[:_MODEL], model, self._inputs[-1], path, rest
        arrays = [to_warp(x) for x in inputs]
        sizes = p, arrivals.delay_sd_s, arrivals.correlation
        wp.launch(expect, N, [*arrays, *sizes, *scratch, mean, covariance], device="cpu")
        parts = np.split(mean.numpy(), np.cumsum([channel.t.size for channel in channels])[:-1])
        sums = covariance.numpy().reshape(N, 2, p + 1, p + 1)
        return [Deviation(a, b) for a, b in zip(parts, sums, strict=True)]


def _slots(channel: Channel) -> int:
    """Number of slots that begin before the recording ends."""
    return int(np.searchsorted(channel.t + channel.latency_s, channel.t[-1], side="right"))


def _timeline(channel: Channel) -> tuple[Array, Array, Index]:
    """Rows of ``propagator`` to each sample and the end of each slot, and its first sample."""
    t = channel.t
    begins = t + channel.latency_s
    begins[0] = t[0]
    slot = np.searchsorted(begins, t, side="right") - 1
    within = t - np.maximum(np.append(t[0], t[:-1]), begins[slot])
    ends = np.append(begins[1:], np.maximum(begins[-1], t[-1]))
    last = np.searchsorted(t, ends) - 1
    tail = ends - np.maximum(t[last], begins)
    first = np.searchsorted(slot, np.arange(t.size))
    return propagator(channel.modes, within), propagator(channel.modes, tail), first


def propagator(modes: Modes, x: Array) -> Array:
    """Transition of angle and speed over ``x`` s, and the effect of a constant set-point.

    Returns:
        Shape (N, 6): the transition matrix by rows, then angle and speed per rad of set-point.
    """
    p, r = modes.fast, modes.slow
    a, b = np.exp(p * x), np.exp(r * x)
    impulse = ((a - b) / (p - r)).real
    slope = ((p * a - r * b) / (p - r)).real
    product, total = (p * r).real, (p + r).real
    stays = slope - total * impulse
    step = modes.gain * (1 - stays) / product
    rows = stays, impulse, -product * impulse, slope, step, modes.gain * impulse
    return np.stack(rows, axis=1)
