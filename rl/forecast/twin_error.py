"""Error of energy in forecasts by the twin, learned from trials in several waters.

``twin_error.json`` is made by ``benchmarks/forecast_realities.py``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).with_name("twin_error.json")


@dataclass(frozen=True)
class TwinError:
    """Error of forecasts by the twin.

    Attributes:
        energy: Mean and standard deviation over realities of the logarithm of real energy over that
            forecast.
    """

    energy: tuple[float, float]


def read_twin_error(path: Path = FILE) -> TwinError:
    """Read the file."""
    energy = json.loads(path.read_text())["energy"]
    return TwinError((energy["mean"], energy["sd"]))


TWIN_ERROR = read_twin_error()
"""The error from the file of this package."""
