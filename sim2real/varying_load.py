"""A load on an output shaft that varies with time, as the other joints of an arm cause it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim2real.arrays import Array


@dataclass(frozen=True)
class VaryingLoad:
    """Inertia and torque of a load at evenly spaced times, linear between them.

    Attributes:
        start_s: Time of the first value, on the clock of the recording.
        step_s: Time between values.
        inertia_kgm2: Inertia about the shaft, shape (K,), K at least 2.
        torque_Nm: Torque on the shaft, gravity included, shape (K,).
    """

    start_s: float
    step_s: float
    inertia_kgm2: Array
    torque_Nm: Array

    @cached_property
    def mean_inertia_kgm2(self) -> float:
        """Mean inertia, which stands for the load where a single number is needed."""
        return float(np.mean(self.inertia_kgm2))
