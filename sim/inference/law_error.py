"""Measured error of the twin, which counts as noise in a diagnosis.

``law_error.json`` has the error of a twin that was calibrated on a robot's swims, on other swims of
the same robot in which nothing is missing: relative to each signal by frequency band, and as the
size of each effect that it imitates; with the number of swims and robots that it was measured on.
``benchmarks/pool_law_error.py`` measures it on the nulls of development sets,
``benchmarks/pool_decisions.py`` chooses the thresholds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.inference.coordinates import Coordinates
from sim.inference.swim_decision import BANDS, ROWS, NameFeatures, UnlistedFeatures
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
_CURVES = {
    "odds": ("name", NameFeatures(*np.ones(12)).terms()),
    "strange": ("unlisted", UnlistedFeatures().terms(1.0)),
    "there": ("anything", UnlistedFeatures().terms(1.0)),
}
_NUMBERED = {
    f"{old} {k}": f"{curve}: {term}"
    for old, (curve, terms) in _CURVES.items()
    for k, term in enumerate(terms)
} | {
    f"usual misfit {k} {b}": f"usual misfit {row} {band}"
    for k, row in enumerate(ROWS)
    for b, band in enumerate(BANDS)
}
"""Present names of decisions that older files number."""


@dataclass(frozen=True)
class LawError:
    """Measured error of the twin.

    Attributes:
        shares: Error as a share of a signal's size, by signal (surge, sway, yaw rate, joints) and
            band (slow, beat, fast), shape (4, 3).
        imitated: By kind of column, the standard deviation between swims of one robot: of shapes
            of the error (``discrepancy``), or of servos, law and absent effects that it imitates.
        unknown: Standard deviation between robots, of the part common to a robot's swims.
        usual: Mean of the law's coefficients over robots.
        shift: Mean over robots of their difference from the nominal coefficients.
        decisions: Thresholds, and the weights of curves as ``curve: term``, by name.
    """

    shares: Array
    imitated: Mapping[str, float]
    unknown: Mapping[str, float]
    usual: Mapping[str, float]
    shift: Mapping[str, float]
    decisions: Mapping[str, float]

    def imitation(self, coordinates: Coordinates) -> Array:
        """Standard deviation of the error's imitation of each column, shape (F,)."""
        out = []
        for c in coordinates.columns:
            measured = c.kind in self.imitated
            out.append(self._size(self.imitated, c.kind, c.nominal) if measured else NEVER * c.step)
        return np.array(out)

    def prior(self, coordinates: Coordinates) -> tuple[Array, Array]:
        """Mean (F,) and covariance (F, F) for a swim of a robot without reference swims."""
        mean, sd = [], self.imitation(coordinates)
        for k, c in enumerate(coordinates.columns):
            mean.append(self.usual.get(c.kind, c.nominal + self.shift.get(c.kind, 0.0)))
            if c.kind in self.unknown:
                sd[k] = self._size(self.unknown, c.kind, c.nominal)
        return np.array(mean), np.diag(np.square(sd))

    @staticmethod
    def _size(sizes: Mapping[str, float], kind: str, nominal: float) -> float:
        """The value of a kind; that of a gain is relative to its nominal value."""
        value = sizes[kind]
        return value * abs(nominal) if kind in RELATIVE else value


def read_law_error(path: Path = FILE) -> LawError:
    """Read a file by ``benchmarks/pool_law_error.py``."""
    content = read_json(path, SCHEMA)
    shares = content["shares"]
    return LawError(
        shares=np.array([[shares[row][band] for band in BANDS] for row in ROWS], dtype=np.float64),
        imitated=content["imitated"],
        unknown=content["unknown"],
        usual=content["usual"],
        shift=content.get("shift", {}),
        decisions=named_decisions(content["decisions"]),
    )


def named_decisions(decisions: Mapping[str, float]) -> dict[str, float]:
    """Decisions by their present names.

    Older files number the weights ("odds 3") and lack newer thresholds, which are taken from the
    file of this package.
    """
    if not any(name in decisions for name in _NUMBERED):
        return dict(decisions)
    renamed = {_NUMBERED.get(name, name): value for name, value in decisions.items()}
    present: dict[str, float] = read_json(FILE, SCHEMA)["decisions"]
    return present | renamed


LAW_ERROR = read_law_error()
"""The error from the file of this package."""
