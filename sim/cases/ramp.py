"""A gradual start: after a sudden one pressure waves persist in a box with walls."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.fluid.fluid import Fluid


class Ramp:
    """Raises a fluid's inlets and moving walls from rest to their velocity, along a cosine."""

    def __init__(self, fluid: Fluid, steps: int) -> None:
        """Stop the walls of ``fluid``; they have their velocity after ``steps`` steps."""
        self._fluid, self._steps = fluid, steps
        self._velocity: Any = fluid.wall_velocity.numpy().copy()
        self.at(0)

    def at(self, step: int) -> None:
        """Set the velocity of the walls at this step; does nothing after the ramp."""
        if step <= self._steps:
            share = 0.5 - 0.5 * np.cos(np.pi * step / self._steps)
            self._fluid.wall_velocity.assign((share * self._velocity).astype(np.float32))
