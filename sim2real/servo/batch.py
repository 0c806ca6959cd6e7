"""Many least-squares problems of many joints at once: rollouts to whitened normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.inference.correlated_noise import WANDER, autoregression, counting, lags
from sim2real.servo import whitening
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.rollout import (
    active_effects,
    coarse_substep,
    longest_substep,
    simulate,
    to_warp,
)
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]
Whole = NDArray[np.int32]

STEPS_PER_RADIAN = 16.0
"""Sub-steps per radian of the fastest mode: an error of 1e-4 rad, mostly taken up by the gains."""
_MOST_SUBSTEPS = 64
"""Sub-steps between two samples, however strongly a servo is damped: its faster mode has decayed
by then, and the trapezoidal rule for the damping stays stable."""
_SAME_RAD = 5e-3
"""Root mean square in rad by which long sub-steps may change the angles of a servo."""
_BYTES = {"cpu": 100e6, "cuda": 16e9}
"""Angles held at once by one thread of the processor or by the device."""
_INERTIA = BASE.index("inertia_kgm2")


@dataclass(frozen=True)
class Problems:
    """Servos to simulate, each on all recordings of one joint, with variants of each.

    Attributes:
        joint: Which joint of the batch, shape (N,).
        theta: Parameters of each servo and then of its variants, shape (N, V, P); loads are taken
            from the recordings.
        scale: What the difference of each variant is multiplied with, shape (N, V); 0 for a
            variant that is not there.
    """

    joint: Whole
    theta: Array
    scale: Array


@dataclass(frozen=True)
class Normal:
    """Whitened normal equations.

    Attributes:
        gram: Inner products of the residual (index 0) and of the first variants' differences with
            those of all, for each block of the recordings, shape (N, blocks, deep, V), in rad2.
        square: Inner products of each with itself, over all blocks, shape (N, V).
        count: Samples that count, shape (N,).
        autoregression: Coefficients of the noise model, shape (N, lags).
        residual: Simulated minus measured angles, before whitening, shape (N, R, T), where asked
            for.
        whitened: Innovations of the residual, likewise.
    """

    gram: Array
    square: Array
    count: Array
    autoregression: Array
    residual: Array | None = None
    whitened: Array | None = None


class Batch:
    """Recordings of joints, on a device, ready for problems of any number.

    Args:
        joints: For each joint its traces.
        device: Warp device.
        threads: CPU threads.
        bounded: Whether the noise is that of a sensor, whose slow wander is bounded; else it may
            be anything, as what no model explains must be.
        white: Whether the noise is taken for white, whatever a fit or a screen asks for.
        period: Time between samples, which says how far the noise reaches back; their median
            where None.

    Attributes:
        substeps: Sub-steps simulated so far for each joint, a sample and the arrival of a
            set-point counting as one each, shape (J,): a measure of the work that is the same on
            every machine.
    """

    def __init__(
        self,
        joints: Sequence[Sequence[Trace]],
        device: str = "cpu",
        threads: int = 2,
        *,
        bounded: bool = True,
        white: bool = False,
        period: float | None = None,
    ) -> None:
        every = [trace for traces in joints for trace in traces]
        longest = max(trace.t.size for trace in every)
        if period is None:
            period = float(np.median(np.concatenate([np.diff(x.t) for x in every[:64]])))
        self.device, self.threads, self.period = device, threads, period
        self.least_gain = WANDER.least_gain(period) if bounded else 0.0
        self.lags, self.white = lags(period), white
        self.recordings = np.array([len(traces) for traces in joints], dtype=np.int32)
        self.first_signal = np.concatenate([[0], np.cumsum(self.recordings)[:-1]]).astype(np.int32)
        self.length = np.array([trace.t.size for trace in every], dtype=np.int32)
        self.load = np.array([[x.load.inertia_kgm2, x.load.gravity_Nm] for x in every])
        t, command, position = (np.zeros((len(every), longest)) for _ in range(3))
        counts = np.zeros((len(every), longest), dtype=np.int32)
        for s, trace in enumerate(every):
            part = np.s_[s, : trace.t.size]
            t[part], command[part] = trace.t, trace.command
            position[part] = np.where(trace.used, trace.position, np.nan)
            counts[part] = counting(trace.used, self.lags)
        self.samples = counts.sum(axis=1)
        self.substeps = np.zeros(len(joints))
        self._span_s = np.array([trace.t[-1] - trace.t[0] for trace in every])
        self._signals = [to_warp(x, device) for x in (t, command, self.length)]
        self._position, self._counts = (to_warp(x, device) for x in (position, counts))
        self._length, self._load = self._signals[2], to_warp(self.load, device)

    def count(self, joint: Whole) -> Array:
        """Samples that count for each of these joints, shape (N,)."""
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
    ) -> Normal:
        """Simulate, whiten and multiply.

        Args:
            problems: What to simulate.
            blocks: Blocks into which each recording is cut.
            deep: Inner products with the first ``deep`` variants only (and of each with itself);
                with all of them where None.
            autoregression: Noise model of each problem, shape (N, lags); by least squares on each
                problem's own residual where None.
            keep: Whether to return residuals and innovations as well.
            rough: Whether the servos themselves have the longer sub-steps of differences too
                (``rollout.coarse_substep``): to choose where a fit starts.
        """
        N, V, _ = problems.theta.shape
        self._count_substeps(problems, rough=rough)
        if self.white:
            autoregression = np.zeros((N, self.lags))
        room = next(v for k, v in _BYTES.items() if self.device.startswith(k))
        per_problem = self.recordings.max() * V * self.length.max() * 8
        size = max(1, int(room / per_problem))
        if self.device == "cpu":
            size = min(size, max(1, -(-N // self.threads)))
        parts = [slice(k, min(k + size, N)) for k in range(0, N, size)]

        def one(part: slice) -> tuple[Array, ...]:
            given = None if autoregression is None else autoregression[part]
            piece = Problems(problems.joint[part], problems.theta[part], problems.scale[part])
            return self._evaluate(piece, (blocks, deep or V), given, keep=keep, rough=rough)

        if self.device == "cpu" and len(parts) > 1:
            with ThreadPoolExecutor(self.threads) as pool:
                done = list(pool.map(one, parts))
        else:
            done = [one(part) for part in parts]
        gram, square, model, *kept = (np.concatenate(x) for x in zip(*done, strict=True))
        return Normal(gram, square, self.count(problems.joint), model, *kept)

    def _evaluate(
        self,
        problems: Problems,
        size: tuple[int, int],
        given: Array | None,
        *,
        keep: bool,
        rough: bool,
    ) -> tuple[Array, ...]:
        N, V, _ = problems.theta.shape
        recordings = self.recordings[problems.joint]
        most = int(self.recordings.max())
        # One row for each problem, recording and variant that is there.
        there = np.zeros((N, most, V), dtype=bool)
        there[np.arange(most) < recordings[:, None]] = True
        there &= (np.arange(V) == 0) | (problems.scale[:, None] != 0)
        number = there.sum(axis=2)[:, 0].astype(np.int32)
        problem, recording, variant = np.nonzero(there)
        signal = (self.first_signal[problems.joint][problem] + recording).astype(np.int32)
        first = np.concatenate([[0], np.cumsum(number * recordings)[:-1]]).astype(np.int32)
        within = np.cumsum(there, axis=2)[problem, recording, variant] - 1
        rows = np.arange(problem.size)
        base = (rows - within).astype(np.int32)
        order = np.argsort(~there[:, 0], axis=1, kind="stable")  # variants that are there first
        active = active_effects(problems.theta.reshape(N * V, -1)).reshape(N, V)
        fine, coarse = self._substeps(problems, rough=rough)
        dev = self.device

        def put(values: NDArray[Any]) -> Any:  # noqa: ANN401 - Warp has no stubs
            return to_warp(values, dev)

        table = put(problems.theta.reshape(N * V, -1))
        theta = wp.empty((rows.size, len(COLUMNS)), dtype=wp.float64, device=dev)
        signals = put(signal)
        which = put((problem * V + variant).astype(np.int32))
        wp.launch(
            whitening.expand,
            dim=rows.size,
            inputs=[table, which, signals, self._load, _INERTIA],
            outputs=[theta],
            device=dev,
        )
        angle = wp.zeros((rows.size, int(self.length.max())), dtype=wp.float64, device=dev)
        bases, scale = put(base), put(problems.scale[problem, variant])
        shared = [bases, signals, self._length]

        def run(substep: Array, which: NDArray[np.intp] | None = None) -> None:
            latency, on = problems.theta[problem, variant, 2], active[problem, variant]
            longest = substep[problem, recording]
            simulate(on, latency, theta, signal, self._signals, longest, angle, which)

        servos = variant == 0
        long_steps = V > 1 and dev == "cpu"
        run(fine, rows[servos] if long_steps else None)
        if long_steps:
            angles = _values(angle)  # the same memory
            exact = angles[servos]
            run(coarse)
            repeated = np.isin(base, base[_unstable(angles, servos, exact)])
            if repeated.any():
                run(fine, rows[repeated])
        wp.launch(whitening.difference, dim=rows.size, inputs=[*shared, scale, angle], device=dev)
        if long_steps:
            angles[servos] = exact
        wp.launch(
            whitening.residual, dim=rows.size, inputs=[*shared, self._position, angle], device=dev
        )
        kept = [self._fetch(angle, first, number, recordings)] if keep else []
        layout = [put(first), put(recordings.astype(np.int32)), put(number), signals, self._length]
        model = given
        if model is None:
            products = wp.zeros((N, self.lags + 1, self.lags + 1), dtype=wp.float64, device=dev)
            wp.launch(
                whitening.lag_products,
                dim=products.shape[:2],
                inputs=[*layout, self._counts, angle],
                outputs=[products],
                device=dev,
            )
            model = autoregression(_values(products), self.least_gain)
        wp.launch(
            whitening.whiten,
            dim=rows.size,
            inputs=[
                put(problem.astype(np.int32)),
                signals,
                self._length,
                self._counts,
                put(model),
                angle,
            ],
            device=dev,
        )
        if keep:
            kept.append(self._fetch(angle, first, number, recordings))
        packed = wp.zeros((N, most * size[0], (size[1] + 1) * V), dtype=wp.float64, device=dev)
        wp.launch(
            whitening.gram,
            dim=packed.shape,
            inputs=[*layout, *size, angle],
            outputs=[packed],
            device=dev,
        )
        return (*_unpacked(_values(packed), size[1], number, order), model, *kept)

    def _fetch(self, angle: Any, first: Whole, number: Whole, recordings: Whole) -> Array:  # noqa: ANN401
        """The residual rows of all problems, shape (N, R, T)."""
        everything = _values(angle)
        out = np.zeros((first.size, int(self.recordings.max()), everything.shape[1]))
        for r in range(int(recordings.max())):
            has = recordings > r
            out[has, r] = everything[first[has] + r * number[has]]
        return out

    def _count_substeps(self, problems: Problems, *, rough: bool) -> None:
        recording = np.arange(self.recordings.max())
        signal = self.first_signal[problems.joint][:, None] + recording
        signal = np.minimum(signal, self.length.size - 1)
        there = recording < self.recordings[problems.joint][:, None]
        variants = np.count_nonzero(problems.scale[:, 1:], axis=1)
        servos = (np.ones_like(variants), np.where(variants > 0, 1 + variants, 0))
        for substep, number in zip(self._substeps(problems, rough=rough), servos, strict=True):
            each = np.where(there, self._span_s[signal] / substep + 2 * self.length[signal], 0.0)
            np.add.at(self.substeps, problems.joint, np.nan_to_num(number * each.sum(axis=1)))

    def _substeps(self, problems: Problems, *, rough: bool) -> tuple[Array, Array]:
        """Sub-steps of servos, and those for differences of variants, in s, shape (N, R) each.

        All variants on one recording have the same.
        """
        recording = np.minimum(np.arange(self.recordings.max()), self.recordings.max() - 1)
        signal = self.first_signal[problems.joint][:, None] + recording
        inertia = self.load[np.minimum(signal, len(self.load) - 1), 0]
        longest = longest_substep(problems.theta[:, :1], inertia, STEPS_PER_RADIAN)
        fine = np.maximum(longest, self.period / _MOST_SUBSTEPS)
        coarse = coarse_substep(fine)
        return coarse if rough else fine, coarse


def _unstable(angles: Array, servos: NDArray[np.bool_], exact: Array) -> NDArray[np.bool_]:
    """Rows for which long sub-steps are unstable, as strong nonlinear damping makes them, (rows,).

    Args:
        angles: Angles with long sub-steps in rad, shape (rows, T).
        servos: Which rows are servos, not variants, shape (rows,).
        exact: Angles of the servos with short sub-steps in rad, shape (servos, T).
    """
    unstable: NDArray[np.bool_] = np.logical_not(np.isfinite(angles).all(axis=1))
    with np.errstate(over="ignore", invalid="ignore"):
        same = np.mean((angles[servos] - exact) ** 2, axis=1) < _SAME_RAD**2
    unstable[servos] |= ~same
    return unstable


def _values(values: Any) -> Array:  # noqa: ANN401 - Warp has no stubs
    """A Warp array as a NumPy array."""
    taken: Array = values.numpy()
    return taken


def _unpacked(
    packed: Array, deep: int, number: Whole, order: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Inner products by the places of the variants, 0 for those that are not there."""
    N, B, _ = packed.shape
    V = order.shape[1]
    table = packed.reshape(N, B, deep + 1, V)
    gram, square = table[:, :, :deep], table[:, :, deep].sum(axis=1)
    upper = np.triu(np.ones((deep, deep), dtype=bool), 1)
    low, high = np.nonzero(upper)
    gram[:, :, high, low] = gram[:, :, low, high]
    if (number == V).all():
        return gram, square
    full, whole = np.zeros_like(gram), np.zeros_like(square)
    for size in np.unique(number):
        some = np.flatnonzero(number == size)
        place = order[some, :size]
        inside = np.minimum(size, deep)
        full[
            some[:, None, None, None],
            np.arange(B)[None, :, None, None],
            place[:, None, :inside, None],
            place[:, None, None, :],
        ] = gram[some, :, :inside, :size]
        whole[some[:, None], place] = square[some, :size]
    return full, whole
