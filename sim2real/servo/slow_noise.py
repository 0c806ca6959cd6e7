"""Noise that includes slow errors of a law (``SlowErrors``): whitening, and how large they are.

A law that is nearly right is wrong by milliradians for as long as friction holds a shaft, and by
milliseconds for as long as a bus is late. Taken for white noise, these errors let hundreds of
readings at rest speak for whatever happens to have their shape.
"""

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import warp as wp
from scipy.optimize import minimize

from sim2real.arrays import Array
from sim2real.inference.correlated_noise import SlowErrors
from sim2real.servo import whitening
from sim2real.servo.rollout import padded, to_warp, zeros
from sim2real.servo.trace import Trace


class SlowNoise:
    """The noise of traces, each with its slow errors."""

    def __init__(self, traces: Sequence[Trace]) -> None:
        (_, _, length, *_), position, _ = padded(traces)
        self.weight, speed = np.ones(position.shape), np.zeros(position.shape)
        for s, trace in enumerate(traces):
            self.weight[s, : trace.t.size] = 1 / trace.noise_ratio
            speed[s, : trace.t.size] = trace.speed()
        process = np.array([trace.slow.process(trace.period_s) for trace in traces if trace.slow])
        arrays = length, position, self.weight, speed, process
        self._inputs = [to_warp(x) for x in arrays]

    def whiten(self, signal: Any, angle: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
        """Whiten weighted rows (N, T) of traces (N,); sums of logarithms of variances, (N,)."""
        logarithm = zeros((len(signal),))
        inputs = [signal, *self._inputs, angle, logarithm]
        wp.launch(whitening.whiten_slow, len(signal), inputs, device="cpu")
        return logarithm


def slow_errors(
    traces: Sequence[Trace], residual: Array, noise_rad: float, *, log_sd: float = 1.0
) -> SlowErrors:
    """The most probable slow errors of what a servo leaves of its recordings, (R, T) in rad.

    ``noise_rad`` is the white noise at rest. Sizes and times are lognormal a priori, ``log_sd``
    being the standard deviation of the logarithm.
    """
    usual = np.array(astuple(SlowErrors(noise_rad))[1:])
    signal = to_warp(np.arange(len(traces), dtype=np.int32))

    def loss(change: Array) -> float:
        slow = SlowErrors(noise_rad, *(usual * np.exp(change)).tolist())
        noise = SlowNoise([replace(trace, slow=slow) for trace in traces])
        angle = to_warp(residual[: len(traces)] * noise.weight)
        logarithms = noise.whiten(signal, angle).numpy()
        energy = float(np.sum(angle.numpy() ** 2)) / noise_rad**2
        return 0.5 * float(energy + logarithms.sum() + np.sum(change**2) / log_sd**2)

    simplex = 0.7 * np.eye(5, 4, -1)
    options: Any = {"initial_simplex": simplex, "maxfev": 100, "xatol": 0.05, "fatol": 0.5}
    found = minimize(loss, simplex[0], method="Nelder-Mead", options=options)
    return SlowErrors(noise_rad, *(usual * np.exp(found.x)).tolist())
