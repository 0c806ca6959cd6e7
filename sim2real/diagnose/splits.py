"""A plain servo fitted without a part of the recordings: what it does there and on the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.directions import simulated
from sim2real.diagnose.heldout import Unseen, folds
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """A servo on one recording.

    Attributes:
        recording: Index of the recording among the joint's.
        trace: The recording; ``used`` tells which samples belong to this side of the split.
        angle: Simulated angle in rad, shape (T,).
    """

    recording: int
    trace: Trace
    angle: Array

    @property
    def residual(self) -> Array:
        """Simulated minus measured angle in rad where used, shape (used,)."""
        used = self.trace.used
        return np.asarray(self.angle[used] - self.trace.position[used])


@dataclass(frozen=True)
class Split:
    """A fold: the servo fitted to one side of it, on both sides.

    Attributes:
        theta: Its parameters, shape (P,).
        fitted: The side that was fitted.
        scored: The side that the fit has not seen.
    """

    theta: Array
    fitted: tuple[Simulated, ...]
    scored: tuple[Simulated, ...]


def splits(traces: Sequence[Trace], unseen: Unseen) -> list[Split]:
    """The folds of ``held_out`` with simulations of both sides."""
    place = {id(trace): k for k, trace in enumerate(traces)}

    def side(given: Sequence[Trace], theta: Array) -> tuple[Simulated, ...]:
        return tuple(
            # Of a lone recording there are two copies, one a side.
            Simulated(place.get(id(one), 0), one, simulated(one, theta[None])[0])
            for one in given
        )

    return [
        Split(theta, side(fitted, theta), side(scored, theta))
        for (fitted, scored), theta in zip(folds(traces), unseen.theta, strict=True)
    ]


def rms(residuals: Sequence[Array]) -> float:
    """Root mean square of all of them together."""
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
