"""Error of forecasts by the twin, learned from trials in several waters.

``twin_error.json`` is made by ``benchmarks/forecast_law.py``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).with_name("twin_error.json")


@dataclass(frozen=True)
class TwinError:
    """Error of forecasts by the twin.

    Attributes:
        prior: Standard deviation of the law's coefficients about those fitted to the fluid, as a
            share of these.
        swim: By coefficient, the root mean square error of its calibration on one swim, which has
            the twin's errors in that swim besides the noise of the calibration.
        energy: Mean and standard deviation over realities of the logarithm of real energy over that
            forecast.
    """

    prior: float
    swim: Mapping[str, float]
    energy: tuple[float, float]


def read_twin_error(path: Path = FILE) -> TwinError:
    """Read the file."""
    content = json.loads(path.read_text())
    energy = content["energy"]
    return TwinError(content["prior"], content["swim"], (energy["mean"], energy["sd"]))


TWIN_ERROR = read_twin_error()
"""The error from the file of this package."""
