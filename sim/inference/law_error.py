"""Measured error of the twin, which counts as noise in a diagnosis, and the thresholds.

The error of a twin that was calibrated on a robot's swims, on other swims of the same robot in
which nothing is missing: ``benchmarks/pool_law_error.py``, ``benchmarks/pool_decisions.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.inference.coordinates import Coordinates
from sim.inference.swim_decision import BANDS, ROWS
from sim.inference.swim_problem import SwimPrior
from sim2real.arrays import Array
from sim2real.structured import read_json

FILE = Path(__file__).with_name("law_error.json")
IN_WATER = Path(__file__).with_name("law_error_in_water.json")
"""The error of a twin that is corrected by the fluid (``in_water``)."""
SCHEMA = "sim2real.law_error/1"
RELATIVE = ("servo.kp_Nm_per_rad", "servo.kd_Nms_per_rad")
"""Kinds of columns whose sizes are relative to their values."""
NEVER = 1e-3
"""Standard deviation of columns that the error does not imitate, in steps of derivatives."""


@dataclass(frozen=True)
class LawError:
    """Measured error of the twin."""

    # error as a share of a signal's size, by signal (surge, sway, yaw rate, joints) and band (slow,
    # beat, fast), shape (4, 3)
    shares: Array
    # by kind of column, the standard deviation between swims of one robot: of shapes of the error
    # (``signal_error``), or of servos, law and absent effects that it imitates
    imitated: Mapping[str, float]
    # standard deviation between robots, of the part common to a robot's swims
    unknown: Mapping[str, float]
    usual: Mapping[str, float]  # mean of the law's coefficients over robots
    shift: Mapping[str, float]  # mean over robots of their difference from the nominal coefficients
    # thresholds, and the weights of curves as ``curve: term``, by name
    decisions: Mapping[str, float]

    def prior(self, coordinates: Coordinates) -> SwimPrior:
        """Prior of a swim of a robot without reference swims."""
        columns, never = coordinates.columns, NEVER * coordinates.each("step")

        def sizes(table: Mapping[str, float], others: Array) -> Array:
            """The size of each column; that of a gain is relative to its nominal value."""
            scale = [abs(c.nominal) if c.kind in RELATIVE else 1.0 for c in columns]
            known = [c.kind in table for c in columns]
            return np.where(
                known, scale * np.array([table.get(c.kind, 0) for c in columns]), others
            )

        imitation = sizes(self.imitated, never)
        mean = [self.usual.get(c.kind, c.nominal + self.shift.get(c.kind, 0.0)) for c in columns]
        covariance = np.diag(np.square(sizes(self.unknown, imitation)))
        return SwimPrior(np.array(mean), covariance, imitation, self.shares)


def read_law_error(path: Path = FILE) -> LawError:
    """Read a file by ``benchmarks/pool_law_error.py``."""
    content = read_json(path, SCHEMA)
    shares = [[content["shares"][row][band] for band in BANDS] for row in ROWS]
    names = ("imitated", "unknown", "usual", "shift", "decisions")
    return LawError(np.array(shares, dtype=np.float64), *(content[name] for name in names))


LAW_ERROR = read_law_error()
"""The error from the file of this package."""
