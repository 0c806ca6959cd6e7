"""Many least-squares problems of many joints at once: rollouts to whitened normal equations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from sim2real.arrays import Array, Integers, Mask
from sim2real.inference.correlated_noise import WANDER, autoregression, counting, lags
from sim2real.servo import whitening
from sim2real.servo.rollout import Simulator, coarse_substep, longest_substep, to_warp, zeros
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
    """Recordings of J joints, ready for problems of any number.

    The noise is that of a sensor, whose slow drift is ``bounded``; otherwise it is unbounded, to
    include errors that no model explains, or always ``white``. Where all traces have ``SlowErrors``
    it is white beside these, and ``slow``. ``period``, the median time between samples in s,
    determines the number of lags of the noise model. ``inertia`` is that of the load of the first
    recording of each joint in kg m2, (J,). ``substeps`` has those simulated so far for each joint,
    (J,): a machine-independent measure of work, to which a sample and the arrival of a set-point
    count one each.
    """

    def __init__(
        self,
        joints: Sequence[Sequence[Trace]],
        *,
        bounded: bool = True,
        white: bool = False,
        period: float | None = None,
    ) -> None:
        all_traces = [trace for traces in joints for trace in traces]
        if period is None:
            period = float(np.median(np.concatenate([np.diff(x.t) for x in all_traces[:64]])))
        self.period = period
        self.least_gain = WANDER.least_gain(period) if bounded else 0.0
        slow = not white and all(trace.slow is not None for trace in all_traces)
        self.slow = SlowNoise(all_traces) if slow else None
        self.white = white or slow
        self.lags = 1 if self.white else lags(period)
        self._simulator = Simulator(all_traces)
        shape = self._simulator.position.shape
        self._counts, self._weight = np.zeros(shape, dtype=np.int32), np.ones(shape)
        for s, trace in enumerate(all_traces):
            self._counts[s, : trace.t.size] = counting(trace.used, self.lags)
            self._weight[s, : trace.t.size] = 1 / trace.noise_ratio
        recordings = np.array([len(traces) for traces in joints])
        place = np.arange(recordings.max())
        # index of each recording of a joint, -1 beyond their number, shape (J, R)
        first = np.cumsum(recordings) - recordings
        self._signal = np.where(place < recordings[:, None], first[:, None] + place, -1)
        self.inertia = self._simulator.load[first, 0]
        self._count = np.add.reduceat(self._counts.sum(axis=1), first).astype(np.float64)
        self.substeps = np.zeros(len(joints))

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
        is by default fitted by least squares to its residual. With ``keep``, residuals are returned
        as well; with ``rough``, servos have the longer sub-steps of differences, too
        (``rollout.coarse_substep``), as for the choice of starting points. ``alone``: the servos
        without their variants, with their ``angles``, which a further evaluation then takes as
        ``known``; the variants are counted at the first.
        """
        substeps = self._substeps(problems, rough=rough)
        signal = self._signal[problems.joint]
        if known is None:
            variants = np.count_nonzero(problems.scale[:, 1:], axis=1)
            span = np.array([trace.duration_s for trace in self._simulator.traces])[signal]
            arrivals = 2 * self._simulator.length[signal]
            for substep, rollouts in zip(substeps, (1, variants + (variants > 0)), strict=True):
                steps = np.where(signal >= 0, span / substep + arrivals, 0.0).sum(axis=1)
                np.add.at(self.substeps, problems.joint, np.nan_to_num(rollouts * steps))
        if alone:
            problems = Problems(problems.joint, problems.theta[:, :1], problems.scale[:, :1])
        N, V, _ = problems.theta.shape
        if self.white:
            autoregression = np.zeros((N, self.lags))
        size = max(1, int(_BYTES / (self._weight[0].nbytes * signal.shape[1] * V)))
        results = []
        for part in (slice(k, min(k + size, N)) for k in range(0, N, size)):
            piece = Problems(problems.joint[part], problems.theta[part], problems.scale[part])
            coefficients, exact = (None if x is None else x[part] for x in (autoregression, known))
            steps = substeps[0][part], substeps[1][part]
            shape = blocks, deep or V
            results.append(self._evaluate(piece, steps, shape, coefficients, exact, keep, alone))
        gram, square, model, *extras = (np.concatenate(x) for x in zip(*results, strict=True))
        normal = Normal(gram, square, self._count[problems.joint], model)
        return replace(normal, **{"angles" if alone else "residual": one for one in extras})

    def _evaluate(
        self,
        problems: Problems,
        substeps: tuple[Array, Array],
        size: tuple[int, int],
        coefficients: Array | None,
        known: Array | None,
        keep: bool,
        alone: bool,
    ) -> tuple[Array, ...]:
        """Inner products, squares and noise model of some problems, and what else is asked for."""
        (N, V, _), (blocks, deep) = problems.theta.shape, size
        signals = self._signal[problems.joint]
        # One row for each problem, recording and present variant; -1 for absent ones.
        present = (np.arange(V) == 0) | (problems.scale[:, None] != 0)
        place = np.where((signals >= 0)[:, :, None] & present, 0, -1).astype(np.int32)
        problem, recording, variant = np.nonzero(place == 0)
        place[problem, recording, variant] = np.arange(problem.size)
        signal, base = signals[problem, recording], place[problem, recording, 0]
        theta, servos = problems.theta[problem, variant], variant == 0
        fine, coarse = (x[problem, recording] for x in substeps)
        measured, weight = (x[signal[servos]] for x in (self._simulator.position, self._weight))

        def by_recording(values: Array) -> Array:
            """Values of all servos, shape (N, R, T)."""
            out = np.zeros((*signals.shape, values.shape[1]))
            out[problem[servos], recording[servos]] = values
            return out

        if known is None or V == 1:
            angle = self._simulator.run(theta[servos], signal[servos], fine[servos])
        else:
            angle = known[problem[servos], recording[servos]]
        extras = [by_recording(angle)] if alone else []
        with np.errstate(over="ignore", invalid="ignore"):  # of diverged simulations
            left = np.where(np.isnan(measured), 0.0, (angle - measured) * weight)
            if V > 1:
                exact, angle = angle, self._simulator.run(theta, signal, coarse)
                # some are unstable with long sub-steps, as under strong nonlinear damping
                unstable: Mask = np.logical_not(np.isfinite(angle).all(axis=1))
                unstable[servos] |= ~(np.mean((angle[servos] - exact) ** 2, axis=1) < _SAME_RAD**2)
                again = np.isin(base, base[unstable])
                if again.any():
                    angle[again] = self._simulator.run(theta[again], signal[again], fine[again])
                angle -= angle[base]
                angle *= problems.scale[problem, variant][:, None]
                angle *= self._weight[signal]
        angle[servos] = left
        if keep:
            extras.append(by_recording(left / weight))
        row, recorded, rows = to_warp(angle), to_warp(signal.astype(np.int32)), to_warp(place)
        layout = [rows, recorded, to_warp(self._simulator.length)]
        if coefficients is None:
            products = zeros((N, self.lags + 1, self.lags + 1))
            inputs = [*layout, to_warp(self._counts), row]
            wp.launch(whitening.lag_products, products.shape[:2], inputs, [products], device="cpu")
            coefficients = autoregression(products.numpy(), self.least_gain)
        if self.slow is not None:
            self.slow.whiten(recorded, row)
        else:
            noise = to_warp(self._counts), to_warp(coefficients)
            inputs = [to_warp(problem.astype(np.int32)), *layout[1:], *noise, row]
            wp.launch(whitening.whiten, problem.size, inputs, device="cpu")
        packed = zeros((N, signals.shape[1] * blocks, (deep + 1) * V))
        inputs = [*layout, blocks, deep, row]
        wp.launch(whitening.gram, packed.shape, inputs, [packed], device="cpu")
        table = packed.numpy().reshape(N, -1, deep + 1, V)
        gram, square = table[:, :, :deep], table[:, :, deep].sum(axis=1)
        low, high = np.triu_indices(deep, 1)
        gram[:, :, high, low] = gram[:, :, low, high]
        return gram, square, coefficients, *extras

    def _substeps(self, problems: Problems, *, rough: bool) -> tuple[Array, Array]:
        """Sub-steps of servos and of differences of variants, in s, shape (N, R) each.

        All variants on one recording have the same sub-step.
        """
        inertia = self._simulator.load[self._signal[problems.joint], 0]
        longest = longest_substep(problems.theta[:, :1], inertia, STEPS_PER_RADIAN)
        fine = np.maximum(longest, self.period / _MOST_SUBSTEPS)
        coarse = coarse_substep(fine)
        return coarse if rough else fine, coarse
