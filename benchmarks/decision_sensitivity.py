"""What other values of a number would decide: the decisions taken again from stored rows.

Of a number that hardly any decision turns on, another value is as good, and it need not be one.
``benchmarks.calibrate_decisions`` writes the table into ``reports/decisions.json``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim2real.diagnose.decision import Odds

Row = dict[str, Any]
Values = Mapping[str, float]

ALIKE = 0.02
"""Share of the joints that may be decided otherwise for values to be called alike."""


def sensitivity(rows: Sequence[Row], values: Values, weights: Values) -> Row:
    """For each number of ``decision_rows.VARIED``, on how many joints it would name otherwise."""
    some = [row for row in rows if "varied" in row]
    found: Row = {"joints": len(some)}
    for row in some:
        usual = _effects(row, row["varied"][""], weights)
        for label, entry in row["varied"].items():
            name, _, value = label.partition("=")
            if name:
                told = found.setdefault(name, {"value": values[name]})
                told[value] = told.get(value, 0) + (_effects(row, entry, weights) != usual)
    return found


def alike(name: str, found: Row) -> str:
    """Between which values hardly any decision differs, as words; empty where any other does."""
    told = {float(x): count for x, count in found.get(name, {}).items() if x != "value"}
    most = ALIKE * found["joints"]
    turned = {x: count for x, count in told.items() if count <= most}
    if not turned or not found["joints"]:
        return ""
    values = [*turned, float(found[name]["value"])]
    ends = f"from {min(values):g} to {max(values):g} at most {max(turned.values())}"
    return f"{ends} of {found['joints']} joints would be decided otherwise"


def _effects(row: Row, entry: Sequence[Any], weights: Values) -> set[str]:
    """What would be named, the groups' probabilities being these."""
    features = {group["members"][0]: group["features"] for group in row["groups"]}
    said = set()
    for members, p, *_ in entry[1]:
        usual = features.get(members[0])
        if usual is None:
            continue
        odds = -float(np.log(np.clip(1 / np.clip(p, 0.02, 0.98) - 1, 1e-3, 1e3)))
        if Odds(weights).probability({**usual, "probability": odds}) >= 0.5:
            said.add(members[0])
    return said
