"""What other values of a number would decide: the decisions taken again from stored rows.

Of a number that hardly any decision turns on, another value is as good, and it need not be one.
``benchmarks.calibrate_decisions`` writes the table into ``reports/decisions.json``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim2real.diagnose.decision import Odds

Row = dict[str, Any]
Values = Mapping[str, float]
Said = dict[tuple[str, str], Any]
"""What is decided of each joint of each case."""

TRIED: Mapping[str, tuple[float, ...]] = {
    "link_gain": (0.0, 5.0, 10.0, 40.0),
    "link_shows": (2.0, 4.0, 8.0),
    "link_tie": (5.0, 10.0),
    "link_masked": (3.0, 5.0, 50.0, np.inf),
    "window_cost": (0.0, 15.0, 60.0),
    "window_second_cost": (0.0, 15.0, 30.0, 60.0),
    "window_share": (0.1, 0.3),
}
"""Other values; those of ``decision_rows.VARIED`` are tried there."""
ALIKE = 0.02
"""Share of the joints that may be decided otherwise for values to be called alike."""


def rules(values: Values) -> dict[str, float]:
    """The numbers, and what the rules of the diagnosis have in the place of those that it lacks."""
    sure = values["surely"]
    gone = {"link_gain": sure, "link_shows": 0.0, "link_tie": 0.0}
    gone |= {"window_cost": sure, "window_second_cost": sure, "window_share": 0.5}
    return {**gone, **values}


def sensitivity(rows: Sequence[Row], values: Values, odds: Mapping[str, Values]) -> Row:
    """For each number, by value, on how many of all joints it would be decided otherwise."""
    some = [row for row in rows if "links" in row]
    found: Row = {"joints": len(some)}
    now = rules(values)
    for name, tried in TRIED.items():
        decide = _links if name.startswith("link") else _windows
        usual = decide(some, now, odds)
        found[name] = {"value": now[name]}
        for value in tried:
            other = decide(some, {**now, name: value}, odds)
            found[name][f"{value:g}"] = sum(other[joint] != usual[joint] for joint in usual)
    for row in some:
        usual_said = _effects(row, row["varied"][""], odds["effect"])
        for label, entry in row["varied"].items():
            name, _, value = label.partition("=")
            if name in values:
                told = found.setdefault(name, {"value": values[name]})
                told.setdefault(value, 0)
                told[value] += _effects(row, entry, odds["effect"]) != usual_said
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
    """What would be named, the groups' probabilities and stabilities being these."""
    features = {group["members"][0]: group["features"] for group in row["groups"]}
    said = set()
    for members, p, stable in entry[1]:
        usual = features.get(members[0])
        if usual is None:
            continue
        odds = -float(np.log(np.clip(1 / np.clip(p, 0.02, 0.98) - 1, 1e-3, 1e3)))
        if Odds(weights).probability({**usual, "probability": odds, "stability": stable}) >= 0.5:
            said.add(members[0])
    return said


def _windows(rows: Sequence[Row], values: Values, odds: Mapping[str, Values]) -> Said:
    """Whether something is missing, and whether it has no name."""
    said: Said = {}
    for row in rows:
        length = row["windows"]
        gain = 0.0
        if length and sum(length) < values["window_share"] * row["length_s"]:
            gain = row["windows_gain"] - values["window_cost"] * len(length)
            gain -= values["window_second_cost"] * sum(length)
        whole = {**row["whole"], "windows": float(np.log1p(np.clip(gain, 0.0, 1e5)))}
        there = Odds(odds["there"]).probability(whole) >= values["there"]
        said[row["case"], row["joint"]] = there, Odds(odds["nameless"]).probability(whole) > 0.5
    return said


def _links(rows: Sequence[Row], values: Values, odds: Mapping[str, Values]) -> Said:
    """The effect on the link that is named, as ``diagnose.investigate`` looks for it."""
    said: Said = {}
    robots = defaultdict(list)
    for row in rows:
        robots[row["case"]].append(row)
    for case, joints in robots.items():
        uneven = _on_link(joints, values)
        for k, row in enumerate(joints):
            effect, share = uneven.get(k, ("", 0.0))
            size = np.clip(1 - np.exp(-share / row["count"]), 1e-2, 30.0)
            told = {"one": 1.0, "size": float(np.log(size))}
            sure = bool(effect) and Odds(odds["link"]).probability(told) >= 0.5
            said[case, row["joint"]] = effect if sure else ""
    return said


def _on_link(joints: Sequence[Row], values: Values) -> dict[int, tuple[str, float]]:
    links = joints[0]["links"]
    clear = [x < values["link_masked"] for x in links["excess"]]
    alone, beside = ({**links[name]} for name in ("plain", "best"))
    for found in (alone, beside):
        # What masked joints gain is left out.
        hidden = sum(x for x, seen in zip(found["shares"], clear, strict=True) if not seen)
        found["gain"] -= hidden
        found["gain"] *= found["gain"] >= values["link_gain"]
    if max(alone["gain"], beside["gain"]) <= 0:
        return {}
    shows = [x > values["link_shows"] for x in beside["shares"]]
    quiet = [
        one for one, row in zip(shows, joints, strict=True)
        if row["excess_plain"] <= values["structured"] and row["left"][0] <= row["left"][1]
    ]  # fmt: skip
    if (quiet and not any(quiet)) or (len(shows) > 1 and sum(shows) < 2):
        return {}
    found = {}
    for k, seen in enumerate(clear):
        ahead = beside["shares"][k] + links["own"][k] - values["link_tie"]
        link = alone if alone["shares"][k] > ahead and alone["gain"] > 0 else beside
        if seen and link["gain"] > 0:
            found[k] = link["effect"], link["shares"][k]
    return found
