"""What a search in swims is worth saying: names, groups, probabilities, or that nothing fits.

Pure functions of what ``searched.raw`` keeps, so that ``benchmarks/pool_decisions.py`` reads
the thresholds off many searches without repeating one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.inference.coordinates import RESISTS
from sim2real.diagnose.result import Verdict

Array = NDArray[np.float64]
Name = tuple[str, str]
Names = frozenset[Name]
ROWS, BANDS = ("surge", "sway", "yaw rate", "joints"), ("slow", "beat", "fast")
"""Signals and bands of frequency in which what is left is measured."""
Terms = dict[str, float]
"""Terms of a sum that is the log odds of something, by name."""


@dataclass(frozen=True)
class NameFeatures:
    """What speaks for one effect of the best set.

    Attributes:
        lead: Evidence by which the set is ahead of all that lack the effect's group.
        gain: Evidence that the effect adds.
        group_size: Effects in its group.
        shape_gain: Evidence that a shape without a name would add.
        misfit: Logarithm of what is left over what is left usually.
        held_out_gain: How much likelier the effect makes what was held out.
        imitator: Whether it is one that an error of the law can imitate, 1 or 0.
        largest_gain: Evidence that the effect adds which adds most.
        unlisted: Probability that something is there that the catalogue lacks.
        camera: Whether it is the camera's, 1 or 0.
        set_evidence: Evidence of the set over none.
        unreferred: Whether no references were known, 1 or 0.
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
        """What the log odds of the name are a sum of, before weights."""
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
    """What speaks for something that the catalogue lacks, or for anything at all.

    Attributes:
        shape_gain: Evidence that a shape without a name would add.
        change_gain: Evidence that a robot that becomes another one would add.
        misfit: Logarithm of what is left over what is left usually.
        set_evidence: Evidence of the best set over none.
        held_out_gain: How much likelier the best set makes what was held out.
        unreferred: Whether no references were known, 1 or 0.
        shape_lead: Evidence by which a shape alone is ahead of the best set.
    """

    shape_gain: float = 0.0
    change_gain: float = 0.0
    misfit: float = 0.0
    set_evidence: float = 0.0
    held_out_gain: float = 0.0
    unreferred: float = 0.0
    shape_lead: float = 0.0

    def terms(self, evidence_scale: float) -> Terms:
        """What the log odds are a sum of, before weights.

        What a shape adds counts over the evidence of the best set: a strong effect that is not
        quite right leaves something that one of them fits, above all of a robot that becomes
        another.

        Args:
            evidence_scale: Evidence over which that of a shape counts where the set has none.
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
    """One effect that is named.

    Attributes:
        name: Effect and component.
        group: What these swims cannot tell from it, itself first.
        probability: That one of the group is there.
        gain: Evidence that it adds to the others.
        features: What its odds are made of.
    """

    name: Name
    group: tuple[Name, ...]
    probability: float
    gain: float
    features: NameFeatures


@dataclass(frozen=True)
class Decided:
    """What is said.

    Attributes:
        verdict: In a word.
        named: Likeliest first.
        offered: The set whose model predicts; nothing where no name is likely.
        rivals: Other effects and their probabilities, likeliest first.
        unlisted: Probability that something is there that the catalogue lacks.
        shape: The shape without a name that does best.
        features: What the odds of ``unlisted`` are made of.
    """

    verdict: Verdict
    named: tuple[Named, ...]
    offered: Names
    rivals: tuple[tuple[Name, float], ...]
    unlisted: float
    shape: str
    features: UnlistedFeatures = field(default_factory=UnlistedFeatures)


def decide(raw: Mapping[str, Any], numbers: Mapping[str, float]) -> Decided:
    """Say what a search is worth.

    Args:
        raw: As ``searched.raw`` has it; ``referred``: whether references were known.
        numbers: ``decisions`` of ``law_error.json``.
    """
    cost, heat = numbers["cost"], numbers["temperature"]
    worth = {_names(one): one["evidence"] - cost * len(one["names"]) for one in raw["sets"]}
    settled = {_names(one) for one in raw["sets"] if one["settled"]}
    held = {_names(one): (one["loss"], one["speed"]) for one in raw["held"]}
    best = max((s for s in held if s and s in settled), key=lambda s: worth[s])
    keys = list(worth)
    level = np.array([worth[s] for s in keys]) / heat
    share = np.exp(level - level.max())
    share = share / share.sum()
    beyond, without = (
        {
            shape: gain - numbers[f"usual {shape.split()[0]}"]
            for shape, gain in raw["nameless"][fit].items()
        }
        for fit in ("best", "plain")
    )
    shape, more = max(beyond.items(), key=lambda one: one[1])
    changed = [gain for one, gain in beyond.items() if one.startswith("change")]
    shaped = [gain for one, gain in beyond.items() if not one.startswith("change")]
    usual = [[numbers[f"usual misfit {row} {band}"] for band in BANDS] for row in ROWS]
    off = float(np.max(np.log(np.maximum(np.array(raw["misfit"]) / usual, 1e-9))))
    ahead = worth[best] - worth[frozenset()]
    instead = max(without.values()) - ahead
    helps = _helps(best, frozenset(), held)
    alone = 0.0 if raw.get("referred", True) else 1.0
    features = UnlistedFeatures(
        max(shaped, default=0.0), max(changed, default=0.0), off, ahead, helps, alone, instead
    )
    terms = features.terms(numbers["evidence_scale"])
    unlisted = _odds(terms, "unlisted", numbers)
    anything = _odds(terms, "anything", numbers)
    flagged = anything >= numbers["flagged from"] or unlisted >= numbers["likely"]
    gains = {
        name: worth[best] - worth.get(best - {name}, min(worth.values())) + cost for name in best
    }
    named = []
    for name, gain in gains.items():
        group = _group(name, best, worth, numbers)
        if flagged and len(best) == 1:
            group = _widened(group, keys, share, numbers)
        rest = best - {name}
        margin = worth[best] - max(worth[s] for s in keys if not s & set(group))
        own = NameFeatures(
            margin, gain, float(len(group)), more, off, _helps(best, rest, held),
            float(name[0] in RESISTS), max(gains.values()), unlisted, float(name[1] == "camera"),
            ahead, alone,
        )  # fmt: skip
        certain = min(_odds(own.terms(), "name", numbers), numbers["most_certain"])
        named.append(Named(name, group, certain, gain, own))
    likely = {one.name: one.probability for one in named if one.probability >= numbers["likely"]}
    offered = _predicting(best & set(likely), held, worth, likely, numbers)
    others = {name for s in keys for name in s} - {n for one in named for n in one.group}
    named = [one for one in named if one.probability >= numbers["stated"]]
    named.sort(key=lambda one: -one.gain)
    rivals = [(name, _there((name,), keys, share)) for name in others]
    rivals.sort(key=lambda one: (-one[1], one[0]))
    return Decided(
        _verdict(named, offered, unlisted, flagged, numbers["likely"]), tuple(named), offered,
        tuple(rivals), unlisted, shape, features,
    )  # fmt: skip


def _helps(now: Names, rest: Names, held: Mapping[Names, tuple[float, float]]) -> float:
    """How much likelier a set makes what was held out than another."""
    return held[rest][0] - held[now][0] if now in held and rest in held else 0.0


def _there(group: Sequence[Name], keys: Sequence[Names], share: Array) -> float:
    """Probability of the sets that have one of a group."""
    return float(sum(p for s, p in zip(keys, share, strict=True) if s & set(group)))


def _widened(
    group: tuple[Name, ...], keys: Sequence[Names], share: Array, numbers: Mapping[str, float]
) -> tuple[Name, ...]:
    """A group with the next likeliest, until one of them is likely; itself if that takes many."""
    others = {name for s in keys for name in s} - set(group)
    wide, enough = group, numbers["group_likely"]
    for name in sorted(others, key=lambda one: -_there((one,), keys, share)):
        if _there(wide, keys, share) >= enough or len(wide) >= numbers["group_most"]:
            break
        wide = (*wide, name)
    return wide if _there(wide, keys, share) >= enough else group


def _odds(terms: Terms, curve: str, numbers: Mapping[str, float]) -> float:
    """A probability: the logistic curve of a weighted sum of terms."""
    log_odds = float(sum(numbers[f"{curve}: {name}"] * term for name, term in terms.items()))
    return float(1 / (1 + np.exp(-np.clip(log_odds, -40, 40))))


def _log(value: float) -> float:
    """Evidence, of which more and more counts less and less; either sign."""
    return float(np.sign(value) * np.log1p(abs(value)))


def _verdict(
    named: list[Named], offered: Names, unlisted: float, flagged: bool, likely_from: float
) -> Verdict:
    """In a word; explained is only what the model that is offered has."""
    likely = [one for one in named if one.probability >= likely_from]
    if likely and (unlisted >= likely_from or any(one.name not in offered for one in likely)):
        return "partly_explained"
    if not likely:
        return "unexplained" if flagged else "consistent"
    return "ambiguous" if any(len(one.group) > 1 for one in likely) else "explained"


def _predicting(
    likely: Names, held: Mapping[Names, tuple[float, float]], worth: Mapping[Names, float],
    certain: Mapping[Name, float], numbers: Mapping[str, float],
) -> Names:  # fmt: skip
    """Those of the likely whose every member makes what was held out likelier.

    It has to make the speed there better as well, unless it is nearly certain: what bends a path or
    delays a camera may do little to the speed.
    """
    now = likely
    while now in held and now:
        loss, speed = held[now]
        bad = []
        for name in now:
            before = held.get(now - {name})
            if before is not None and (
                before[0] - loss < numbers["held_gain"]
                or (
                    speed > (1 - numbers["held_better"]) * max(before[1], 1e-9)
                    and certain[name] < numbers["held_sure"]
                )
            ):
                bad.append(now - {name})
        if not bad:
            return now
        now = max(bad, key=lambda part: worth.get(part, -np.inf))
    return now if now in held else frozenset()


def _group(
    name: Name, members: Names, worth: Mapping[Names, float], numbers: Mapping[str, float]
) -> tuple[Name, ...]:
    """Itself, and what does as well in its place."""
    rest = members - {name}
    alike = []
    for other in {n for s in worth for n in s} - members:
        instead = rest | {other}
        if instead in worth:
            limit = numbers["alike"]
            if name[0] in RESISTS or other[0] in RESISTS:
                limit = numbers["alike_imitated"]
            behind = worth[members] - worth[instead]
            if behind < limit:
                alike.append((behind, other))
    return (name, *(other for _, other in sorted(alike)))


def _names(one: Mapping[str, Any]) -> Names:
    return frozenset((str(a), str(b)) for a, b in one["names"])
