"""An angle sensor coarser than its data sheet says: read off the recorded numbers themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.noise import quantization_step
from sim2real.servo.trace import Trace

COARSER = 1.5
"""A step so many times the stated one is a finding."""


def coarse_step(traces: Sequence[Trace], stated_rad: float) -> float | None:
    """The step on which all of a joint's angles lie, where it is well above the stated one, rad.

    Args:
        traces: The joint's recordings.
        stated_rad: ``position_step_rad`` of the data sheet.
    """
    steps = [quantization_step(np.where(t.used, t.position, np.nan)) for t in traces]
    found = min(steps)
    if found <= COARSER * stated_rad or max(steps) > 1.1 * found:
        return None
    return found
