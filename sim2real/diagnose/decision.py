"""Every number that decides a verdict or a name, as ``decision.json`` has it.

The file is written by ``benchmarks/calibrate_decisions.py`` from cases of the generators'
development seeds; beside each value it says what it was read from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from sim2real.diagnose.missing.screening import FITTED
from sim2real.structured import Fields, read_json

FILE = Path(__file__).with_name("decision.json")
SCHEMA = "sim2real.decision/1"
CURVES = ("effect", "there", "nameless", "link")
"""What there are odds of: an effect, anything missing, what has no name, an uneven link."""
_LARGEST = 40.0


@dataclass(frozen=True)
class Decision:
    """The numbers; gains and costs are in log-likelihood, excesses in variances of the noise."""

    false_alarms: float  # share of robots with nothing missing that may be called mismatched
    named: float  # probability from which an effect is named
    negligible: float  # share of the held-out error below whose change an effect does not matter
    group_share: float  # a rival this probable, relative to the likeliest, cannot be told from it
    missing_share: float  # share of joints that are expected to miss something; the prior
    prior_sd: float  # prior standard deviation of an effect's parameter, in typical values
    surely: float  # gain that is never left to chance, however uneven the noise
    law_error: float  # how far the law of an effect may be from what a servo does, relative to it
    most_certain: float  # no effect is more probable
    sure: float  # probability from which 0.9 and more is said; below it 0.89 at most
    there: float  # probability from which something is missing, named or not
    structured: float  # excess from which a residual is more than noise and slow wander
    clean: float  # excess below which nothing is left, and nothing without a name is looked for
    ripple: float  # what every servo has a little of is a finding from so many noises on
    crystals: float  # relative difference of two clocks up to which it is none, and is taken off
    turn_s: float  # jitter below which a set-point only waits for the controller's next turn
    sheet: float  # share of what a data sheet states from which a limit is the data sheet's own
    drawing: float  # share of the stated inertia by which a drawing may be off
    coarser: float  # step of a sensor, relative to the stated one, from which it is a finding
    change_retuned: float  # log odds that a plain parameter was set anew, not that an effect came
    change_farthest: float  # prior standard deviation of a change, in multiples of its start
    nameless: float  # probability that what is missing has no name, where effects leave most of it
    change_law_error: float  # how far a straight line to a change may be from what it does
    change_explained: float  # share of what changed that names must explain, or it has none
    change_worth: float  # evidence below which no change will be named, however well it fits
    detection_gain: float  # gain at which an effect is noticed
    search_substeps: float  # sub-steps of rollouts after which the search on a joint goes no wider


@dataclass(frozen=True)
class Odds:
    """A logistic curve: the log odds are the sum of features times their weights.

    Attributes:
        weights: By feature; that of one the curve does not know is 0.
    """

    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float]) -> float:
        """That it is so."""
        odds = sum(self.weights.get(name, 0.0) * value for name, value in features.items())
        return float(1 / (1 + np.exp(-np.clip(odds, -_LARGEST, _LARGEST))))


def read_decision(path: Path = FILE) -> Decision:
    """The decisions of a file.

    Raises:
        InputError: If one is missing or no number.
    """
    values = Fields(path, "", read_json(path, SCHEMA)).table("values")
    return Decision(
        **{field.name: values.table(field.name).number("value") for field in fields(Decision)}
    )


def read_odds(path: Path = FILE) -> dict[str, Odds]:
    """The curves of a file, by what they are the odds of.

    Raises:
        InputError: If a weight is no number.
    """
    table = Fields(path, "", read_json(path, SCHEMA)).table("odds")
    curves = {name: table.table(name) for name in CURVES}
    return {
        name: Odds({feature: weights.number(feature) for feature in weights.content})
        for name, weights in curves.items()
    }


DECISION = read_decision()
"""Those that ship."""
ODDS = read_odds()
"""The curves that ship."""
LOG_PRIOR = float(np.log(DECISION.missing_share / len(FITTED)))
"""Logarithm of the prior odds of each effect."""
