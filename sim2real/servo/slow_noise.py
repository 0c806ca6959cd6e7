"""Noise that includes slow errors of a law (``SlowErrors``): whitening, and how large they are.

A law that is nearly right is wrong by milliradians for as long as friction holds a shaft, and by
milliseconds for as long as a bus is late. Taken for white noise, these errors let hundreds of
readings at rest speak for whatever happens to have their shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import warp as wp
from scipy.optimize import minimize

from sim2real.arrays import Array
from sim2real.effects.effect import Row, Table
from sim2real.inference.correlated_noise import SlowErrors
from sim2real.servo.rollout import padded, to_warp
from sim2real.servo.trace import Trace


@wp.kernel(enable_backward=False)
def _whiten(
    signal: wp.array(dtype=wp.int32),
    length: wp.array(dtype=wp.int32),
    position: Table,
    weight: Table,
    speed: Table,
    process: Table,
    angle: Table,
    logarithm: Row,
) -> None:
    """Replace weighted samples by innovations of variance 1, by a Kalman filter of two states.

    Also the sum of the logarithms of their variances before. Source: Anderson, Moore, Optimal
    Filtering (Prentice-Hall 1979), section 5.3.
    """
    row = wp.tid()
    s = signal[row]
    first, second, keep, keep_delay = process[s, 0], process[s, 1], process[s, 2], process[s, 3]
    one = wp.float64(1.0)
    error, delay, cross, total = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    variance, variance_delay = wp.float64(first), wp.float64(second)
    for k in range(length[s]):
        e = wp.float64(0.0)
        if not wp.isnan(position[s, k]):
            w, v = weight[s, k], weight[s, k] * speed[s, k]
            with_error, with_delay = w * variance + v * cross, w * cross + v * variance_delay
            size = w * with_error + v * with_delay + one
            left = angle[row, k] - w * error - v * delay
            e = left / wp.sqrt(size)
            error += with_error / size * left
            delay += with_delay / size * left
            variance -= with_error * with_error / size
            cross -= with_error * with_delay / size
            variance_delay -= with_delay * with_delay / size
            total += wp.log(size)
        angle[row, k] = e
        error *= keep
        delay *= keep_delay
        variance = keep * keep * variance + (one - keep * keep) * first
        cross *= keep * keep_delay
        fresh = one - keep_delay * keep_delay
        variance_delay = keep_delay * keep_delay * variance_delay + fresh * second
    logarithm[row] = total


class SlowNoise:
    """The noise of traces, each with its slow errors, on a device."""

    def __init__(self, traces: Sequence[Trace], device: str = "cpu") -> None:
        (_, _, length, *_), position, _ = padded(traces)
        self.weight, speed = np.ones(position.shape), np.zeros(position.shape)
        for s, trace in enumerate(traces):
            self.weight[s, : trace.t.size] = 1 / trace.noise_ratio
            speed[s, : trace.t.size] = trace.speed()
        process = np.array([trace.slow.process(trace.period_s) for trace in traces if trace.slow])
        arrays = length, position, self.weight, speed, process
        self.device, self._inputs = device, [to_warp(x, device) for x in arrays]

    def whiten(self, signal: Any, angle: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
        """Whiten weighted rows (N, T) of traces (N,); sums of logarithms of variances, (N,)."""
        logarithm: Any = wp.zeros(len(signal), dtype=wp.float64, device=self.device)
        inputs = [signal, *self._inputs, angle, logarithm]
        wp.launch(_whiten, len(signal), inputs, device=self.device)
        return logarithm


def slow_errors(
    traces: Sequence[Trace], residual: Array, noise_rad: float, *, log_sd: float = 1.0
) -> SlowErrors:
    """The most probable slow errors of what a servo leaves of its recordings, (R, T) in rad.

    ``noise_rad`` is the white noise at rest. Sizes and times are lognormal a priori, ``log_sd``
    being the standard deviation of the logarithm.
    """
    usual = np.array(astuple(SlowErrors(noise_rad))[1:])
    signal = to_warp(np.arange(len(traces), dtype=np.int32), "cpu")

    def loss(change: Array) -> float:
        slow = SlowErrors(noise_rad, *(usual * np.exp(change)).tolist())
        noise = SlowNoise([replace(trace, slow=slow) for trace in traces])
        angle = to_warp(residual[: len(traces)] * noise.weight, "cpu")
        logarithms = noise.whiten(signal, angle).numpy()
        energy = float(np.sum(angle.numpy() ** 2)) / noise_rad**2
        return 0.5 * float(energy + logarithms.sum() + np.sum(change**2) / log_sd**2)

    simplex = 0.7 * np.eye(5, 4, -1)
    options = {"initial_simplex": simplex, "maxfev": 100, "xatol": 0.05, "fatol": 0.5}
    found = minimize(loss, simplex[0], method="Nelder-Mead", options=options)
    return SlowErrors(noise_rad, *(usual * np.exp(found.x)).tolist())
