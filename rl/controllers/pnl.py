"""Proportional navigation with a central pattern generator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rl.controllers.cpg import CentralPatternGenerator
from rl.controllers.guidance import LineOfSight
from rl.controllers.stroke import Stroke, begin
from rl.controllers.tuned import tuned
from rl.task import CONTROL_S
from sim2real.arrays import Array32, Mask


@dataclass(frozen=True)
class PNLGains(Stroke):
    """Gains; each a number or an array (E,).

    Attributes:
        navigation_s: Bend per angular rate of the line of sight, in s.
        pursuit: Bend per rad of bearing.
        filter_s: Time constant of the filter that averages over the tail's beat, in s.
    """

    navigation_s: ArrayLike
    pursuit: ArrayLike
    filter_s: ArrayLike


class ProportionalNavigation:
    """The controller "PNL" of the paper: the bend follows the line of sight.

    Proportional navigation (Guelman, IEEE Trans. Aerosp. Electron. Syst. 7 (1971) 364) turns the
    velocity in proportion to the rate of the line of sight; at constant frequency the yaw rate of a
    fish is about proportional to its bend, so the bend is the command. For a target directly behind
    the rate of the line of sight is zero; a gain on the bearing makes the 180 degree turn start::

        turn = navigation_s * line_of_sight_rate + pursuit * bearing

    Attributes:
        gains: Gains.
    """

    def __init__(
        self,
        limits_rad: ArrayLike,
        n_envs: int = 1,
        gains: PNLGains | None = None,
        *,
        dt: float = CONTROL_S,
    ) -> None:
        """Arguments as for ``CentralPatternGenerator``; default: the tuned ``gains``."""
        self.gains = tuned("pnl", PNLGains) if gains is None else gains
        self._generator = CentralPatternGenerator(limits_rad, n_envs, dt=dt)
        self._sight = LineOfSight(n_envs, self.gains.filter_s, dt=dt)
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask
        self._sight.reset(mask)

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        sight, gains = self._sight, self.gains
        sight.update(observation)
        if self._fresh.any():
            begin(self._generator, self._fresh, sight.bearing > 0, observation)
            self._fresh[:] = False
        turn = np.asarray(gains.navigation_s) * sight.rate
        turn = turn + np.asarray(gains.pursuit) * sight.smooth
        return self._generator.step(gains.bent(turn)).astype(np.float32)
