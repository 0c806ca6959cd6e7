"""Sums of squared innovations of many servos at once, for sampling posteriors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from sim2real.servo.rollout import Simulator, to_warp
from sim2real.servo.trace import Trace
from sim2real.servo.whitening import innovation_energy

Array = NDArray[np.float64]

_LANES = 4
"""Coefficients of the autoregression are padded to a multiple of this."""


class WhitenedServo(Simulator):
    """Recordings of one joint with a fixed noise model, for servos with any parameters."""

    def __init__(
        self,
        traces: Sequence[Trace],
        counts: Sequence[NDArray[np.bool_]],
        autoregression: Array,
        substep_s: float = np.inf,
        threads: int = 2,
    ) -> None:
        """Copy recordings and noise model to Warp arrays.

        Args:
            traces: The recordings.
            counts: Mask of the samples whose innovations count, one array (T,) per recording.
            autoregression: The noise model, shape (p,).
            substep_s: Longest sub-step in s, the same for all servos, so that the sums are smooth
                functions of the parameters; infinite for the exact solution of linear servos.
            threads: CPU threads.
        """
        super().__init__(traces, threads)
        self.substep_s = substep_s
        p = autoregression.size
        counted = np.zeros(self.position.shape, dtype=np.int32)
        for s, mask in enumerate(counts):
            counted[s, : mask.size] = mask
        self._counts = to_warp(counted, "cpu")
        self._noise = (p, to_warp(np.pad(autoregression, (0, -p % _LANES if p else _LANES)), "cpu"))

    def energy(self, theta: Array) -> Array:
        """Sum of squared innovations in rad2 of servos (B, P), shape (B,).

        Each sum is independent of the other rows to the last bit.
        """
        parts = [part for part in np.array_split(theta, self.threads) if part.size]
        sums = np.concatenate(list(self._pool.map(self._energy, parts)))
        return np.asarray(sums.reshape(theta.shape[0], -1).sum(axis=1))

    def _energy(self, theta: Array) -> Array:
        """Sums of a part of the servos, one per servo and recording."""
        angle = self.run(theta, self.substep_s)
        sums: Any = wp.zeros(angle.shape[0], dtype=wp.float64, device="cpu")
        lags, coefficients = self._noise
        inputs = [len(self.traces), lags, self.length, self.position, self._counts, coefficients]
        wp.launch(
            innovation_energy,
            dim=angle.shape[0],
            inputs=[*inputs, angle],
            outputs=[sums],
            device="cpu",
        )
        energies: Array = sums.numpy()
        return energies
