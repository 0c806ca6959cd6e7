"""Every number that decides a verdict or a name: its value, what it is, and why, in a file.

Gains and costs in ``decision.json`` are in log-likelihood, excesses in variances of the noise.
``benchmarks/calibrate_decisions.py`` writes the file from development cases and keeps values that
are "chosen". A number of a group is stored as ``group.name``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim2real.diagnose.screening import FITTED
from sim2real.structured import Fields, read_json

FILE = Path(__file__).with_name("decision.json")
SCHEMA = "sim2real.decision/1"
CURVES = ("effect", "mismatch", "uncatalogued", "link")
"""What a curve is the odds of: an effect, any mismatch, a mismatch that no effect of the catalogue
explains, irregular command timing."""


class Numbers:
    """Numbers by name."""

    def __getattr__(self, name: str) -> float:
        """Refuse a name that the file does not have."""
        raise AttributeError(f"{FILE.name} has no number {name!r}")


class Decision(Numbers):
    """The numbers that decide what is missing, and groups of further ones."""

    change: Numbers  # what has changed since the reference recordings
    link: Numbers  # whether set-points arrive at irregular times
    report: Numbers  # what is listed, and with which words


@dataclass(frozen=True)
class Odds:
    """A logistic curve: the log odds are the sum of features times their weights, by name."""

    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float], largest_log_odds: float = 40.0) -> float:
        """Probability by the curve; ValueError unless features and weights have the same names.

        Log odds are clipped to what a float distinguishes.
        """
        unmatched = sorted(features.keys() ^ self.weights.keys())
        if unmatched:
            raise ValueError(f"features and weights differ: {', '.join(unmatched)}")
        odds = sum(self.weights[name] * value for name, value in features.items())
        return float(1 / (1 + np.exp(-np.clip(odds, -largest_log_odds, largest_log_odds))))


def read_decision(path: Path = FILE) -> Decision:
    """The decisions of a file; InputError if one is no number."""
    values, found = Fields(path, "", read_json(path, SCHEMA)).table("values"), Decision()
    for name in values.content:
        group, _, own = name.rpartition(".")
        numbers = vars(found).setdefault(group, Numbers()) if group else found
        setattr(numbers, own, values.table(name).number("value"))
    return found


def read_odds(path: Path = FILE) -> dict[str, Odds]:
    """The curves of a file, by what they are the odds of; InputError if a weight is no number."""
    table = Fields(path, "", read_json(path, SCHEMA)).table("odds")
    weights = {name: table.table(name) for name in CURVES}
    return {name: Odds({x: one.number(x) for x in one.content}) for name, one in weights.items()}


DECISION = read_decision()
ODDS = read_odds()
LOG_PRIOR = float(np.log(DECISION.missing_share / len(FITTED)))
"""Logarithm of the prior odds of each effect."""
