"""The swimming stroke of the classical controllers: a steady wave with a bend for turning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rl.controllers.cpg import CentralPatternGenerator, Gait
from sim2real.arrays import Array, Mask


@dataclass(frozen=True)
class Stroke:
    """The wave and its bend; each value a number or an array (E,).

    Attributes:
        frequency_hz: Beats per second.
        amplitude_rad: Amplitude of the last joint.
        front: Amplitude of the first joint relative to the last.
        lag_rad: Phase lag of a joint relative to the previous one.
        bend_rad: Largest offset.
        ease: Relative reduction of the amplitude at the largest bend.
    """

    frequency_hz: ArrayLike
    amplitude_rad: ArrayLike
    front: ArrayLike
    lag_rad: ArrayLike
    bend_rad: ArrayLike
    ease: ArrayLike

    def bent(self, turn: Array) -> Gait:
        """The wave about an offset of ``turn`` in rad, shape (E,), positive to the left."""
        largest = np.asarray(self.bend_rad, dtype=np.float64)
        offset = np.clip(turn, -largest, largest)
        share = 1.0 - np.asarray(self.ease) * np.abs(offset) / largest
        return Gait(
            frequency_hz=self.frequency_hz,
            amplitude_rad=np.asarray(self.amplitude_rad) * share,
            front=self.front,
            lag_rad=self.lag_rad,
            offset_rad=-offset,
        )


def begin(
    generator: CentralPatternGenerator, mask: Mask, left: Mask, observation: NDArray[np.floating]
) -> None:
    """Reset robots in ``mask`` to their present angles, with the first beat towards the target.

    Mirrored targets thus give mirrored paths. ``mask`` and ``left`` have shape (E,).
    """
    n_joints = generator.phase.shape[1]
    generator.reset(mask, np.where(left, np.pi, 0.0), observation[:, 3 : 3 + n_joints])
