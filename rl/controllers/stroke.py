"""How a controller that only steers swims: a steady wave, bent to one side to turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rl.controllers.cpg import CentralPatternGenerator, Gait


@dataclass(frozen=True)
class Stroke:
    """The wave and its bend; each value a number or one for each robot (E,).

    Attributes:
        frequency_hz: Beats a second.
        amplitude_rad: Amplitude of the last joint.
        front: Amplitude of the first joint, as a share of the last's.
        lag_rad: Phase by which a joint follows the one before it.
        bend_rad: Largest offset.
        ease: Share of the amplitude given up in the largest bend.
    """

    frequency_hz: ArrayLike
    amplitude_rad: ArrayLike
    front: ArrayLike
    lag_rad: ArrayLike
    bend_rad: ArrayLike
    ease: ArrayLike

    def bent(self, turn: NDArray[np.float64]) -> Gait:
        """The wave about an offset of ``turn`` in rad, shape (E,), positive to the left."""
        most = np.asarray(self.bend_rad, dtype=np.float64)
        offset = np.clip(turn, -most, most)
        kept = 1.0 - np.asarray(self.ease) * np.abs(offset) / most
        return Gait(
            frequency_hz=self.frequency_hz,
            amplitude_rad=np.asarray(self.amplitude_rad) * kept,
            front=self.front,
            lag_rad=self.lag_rad,
            offset_rad=-offset,
        )


def begin(
    generator: CentralPatternGenerator,
    mask: NDArray[np.bool_],
    left: NDArray[np.bool_],
    observation: NDArray[np.floating],
) -> None:
    """Robots in ``mask`` begin from the angles they have, the first beat to their target's side.

    So a robot whose target is mirrored swims the mirrored path. ``mask`` and ``left`` (E,).
    """
    n_joints = generator.phase.shape[1]
    generator.reset(mask, np.where(left, np.pi, 0.0), observation[:, 3 : 3 + n_joints])
