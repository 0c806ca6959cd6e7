"""Every number that decides a verdict or a name, with its reason in ``decision.json``.

``benchmarks/calibrate_decisions.py`` writes the file from development cases and keeps values that
are "chosen". A number of a group is stored as ``group.name``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from sim2real.diagnose.screening import FITTED
from sim2real.structured import Fields, read_json

FILE = Path(__file__).with_name("decision.json")
SCHEMA = "sim2real.decision/1"
CURVES = ("effect", "mismatch", "uncatalogued", "link")
"""What a curve is the odds of: an effect, any mismatch, a mismatch that no effect of the catalogue
explains, irregular command timing."""
T = TypeVar("T")


@dataclass(frozen=True)
class ChangeDecision:
    """Numbers that decide what has changed since the reference recordings."""

    law_error: float  # share of a change's gain by which another may be ahead by chance
    ratio_sd: float  # prior standard deviation of the logarithm of a parameter's ratio
    latency_sd_s: float  # that of a change of latency
    load_sd: float  # that of a load, relative to the stated one
    shape_sd: float  # that of the difference of its relative inertia and weight
    null_known: float  # unchanged recordings that the next three numbers count as
    null_repeat: float  # gain in log-likelihood of a change in an unchanged repeat
    null_rest: float  # the same where servos rest, per independent sample
    null_law: float  # the same where a law explains them, per independent sample
    jump_ratio: float  # step of the residual, relative to the references', that is a jump
    repeated_jump_ratio: float  # the same in a repeat
    explained_share: float  # share of a change that named effects must explain
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
    """Numbers that decide whether set-points arrive at irregular times."""

    min_gain: float  # gain in log-likelihood below which nothing is found
    negligible_gain: float  # gain per sample below which irregular timing does not matter
    max_contradiction: float  # gain of rates of each joint over common ones, up to which all share


@dataclass(frozen=True)
class ReportDecision:
    """Numbers that decide what is listed, and with which words."""

    most_rivals: int  # effects that are listed as considered
    rival_min_probability: float  # probability above which an effect is listed as considered
    throughout_share: float  # share of the time from which a mismatch is present throughout
    driving_gain: float  # gain in log-likelihood from which a state drives a mismatch
    rattle_ratio: float  # power of a spectrum's peak over its median band that is a rattle


@dataclass(frozen=True)
class Decision:
    """The numbers; gains and costs are in log-likelihood, excesses in variances of the noise."""

    false_alarms: float  # share of robots with nothing missing that may be called mismatched
    named: float  # probability from which an effect is named
    negligible: float  # share of the held-out error below whose change an effect does not matter
    min_improvement: float  # share of the held-out error that negligible effects must remove
    group_share: float  # a rival this probable, relative to the first, is in one group with it
    missing_share: float  # share of joints that are expected to miss something; the prior
    prior_sd: float  # prior standard deviation of an effect's parameter, in typical values
    decisive_gain: float  # gain that is never due to chance, however irregular the noise
    law_error: float  # relative error of an effect's law
    rattling_law_error: float  # the same of backlash, where friction holds the motor alone
    most_certain: float  # largest probability of an effect
    min_certain_probability: float  # probability below which max_uncertain_probability is the most
    max_uncertain_probability: float  # largest probability of an effect that is not certain
    mismatch_probability: float  # probability from which something is missing, named or not
    structured_excess: float  # excess from which a residual is more than noise and slow drift
    noise_like_excess: float  # excess below which no uncatalogued physics is searched for
    nuisance_finding_size: float  # size of a nuisance from which it is a finding, in noise SD
    clock_tolerance: float  # relative difference of two clocks that is corrected, not reported
    controller_wait_s: float  # jitter that the controller's own period explains
    data_sheet_share: float  # share of the stated torque or speed from which a limit is the stated
    inertia_tolerance: float  # relative error of a stated inertia
    coarse_step_ratio: float  # step of a sensor, relative to the stated one, that is a finding
    uncatalogued_probability: float  # probability stated where effects leave most of a mismatch
    detection_gain: float  # gain at which an effect is noticed
    search_substeps: float  # sub-steps of rollouts after which the search on a joint ends
    nuisance_min_evidence: float  # evidence that cogging and eccentricity must add to be kept
    segments_share: float  # share of a recording from which segments are no longer exceptions
    change: ChangeDecision
    link: LinkDecision
    report: ReportDecision


@dataclass(frozen=True)
class Odds:
    """A logistic curve: the log odds are the sum of features times their weights, by name."""

    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float], largest_log_odds: float = 40.0) -> float:
        """Probability by the curve; log odds are clipped to what a float distinguishes.

        Raises:
            ValueError: If a feature has no weight, or a weight no feature.
        """
        unmatched = sorted(features.keys() ^ self.weights.keys())
        if unmatched:
            raise ValueError(f"features and weights differ: {', '.join(unmatched)}")
        odds = sum(self.weights[name] * value for name, value in features.items())
        return float(1 / (1 + np.exp(-np.clip(odds, -largest_log_odds, largest_log_odds))))


def read_decision(path: Path = FILE) -> Decision:
    """The decisions of a file.

    Raises:
        InputError: If one is missing or no number.
    """
    return _read(Decision, Fields(path, "", read_json(path, SCHEMA)).table("values"))


def _read(kind: type[T], values: Fields, group: str = "") -> T:
    """The numbers of a dataclass; those of a group are stored as ``group.name``."""
    numbers: dict[str, Any] = {
        name: _read(kind_of, values, f"{name}.")
        if isinstance(kind_of, type) and is_dataclass(kind_of)
        else kind_of(values.table(group + name).number("value"))
        for name, kind_of in get_type_hints(kind).items()
    }
    return kind(**numbers)


def read_odds(path: Path = FILE) -> dict[str, Odds]:
    """The curves of a file, by what they are the odds of.

    Raises:
        InputError: If a weight is no number.
    """
    table = Fields(path, "", read_json(path, SCHEMA)).table("odds")
    weights = {name: table.table(name) for name in CURVES}
    return {name: Odds({x: one.number(x) for x in one.content}) for name, one in weights.items()}


DECISION = read_decision()
ODDS = read_odds()
LOG_PRIOR = float(np.log(DECISION.missing_share / len(FITTED)))
"""Logarithm of the prior odds of each effect."""
