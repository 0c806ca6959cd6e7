"""The figures that are forecast of a trial."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measure:
    """How a figure is shown and compared.

    Attributes:
        label: Name on pages, with its unit.
        unit: Its unit in files.
        better: 1 where more of it is better, else -1.
        digits: Format specification of its values.
    """

    label: str
    unit: str
    better: int
    digits: str


FIGURES = {
    "success": Measure("share that arrives", "", 1, ".2f"),
    "time_s": Measure("time (s)", "s", -1, ".2f"),
    "energy": Measure("energy (rad²/s²)", "rad2/s2", -1, ",.0f"),
    "reward": Measure("reward", "", 1, ".1f"),
    "path_m": Measure("path (m)", "m", -1, ".2f"),
}
"""The figures by name, in the order of tables; see ``rl.forecast.swims.measured``."""
