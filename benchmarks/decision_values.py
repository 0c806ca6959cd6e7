"""Numbers that are read off what cases of known answer show: see ``calibrate_decisions``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim2real.effects import CATALOGUE

Row = dict[str, Any]
Reading = tuple[float, int, str]
"""A value, how many joints it was read off, and how."""

FEWEST = 20
UNFITTED = frozenset(e.name for e in CATALOGUE if not e.fitted)


def values_of(rows: Sequence[Row]) -> dict[str, Reading]:
    """Numbers that are quantiles of what was measured where nothing is missing."""
    nothing = [row for row in rows if row["kind"] in ("null", "trap")]
    excess = [row["excess_plain"] for row in nothing]
    found = {}
    if len(excess) >= FEWEST:
        found["structured_excess"] = (
            max(float(np.quantile(excess, 0.99)), 1.05), len(excess),
            "99 % of joints that miss nothing leave less",
        )  # fmt: skip
        found["noise_like_excess"] = (
            max(float(np.quantile(excess, 0.9)), 1.02), len(excess),
            "90 % of joints that miss nothing leave less",
        )  # fmt: skip
    return found | _of_gains(rows)


def of_sensors(rows: Sequence[Row]) -> dict[str, Reading]:
    """From which step on a sensor is coarser than stated, and how sure that is."""
    coarse = [row["step"] for row in rows if "encoder_quantization" in row["truth"]]
    fine = [row["step"] for row in rows if "encoder_quantization" not in row["truth"]]
    if len(coarse) < FEWEST / 4:
        return {}
    middle = np.sqrt(float(np.quantile(fine, 0.995)) * float(np.quantile(coarse, 0.02)))
    level = float(np.clip(middle, 1.2, 3.0))
    right, wrong = sum(x > level for x in coarse), sum(x > level for x in fine)
    why = f"{right} of {right + wrong} found are there; the rule of succession"
    return {
        "coarse_step_ratio": (level, len(coarse), "between sensors as stated and coarser"),
        "most_certain": ((right + 1) / (right + wrong + 2), right + wrong, why),
    }


def _of_gains(rows: Sequence[Row]) -> dict[str, Reading]:
    """The gain at which half of the effects that are there alone are named."""
    seen = [
        (row["alone"].get(effect, 0.0), any(effect in m and p >= 0.5 for m, p in row["said"]))
        for row in rows if row["kind"] == "single" and "alone" in row for effect in row["truth"]
        if effect not in UNFITTED
    ]  # fmt: skip
    y = np.array([named for _, named in seen], dtype=float)
    if min(y.sum(), (1 - y).sum()) < FEWEST / 2:
        return {}
    gain = np.log1p(np.maximum([g for g, _ in seen], 0.0))
    # Where most that gain less are not named and most that gain more are.
    order = np.argsort(gain)
    wrong = np.cumsum(np.append(0, y[order])) + np.cumsum(np.append(0, 1 - y[order][::-1]))[::-1]
    edges = np.concatenate([gain[order][:1], gain[order]])
    half = float(np.expm1(edges[int(wrong.argmin())]))
    return {"detection_gain": (half, y.size, "half of the single effects that gain this are named")}
