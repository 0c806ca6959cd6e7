"""How wrong the twin is, as it was measured: its error is a part of the noise.

``law_error.json`` says what a twin that was calibrated on a robot's swims still gets wrong of
another swim of the same robot in which nothing is missing, and from how many swims of how many
robots that is known: the share of each signal, by band of frequency, and how much of each effect
it imitates. ``benchmarks/pool_law_error.py`` learns them from the nulls of development sets,
``pool_decisions.py`` chooses what decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.inference.coordinates import Coordinates
from sim.inference.swim_decision import BANDS, ROWS, NameFeatures, UnlistedFeatures
from sim2real.structured import read_json

Array = NDArray[np.float64]

FILE = Path(__file__).with_name("law_error.json")
IN_WATER = Path(__file__).with_name("law_error_in_water.json")
"""The same of a twin that the fluid puts right (``in_water``)."""
SCHEMA = "sim2real.law_error/1"
RELATIVE = ("servo.kp_Nm_per_rad", "servo.kd_Nms_per_rad")
"""Kinds of columns whose sizes are shares of their values."""
NEVER = 1e-3
"""Standard deviation of what the error does not pass for, in steps of a derivative."""
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
"""Present names of numbers that older files number."""


@dataclass(frozen=True)
class LawError:
    """What is known of the twin's error.

    Attributes:
        shares: Error as a share of a signal's size, by signal (surge, sway, yaw rate, joints) and
            band (slow, beat, fast), shape (4, 3).
        imitated: By kind of column, the standard deviation from one swim of a robot to another: of
            shapes of the error (``discrepancy``), or of what it passes for, be it servos, law or
            effects that are not there.
        unknown: The same of a robot that was never seen, where its swims have it in common.
        usual: Mean of the law's coefficients over robots.
        shift: Mean over robots of how far they are from the nominal ones.
        decisions: Thresholds, and the weights of curves as ``curve: term``, by name.
    """

    shares: Array
    imitated: Mapping[str, float]
    unknown: Mapping[str, float]
    usual: Mapping[str, float]
    shift: Mapping[str, float]
    decisions: Mapping[str, float]

    def imitation(self, coordinates: Coordinates) -> Array:
        """Standard deviation of what the error passes for in each column, shape (F,)."""
        out = []
        for c in coordinates.columns:
            known = c.kind in self.imitated
            out.append(self._of(self.imitated, c.kind, c.nominal) if known else NEVER * c.step)
        return np.array(out)

    def prior(self, coordinates: Coordinates) -> tuple[Array, Array]:
        """Mean (F,) and covariance (F, F) of a swim of a robot that was never seen."""
        mean, sd = [], self.imitation(coordinates)
        for k, c in enumerate(coordinates.columns):
            mean.append(self.usual.get(c.kind, c.nominal + self.shift.get(c.kind, 0.0)))
            if c.kind in self.unknown:
                sd[k] = self._of(self.unknown, c.kind, c.nominal)
        return np.array(mean), np.diag(np.square(sd))

    @staticmethod
    def _of(known: Mapping[str, float], kind: str, nominal: float) -> float:
        """A gain's is relative."""
        value = known[kind]
        return value * abs(nominal) if kind in RELATIVE else value


def read_law_error(path: Path = FILE) -> LawError:
    """That of a file, as ``benchmarks/pool_law_error.py`` writes it."""
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

    Files of before the weights had names number them ("odds 3"), and lack the thresholds that were
    not in the file then: those are taken from the file that ships.
    """
    if not any(name in decisions for name in _NUMBERED):
        return dict(decisions)
    renamed = {_NUMBERED.get(name, name): value for name, value in decisions.items()}
    return {**read_json(FILE, SCHEMA)["decisions"], **renamed}


LAW_ERROR = read_law_error()
"""That which ships."""
