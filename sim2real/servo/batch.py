"""Many least-squares problems of many joints at once: rollouts to whitened normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.arrays import Array, Index, Integers, Mask
from sim2real.inference.correlated_noise import WANDER, autoregression, counting, lags
from sim2real.servo import whitening
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import (
    active_effects,
    coarse_substep,
    longest_substep,
    padded,
    simulate,
    to_warp,
    trace_contexts,
    workers,
    zeros,
)
from sim2real.servo.slow_noise import SlowNoise
from sim2real.servo.trace import Trace

STEPS_PER_RADIAN = 16.0
"""Sub-steps per radian of the fastest mode: an error of 1e-4 rad, mostly absorbed by the gains."""
_MOST_SUBSTEPS = 64
"""Largest number of sub-steps between two samples. The fast mode of a servo that is damped more
strongly has decayed within a sample, and the trapezoidal rule for the damping stays stable."""
_SAME_RAD = 5e-3
"""Largest root-mean-square change of a servo's angles by long sub-steps, rad."""
_BYTES = 200e6
"""Bytes of angles in memory at once."""


@dataclass(frozen=True)
class Problems:
    """Servos to simulate on all recordings of one joint each, with perturbed variants of each."""

    joint: Integers  # index of the joint in the batch, shape (N,)
    # parameters of each servo and then of its variants, shape (N, V, P); loads are taken from the
    # recordings
    theta: Array
    # factor on the difference of each variant from its servo, shape (N, V); 0 for an absent variant
    scale: Array


@dataclass(frozen=True)
class Normal:
    """Whitened normal equations."""

    # inner products of the residual (index 0) and the differences of the first variants with the
    # differences of all, per block of the recordings, shape (N, blocks, deep, V), in rad2
    gram: Array
    square: Array  # inner product of each with itself, over all blocks, shape (N, V)
    count: Array  # number of samples whose innovations count, shape (N,)
    autoregression: Array  # coefficients of the noise model, shape (N, lags)
    # simulated minus measured angles before whitening, shape (N, R, T); None unless requested
    residual: Array | None = None
    # simulated angles of the servos, see ``known`` of ``Batch.evaluate``, shape (N, R, T)
    angles: Array | None = None


class Batch:
    """Recordings of joints, ready for problems of any number.

    The noise is that of a sensor, whose slow drift is ``bounded``; otherwise it is unbounded, to
    include errors that no model explains, or always ``white``. Where all traces have ``SlowErrors``
    it is white beside these, and ``slow``. ``period``, the median time between
    samples in s, determines the number of lags of the noise model. ``substeps`` has those simulated
    so far for each joint, shape (J,): a machine-independent measure of work, to which a sample and
    the arrival of a set-point count one each.
    """

    def __init__(
        self,
        joints: Sequence[Sequence[Trace]],
        threads: int = 2,
        *,
        bounded: bool = True,
        white: bool = False,
        period: float | None = None,
    ) -> None:
        all_traces = [trace for traces in joints for trace in traces]
        if period is None:
            period = float(np.median(np.concatenate([np.diff(x.t) for x in all_traces[:64]])))
        self.threads, self.period = threads, period
        self.least_gain = WANDER.least_gain(period) if bounded else 0.0
        slow = not white and all(trace.slow is not None for trace in all_traces)
        self.white = white or slow
        self.lags = 1 if self.white else lags(period)
        self.recordings = np.array([len(traces) for traces in joints], dtype=np.int32)
        self.first_signal = np.concatenate([[0], np.cumsum(self.recordings)[:-1]]).astype(np.int32)
        signals, position, self.load = padded(all_traces)
        self.length = signals[2]
        counts = np.zeros(position.shape, dtype=np.int32)
        for s, trace in enumerate(all_traces):
            counts[s, : trace.t.size] = counting(trace.used, self.lags)
        self.weight = np.ones(position.shape)
        for s, trace in enumerate(all_traces):
            self.weight[s, : trace.t.size] = 1 / trace.noise_ratio
        self.samples = counts.sum(axis=1)
        self.substeps = np.zeros(len(joints))
        self._span_s = np.array([trace.duration_s for trace in all_traces])
        self._signals = [to_warp(x) for x in signals]
        self._position, self._counts = to_warp(position), to_warp(counts)
        self._length, self._weight = self._signals[2], to_warp(self.weight)
        self._contexts = [to_warp(x) for x in trace_contexts(all_traces)]
        self.slow = SlowNoise(all_traces) if slow else None

    def count(self, joint: Integers) -> Array:
        """Number of samples whose innovations count, for each of these joints, shape (N,)."""
        per_joint = np.add.reduceat(self.samples, self.first_signal).astype(np.float64)
        return np.asarray(per_joint[joint])

    def evaluate(
        self,
        problems: Problems,
        *,
        blocks: int = 1,
        deep: int | None = None,
        autoregression: Array | None = None,
        keep: bool = False,
        rough: bool = False,
        alone: bool = False,
        known: Array | None = None,
    ) -> Normal:
        """Simulate the problems, whiten residuals and differences, and form inner products.

        Of ``blocks`` of each recording; with the first ``deep`` variants only, and of each variant
        with itself, by default with all of them. The ``autoregression`` of each problem (N, lags)
        is by default fitted by least squares to its residual. With ``keep``, residuals
        are returned as well; with ``rough``, the servos are also simulated with the
        longer sub-steps of differences (``rollout.coarse_substep``), as for the choice of starting
        points. ``alone``: the servos without their variants, with their ``angles``, which a further
        evaluation then takes as ``known``; the variants are counted at the first.
        """
        if known is None:
            self._count_substeps(problems, rough=rough)
        if alone:
            problems = Problems(problems.joint, problems.theta[:, :1], problems.scale[:, :1])
        N, V, _ = problems.theta.shape
        if self.white:
            autoregression = np.zeros((N, self.lags))
        per_problem = self.recordings.max() * V * self.length.max() * 8
        size = max(1, int(_BYTES / per_problem))
        shape, results = (blocks, deep or V), []
        for part in (slice(k, min(k + size, N)) for k in range(0, N, size)):
            coefficients = None if autoregression is None else autoregression[part]
            piece = Problems(problems.joint[part], problems.theta[part], problems.scale[part])
            exact = None if known is None else known[part]
            results.append(self._evaluate(piece, shape, coefficients, exact, keep, rough, alone))
        gram, square, model, *extras = (np.concatenate(x) for x in zip(*results, strict=True))
        normal = Normal(gram, square, self.count(problems.joint), model)
        return replace(normal, **{"angles" if alone else "residual": one for one in extras})

    def _evaluate(
        self,
        problems: Problems,
        size: tuple[int, int],
        coefficients: Array | None,
        known: Array | None,
        keep: bool,
        rough: bool,
        alone: bool,
    ) -> tuple[Array, ...]:
        N, V, _ = problems.theta.shape
        recordings = self.recordings[problems.joint]
        R = int(self.recordings.max())
        # One row for each problem, recording and present variant.
        present = np.zeros((N, R, V), dtype=bool)
        present[np.arange(R) < recordings[:, None]] = True
        present &= (np.arange(V) == 0) | (problems.scale[:, None] != 0)
        count = present.sum(axis=2)[:, 0].astype(np.int32)
        problem, recording, variant = np.nonzero(present)
        signal = (self.first_signal[problems.joint][problem] + recording).astype(np.int32)
        first = np.concatenate([[0], np.cumsum(count * recordings)[:-1]]).astype(np.int32)
        within = np.cumsum(present, axis=2)[problem, recording, variant] - 1
        rows = np.arange(problem.size)
        base = (rows - within).astype(np.int32)
        order = np.argsort(~present[:, 0], axis=1, kind="stable")  # present variants first
        active = active_effects(problems.theta.reshape(N * V, -1)).reshape(N, V)
        fine, coarse = self._substeps(problems, rough=rough)
        launch = partial(wp.launch, device="cpu")
        table = to_warp(problems.theta.reshape(N * V, -1))
        theta = zeros((rows.size, len(COLUMNS)))
        signals = to_warp(signal)
        table_row = to_warp((problem * V + variant).astype(np.int32))
        launch(whitening.expand, rows.size, [table, table_row, signals, *self._contexts], [theta])
        angle = zeros((rows.size, int(self.length.max())))
        bases, scale = to_warp(base), to_warp(problems.scale[problem, variant])
        shared = [bases, signals, self._length, self._weight]

        def run(substep: Array, selected: Index | None = None) -> None:
            latency, on = problems.theta[problem, variant, 2], active[problem, variant]
            longest = substep[problem, recording]
            inputs = on, latency, theta, signal, self._signals, longest, angle
            # Neighbouring rows take as long as each other: each thread has every second one.
            chosen = rows if selected is None else selected
            shares = [chosen[k :: self.threads] for k in range(self.threads)]
            list(workers(self.threads).map(lambda share: simulate(*inputs, share), shares))

        servos = variant == 0
        long_steps = V > 1
        if known is None or not long_steps:
            run(fine, rows[servos] if long_steps else None)
        extras = []
        if alone:
            extras.append(self._fetch(angle, first, count, recordings))
        if long_steps:
            angles = angle.numpy()  # the same memory
            exact = angles[servos] if known is None else known[problem, recording][servos]
            run(coarse)
            repeated = np.isin(base, base[_unstable(angles, servos, exact)])
            if repeated.any():
                run(fine, rows[repeated])
        launch(whitening.difference, rows.size, [*shared, scale, angle])
        if long_steps:
            angles[servos] = exact
        launch(whitening.residual, rows.size, [*shared, self._position, angle])
        if keep:
            weighted = self._fetch(angle, first, count, recordings)
            at = self.first_signal[problems.joint][:, None] + np.arange(R)
            extras.append(weighted / self.weight[np.minimum(at, len(self.weight) - 1)])
        layout = [
            to_warp(first),
            to_warp(recordings.astype(np.int32)),
            to_warp(count),
            signals,
            self._length,
        ]
        noise_model = coefficients
        if noise_model is None:
            products = zeros((N, self.lags + 1, self.lags + 1))
            inputs = [*layout, self._counts, angle]
            launch(whitening.lag_products, products.shape[:2], inputs, [products])
            noise_model = autoregression(products.numpy(), self.least_gain)
        if self.slow is not None:
            self.slow.whiten(signals, angle)
        else:
            noise = [to_warp(problem.astype(np.int32)), signals, self._length, self._counts]
            launch(whitening.whiten, rows.size, [*noise, to_warp(noise_model), angle])
        packed = zeros((N, R * size[0], (size[1] + 1) * V))
        launch(whitening.gram, packed.shape, [*layout, *size, angle], [packed])
        return (*_unpacked(packed.numpy(), size[1], count, order), noise_model, *extras)

    def _fetch(self, angle: Any, first: Integers, count: Integers, recordings: Integers) -> Array:  # noqa: ANN401
        """The residual rows of all problems, shape (N, R, T)."""
        angles = angle.numpy()
        out = np.zeros((first.size, int(self.recordings.max()), angles.shape[1]))
        for r in range(int(recordings.max())):
            has = recordings > r
            out[has, r] = angles[first[has] + r * count[has]]
        return out

    def _count_substeps(self, problems: Problems, *, rough: bool) -> None:
        recording = np.arange(self.recordings.max())
        signal = self.first_signal[problems.joint][:, None] + recording
        signal = np.minimum(signal, self.length.size - 1)
        present = recording < self.recordings[problems.joint][:, None]
        variants = np.count_nonzero(problems.scale[:, 1:], axis=1)
        servos = (np.ones_like(variants), np.where(variants > 0, 1 + variants, 0))
        for substep, rollouts in zip(self._substeps(problems, rough=rough), servos, strict=True):
            steps = np.where(present, self._span_s[signal] / substep + 2 * self.length[signal], 0.0)
            np.add.at(self.substeps, problems.joint, np.nan_to_num(rollouts * steps.sum(axis=1)))

    def _substeps(self, problems: Problems, *, rough: bool) -> tuple[Array, Array]:
        """Sub-steps of servos and of differences of variants, in s, shape (N, R) each.

        All variants on one recording have the same sub-step.
        """
        recording = np.minimum(np.arange(self.recordings.max()), self.recordings.max() - 1)
        signal = self.first_signal[problems.joint][:, None] + recording
        inertia = self.load[np.minimum(signal, len(self.load) - 1), 0]
        longest = longest_substep(problems.theta[:, :1], inertia, STEPS_PER_RADIAN)
        fine = np.maximum(longest, self.period / _MOST_SUBSTEPS)
        coarse = coarse_substep(fine)
        return coarse if rough else fine, coarse


def _unstable(angles: Array, servos: Mask, exact: Array) -> Mask:
    """Rows that are unstable with long sub-steps, as under strong nonlinear damping, (rows,)."""
    unstable: Mask = np.logical_not(np.isfinite(angles).all(axis=1))
    with np.errstate(over="ignore", invalid="ignore"):
        close = np.mean((angles[servos] - exact) ** 2, axis=1) < _SAME_RAD**2
    unstable[servos] |= ~close
    return unstable


def _unpacked(
    packed: Array, deep: int, count: Integers, order: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Inner products in the order of the variants, 0 for absent ones."""
    N, B, _ = packed.shape
    V = order.shape[1]
    table = packed.reshape(N, B, deep + 1, V)
    gram, square = table[:, :, :deep], table[:, :, deep].sum(axis=1)
    low, high = np.triu_indices(deep, 1)
    gram[:, :, high, low] = gram[:, :, low, high]
    if (count == V).all():
        return gram, square
    full_gram, full_square = np.zeros_like(gram), np.zeros_like(square)
    for size in np.unique(count):
        rows = np.flatnonzero(count == size)
        place = order[rows, :size]
        deep_size = np.minimum(size, deep)
        full_gram[
            rows[:, None, None, None],
            np.arange(B)[None, :, None, None],
            place[:, None, :deep_size, None],
            place[:, None, None, :],
        ] = gram[rows, :, :deep_size, :size]
        full_square[rows[:, None], place] = square[rows, :size]
    return full_gram, full_square
