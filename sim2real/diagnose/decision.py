"""Every number that decides a verdict or a name, as ``decision.json`` has it.

The file is written by ``benchmarks/calibrate_decisions.py`` from cases of the generators'
development seeds; beside each value it says what it was read from. Values that no data could give
say "chosen", and why: a calibration keeps them. A number of a group stands as ``group.name``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from sim2real.diagnose.missing.screening import FITTED
from sim2real.structured import Fields, read_json

FILE = Path(__file__).with_name("decision.json")
SCHEMA = "sim2real.decision/1"
CURVES = ("effect", "there", "nameless", "link")
"""What there are odds of: an effect, anything missing, what has no name, an uneven link."""
T = TypeVar("T")


@dataclass(frozen=True)
class ChangeDecision:
    """Numbers that decide what has changed since the reference recordings."""

    retuned: float  # log odds that a plain parameter was set anew, not that an effect came
    farthest: float  # prior standard deviation of a change, in multiples of its start
    law_error: float  # how far a straight line to a change may be from what it does
    explained: float  # share of what changed that names must explain, or it has none
    min_evidence: float  # evidence below which no change will be named, however well it fits
    most_certain: float  # largest probability of a change that the recordings show only in part
    foreign_misfit: float  # misfit of the case, relative to the references', that no servo has
    misfit_ratio: float  # factor by which one explanation must fit better than another
    lasting_ratio: float  # residual after a jump, relative to before, that counts as lasting
    jitter_min_share: float  # share of a sampling period below which jitter does not count
    same_command: float  # difference of two commands, in standard deviations, below which equal
    same_command_lag_s: float  # largest shift in time at which two commands are compared
    same_command_overlap: float  # share of a recording that another one must cover
    slow_sampling_s: float  # sampling period above which servos are compared at rest only
    settling_samples: int  # samples after a set-point before a servo may be at rest
    rest_steps: float  # steps of the sensor between readings at rest, at most
    same_set_point_rad: float  # difference below which two set-points are one


@dataclass(frozen=True)
class LinkDecision:
    """Numbers that decide whether set-points arrive unevenly."""

    min_gain: float  # gain in log-likelihood below which nothing is found
    negligible_gain: float  # gain per sample below which an uneven link does not matter


@dataclass(frozen=True)
class PredictorDecision:
    """Numbers that decide which effects the enriched model has."""

    unseen_weight: float  # weight of the error on unseen recordings, against that on fitted ones
    search_level: float  # share of joints with nothing missing that may be searched in depth
    min_improvement: float  # share of the held-out error that negligible effects must remove


@dataclass(frozen=True)
class ReportDecision:
    """Numbers that decide what is listed, and with which words."""

    most_rivals: int  # effects that are listed as considered
    rival_min_probability: float  # probability above which an effect is listed as considered
    throughout: float  # share of the time from which a mismatch is there throughout
    driving_gain: float  # gain in log-likelihood from which a state drives a mismatch
    experiment_min_separation: float  # distance in noises that an experiment must reach
    experiment_rivals: int  # effects of one group between which an experiment is to decide


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
    nameless: float  # probability that what is missing has no name, where effects leave most of it
    detection_gain: float  # gain at which an effect is noticed
    search_substeps: float  # sub-steps of rollouts after which the search on a joint goes no wider
    below_sure: float  # largest probability that is stated of an effect less certain than ``sure``
    nuisance_min_evidence: float  # evidence that cogging and eccentricity must add to be kept
    segments_share: float  # share of a recording from which segments are no longer exceptions
    change: ChangeDecision
    link: LinkDecision
    predictor: PredictorDecision
    report: ReportDecision


@dataclass(frozen=True)
class Odds:
    """A logistic curve: the log odds are the sum of features times their weights.

    Attributes:
        weights: By feature; that of one the curve does not know is 0.
    """

    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float], largest_log_odds: float = 40.0) -> float:
        """That it is so; log odds are clipped, beyond which a float holds no difference."""
        odds = sum(self.weights.get(name, 0.0) * value for name, value in features.items())
        return float(1 / (1 + np.exp(-np.clip(odds, -largest_log_odds, largest_log_odds))))


def read_decision(path: Path = FILE) -> Decision:
    """The decisions of a file.

    Raises:
        InputError: If one is missing or no number.
    """
    return _read(Decision, Fields(path, "", read_json(path, SCHEMA)).table("values"))


def _read(kind: type[T], values: Fields, group: str = "") -> T:
    """The numbers of a dataclass; those of a group are stored as ``group.name``."""
    numbers: dict[str, Any] = {}
    for name, its in get_type_hints(kind).items():
        if isinstance(its, type) and is_dataclass(its):
            numbers[name] = _read(its, values, f"{name}.")
        else:
            numbers[name] = its(values.table(group + name).number("value"))
    return kind(**numbers)


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
