"""Decisions from a search in swims: reported effects, groups, probabilities and the verdict.

Pure functions of the output of ``searched.raw``: ``benchmarks/pool_decisions.py`` fits thresholds
to many searches without repeating one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.inference.coordinates import WATER_FORCES
from sim2real.arrays import Array
from sim2real.diagnose.result import Verdict

Name = tuple[str, str]
Names = frozenset[Name]
ROWS, BANDS = ("surge", "sway", "yaw rate", "joints"), ("slow", "beat", "fast")
"""Signals and frequency bands of the misfit."""
Terms = dict[str, float]
"""Terms of a sum of log odds, by name."""


@dataclass(frozen=True)
class NameFeatures:
    """Features of the probability of one effect of the best set; evidence is logarithmic.

    Attributes:
        lead: Evidence of the set relative to the best set without the effect's group.
        gain: Evidence that the effect adds.
        group_size: Number of effects in its group.
        shape_gain: Evidence that an unnamed shape would add.
        misfit: Logarithm of the residual relative to the usual one.
        held_out_gain: Increase of the held-out log-likelihood by the effect.
        imitator: Whether an error of the law can imitate the effect, 1 or 0.
        largest_gain: Largest evidence that an effect of the set adds.
        unlisted: Probability of an effect that the catalogue lacks.
        camera: Whether it is a camera effect, 1 or 0.
        set_evidence: Evidence of the set relative to the plain model.
        unreferred: Whether there were no reference swims, 1 or 0.
    """

    lead: float
    gain: float
    group_size: float
    shape_gain: float
    misfit: float
    held_out_gain: float
    imitator: float
    largest_gain: float
    unlisted: float
    camera: float
    set_evidence: float
    unreferred: float

    def terms(self) -> Terms:
        """Terms of the effect's log odds, before weights."""
        return {
            "constant": 1.0,
            "lead": _log(self.lead),
            "group size": float(np.log(self.group_size)),
            "shape over gain": max(_log(self.shape_gain) - _log(self.gain), 0.0),
            "misfit": float(np.clip(self.misfit, -2, 4)),
            "held-out gain": _log(self.held_out_gain),
            "imitator": self.imitator,
            "behind largest gain": _log(self.largest_gain) - _log(self.gain),
            "unlisted": -float(np.log(max(1 - self.unlisted, 1e-3))),
            "camera": self.camera,
            "set evidence": _log(self.set_evidence),
            "not largest gain": float(self.gain < self.largest_gain),
            "gain": _log(self.gain),
            "unreferred imitator": self.imitator * self.unreferred,
        }


@dataclass(frozen=True)
class UnlistedFeatures:
    """Features of the probability of an effect that the catalogue lacks, or of any effect.

    Attributes:
        shape_gain: Evidence that an unnamed shape would add.
        change_gain: Evidence that a change of the robot during the swim would add.
        misfit: Logarithm of the residual relative to the usual one.
        set_evidence: Evidence of the best set relative to the plain model.
        held_out_gain: Increase of the held-out log-likelihood by the best set.
        unreferred: Whether there were no reference swims, 1 or 0.
        shape_lead: Evidence of the best shape alone relative to the best set.
    """

    shape_gain: float = 0.0
    change_gain: float = 0.0
    misfit: float = 0.0
    set_evidence: float = 0.0
    held_out_gain: float = 0.0
    unreferred: float = 0.0
    shape_lead: float = 0.0

    def terms(self, evidence_scale: float) -> Terms:
        """Terms of the log odds, before weights.

        The evidence of a shape is divided by that of the best set: small errors in a strong effect
        leave residuals that a shape fits, above all a change of the robot.

        Args:
            evidence_scale: Evidence that is added to the divisor.
        """
        size = max(self.set_evidence, 0.0) + evidence_scale
        return {
            "constant": 1.0,
            "shape gain": float(np.log1p(max(self.shape_gain, 0.0) / size)),
            "misfit": float(np.clip(self.misfit, -2, 4)),
            "set evidence": _log(self.set_evidence),
            "held-out gain": _log(self.held_out_gain),
            "change gain": float(np.log1p(max(self.change_gain, 0.0) / size)),
            "unreferred": self.unreferred,
            "shape lead": _log(self.shape_lead),
        }


@dataclass(frozen=True)
class Named:
    """One reported effect.

    Attributes:
        name: Effect and component.
        group: Effects that these swims do not distinguish from it, itself first.
        probability: Probability that one of the group is present.
        gain: Evidence that it adds to the others.
        features: Features of its odds.
    """

    name: Name
    group: tuple[Name, ...]
    probability: float
    gain: float
    features: NameFeatures


@dataclass(frozen=True)
class Decided:
    """Decisions from one search.

    Attributes:
        verdict: The verdict.
        named: Reported effects, the largest gain first.
        offered: Effects of the enriched model; empty where no effect is likely.
        rivals: Other effects and their probabilities, likeliest first.
        unlisted: Probability of an effect that the catalogue lacks.
        shape: The unnamed shape with the largest evidence.
        features: Features of the odds of ``unlisted``.
        sets: Probabilities of the sets that were tried.
    """

    verdict: Verdict
    named: tuple[Named, ...]
    offered: Names
    rivals: tuple[tuple[Name, float], ...]
    unlisted: float
    shape: str
    features: UnlistedFeatures = field(default_factory=UnlistedFeatures)
    sets: Mapping[Names, float] = field(default_factory=dict)


def decide(raw: Mapping[str, Any], numbers: Mapping[str, float]) -> Decided:
    """Decide which effects are reported, and the verdict.

    Args:
        raw: Output of ``searched.raw``; ``referred`` is whether there were reference swims.
        numbers: ``decisions`` of ``law_error.json``.
    """
    cost, temperature = numbers["cost"], numbers["temperature"]
    evidence = {
        _names(entry): entry["evidence"] - cost * len(entry["names"]) for entry in raw["sets"]
    }
    settled = {_names(entry) for entry in raw["sets"] if entry["settled"]}
    held_out = {_names(entry): (entry["loss"], entry["speed"]) for entry in raw["held"]}
    some = [s for s in held_out if s]
    best = max([s for s in some if s in settled] or some, key=lambda s: evidence[s])
    keys = list(evidence)
    log_weights = np.array([evidence[s] for s in keys]) / temperature
    probabilities = np.exp(log_weights - log_weights.max())
    probabilities = probabilities / probabilities.sum()
    with_best, with_plain = (
        {
            shape: gain - numbers[f"usual {shape.split()[0]}"]
            for shape, gain in raw["nameless"][fit].items()
        }
        for fit in ("best", "plain")
    )
    shape, shape_gain = max(with_best.items(), key=lambda item: item[1])
    change_gains = [gain for name, gain in with_best.items() if name.startswith("change")]
    shape_gains = [gain for name, gain in with_best.items() if not name.startswith("change")]
    usual = [[numbers[f"usual misfit {row} {band}"] for band in BANDS] for row in ROWS]
    misfit = float(np.max(np.log(np.maximum(np.array(raw["misfit"]) / usual, 1e-9))))
    lead = evidence[best] - evidence[frozenset()]
    shape_lead = max(with_plain.values()) - lead
    held_out_gain = _held_out_gain(best, frozenset(), held_out)
    unreferred = 0.0 if raw.get("referred", True) else 1.0
    features = UnlistedFeatures(
        max(shape_gains, default=0.0),
        max(change_gains, default=0.0),
        misfit,
        lead,
        held_out_gain,
        unreferred,
        shape_lead,
    )
    terms = features.terms(numbers["evidence_scale"])
    unlisted = _logistic(terms, "unlisted", numbers)
    anything = _logistic(terms, "anything", numbers)
    flagged = anything >= numbers["flagged from"] or unlisted >= numbers["likely"]
    gains = {
        name: evidence[best] - evidence.get(best - {name}, min(evidence.values())) + cost
        for name in best
    }
    named = []
    for name, gain in gains.items():
        group = _group(name, best, evidence, gain, numbers)
        if flagged and len(best) == 1:
            group = _widened(group, keys, probabilities, numbers)
        without = best - {name}
        group_lead = evidence[best] - max(evidence[s] for s in keys if not s & set(group))
        effect_features = NameFeatures(
            group_lead, gain, float(len(group)), shape_gain, misfit,
            _held_out_gain(best, without, held_out), float(name[0] in WATER_FORCES),
            max(gains.values()), unlisted, float(name[1] == "camera"), lead, unreferred,
        )  # fmt: skip
        probability = min(
            _logistic(effect_features.terms(), "name", numbers), numbers["most_certain"]
        )
        named.append(Named(name, group, probability, gain, effect_features))
    likely = {e.name: e.probability for e in named if e.probability >= numbers["likely"]}
    offered = _predicting(best & set(likely), held_out, evidence, likely, numbers)
    others = {name for s in keys for name in s} - {n for effect in named for n in effect.group}
    named = [effect for effect in named if effect.probability >= numbers["stated"]]
    named.sort(key=lambda effect: -effect.gain)
    rivals = [(name, _probability((name,), keys, probabilities)) for name in others]
    rivals.sort(key=lambda rival: (-rival[1], rival[0]))
    return Decided(
        _verdict(named, offered, unlisted, flagged, numbers["likely"]), tuple(named), offered,
        tuple(rivals), unlisted, shape, features, dict(zip(keys, probabilities, strict=True)),
    )  # fmt: skip


def _held_out_gain(
    members: Names, rest: Names, held_out: Mapping[Names, tuple[float, float]]
) -> float:
    """Increase of the held-out log-likelihood by one set relative to another."""
    if members not in held_out or rest not in held_out:
        return 0.0
    return held_out[rest][0] - held_out[members][0]


def _probability(group: Sequence[Name], keys: Sequence[Names], probabilities: Array) -> float:
    """Sum of the probabilities of the sets that contain an effect of a group."""
    return float(sum(p for s, p in zip(keys, probabilities, strict=True) if s & set(group)))


def _widened(
    group: tuple[Name, ...],
    keys: Sequence[Names],
    probabilities: Array,
    numbers: Mapping[str, float],
) -> tuple[Name, ...]:
    """The group with the next likeliest effects until it is likely, unless that takes many."""
    others = {name for s in keys for name in s} - set(group)
    wide, target = group, numbers["group_likely"]
    for name in sorted(others, key=lambda other: -_probability((other,), keys, probabilities)):
        if _probability(wide, keys, probabilities) >= target or len(wide) >= numbers["group_most"]:
            break
        wide = (*wide, name)
    return wide if _probability(wide, keys, probabilities) >= target else group


def _logistic(terms: Terms, curve: str, numbers: Mapping[str, float]) -> float:
    """Probability: the logistic function of a weighted sum of terms."""
    log_odds = float(sum(numbers[f"{curve}: {name}"] * term for name, term in terms.items()))
    return float(1 / (1 + np.exp(-np.clip(log_odds, -40, 40))))


def _log(value: float) -> float:
    """Signed logarithm of evidence: sign(x) log(1 + abs(x))."""
    return float(np.sign(value) * np.log1p(abs(value)))


def _verdict(
    named: list[Named], offered: Names, unlisted: float, flagged: bool, likely_from: float
) -> Verdict:
    """The verdict; only effects of the offered model count as explained."""
    likely = [effect for effect in named if effect.probability >= likely_from]
    if likely and (unlisted >= likely_from or any(effect.name not in offered for effect in likely)):
        return "partly_explained"
    if not likely:
        return "unexplained" if flagged else "consistent"
    return "ambiguous" if any(len(effect.group) > 1 for effect in likely) else "explained"


def _predicting(
    likely: Names, held_out: Mapping[Names, tuple[float, float]], evidence: Mapping[Names, float],
    probability: Mapping[Name, float], numbers: Mapping[str, float],
) -> Names:  # fmt: skip
    """The subset of likely effects of which each increases the held-out likelihood.

    Each must also decrease the held-out error of the speed, unless it is nearly certain: an effect
    that bends the path or delays the camera changes the speed little.
    """
    members = likely
    while members in held_out and members:
        loss, speed = held_out[members]
        smaller = []
        for name in members:
            before = held_out.get(members - {name})
            if before is not None and (
                before[0] - loss < numbers["held_gain"]
                or (
                    speed > (1 - numbers["held_better"]) * max(before[1], 1e-9)
                    and probability[name] < numbers["held_sure"]
                )
            ):
                smaller.append(members - {name})
        if not smaller:
            return members
        members = max(smaller, key=lambda subset: evidence.get(subset, -np.inf))
    return members if members in held_out else frozenset()


def _group(
    name: Name,
    members: Names,
    evidence: Mapping[Names, float],
    gain: float,
    numbers: Mapping[str, float],
) -> tuple[Name, ...]:
    """The effect, and those that have nearly its evidence in its place.

    The force of an effect on the water is predicted with an error in proportion to it, so that
    differences of less than a share of the evidence that it adds do not identify the effect.
    """
    rest = members - {name}
    close = []
    for other in {n for s in evidence for n in s} - members:
        replaced = rest | {other}
        if replaced in evidence:
            limit = numbers["alike"]
            if name[0] in WATER_FORCES or other[0] in WATER_FORCES:
                limit = max(numbers["alike_imitated"], numbers["alike_share"] * gain)
            behind = evidence[members] - evidence[replaced]
            if behind < limit:
                close.append((behind, other))
    return (name, *(other for _, other in sorted(close)))


def _names(entry: Mapping[str, Any]) -> Names:
    return frozenset((str(a), str(b)) for a, b in entry["names"])
