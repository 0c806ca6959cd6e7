"""Decisions from a search in swims: reported effects, groups, probabilities and the verdict.

Pure functions of the output of ``searched.raw``: ``benchmarks/pool_decisions.py`` fits thresholds
to many searches without repeating one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.inference.coordinates import WATER_FORCES
from sim2real.diagnose.result import Verdict

Name = tuple[str, str]
"""Effect and component."""
Names = frozenset[Name]
ROWS, BANDS = ("surge", "sway", "yaw rate", "joints"), ("slow", "beat", "fast")
"""Signals and frequency bands of the misfit."""
Terms = dict[str, float]
"""Terms of a sum of log odds, by name, before weights."""
Numbers = Mapping[str, float]
"""``decisions`` of ``law_error.json``."""


@dataclass(frozen=True)
class Named:
    """One reported effect."""

    name: Name  # effect and component
    group: tuple[Name, ...]  # effects that these swims do not distinguish from it, itself first
    probability: float  # probability that one of the group is present
    gain: float  # evidence that it adds to the others
    terms: Terms  # terms of its log odds


@dataclass(frozen=True)
class Decided:
    """Decisions from one search."""

    verdict: Verdict  # the verdict
    named: tuple[Named, ...]  # reported effects, the largest gain first
    offered: Names  # effects of the enriched model; empty where no effect is likely
    rivals: tuple[tuple[Name, float], ...]  # other effects and their probabilities, likeliest first
    unlisted: float  # probability of an effect that the catalogue lacks
    shape: str  # the unnamed shape with the largest evidence
    terms: Terms  # terms of the log odds of ``unlisted``
    sets: Mapping[Names, float]  # probabilities of the sets that were tried


@dataclass(frozen=True)
class _Sets:
    """The sets of a search."""

    evidence: dict[Names, float]  # evidence of each set, less the cost of its effects
    probability: dict[Names, float]  # probability of each set
    # loss, and error of the speed, on the end of the swims, of the best's subsets
    held_out: dict[Names, tuple[float, float]]
    numbers: Numbers  # the thresholds

    @classmethod
    def of(cls, raw: Mapping[str, Any], numbers: Numbers) -> _Sets:
        """The sets in the output of ``searched.raw``."""
        cost = numbers["cost"]
        evidence = {_names(e): e["evidence"] - cost * len(e["names"]) for e in raw["sets"]}
        log_weights = np.array(list(evidence.values())) / numbers["temperature"]
        weights = np.exp(log_weights - log_weights.max())
        probability = dict(zip(evidence, (weights / weights.sum()).tolist(), strict=True))
        held_out = {_names(entry): (entry["loss"], entry["speed"]) for entry in raw["held"]}
        return cls(evidence, probability, held_out, numbers)

    @property
    def effects(self) -> Names:
        """All effects of the sets."""
        return frozenset(name for members in self.evidence for name in members)

    def likelihood(self, group: Sequence[Name]) -> float:
        """Sum of the probabilities of the sets that contain an effect of a group."""
        return float(sum(p for s, p in self.probability.items() if s & set(group)))

    def held_out_gain(self, members: Names, rest: Names) -> float:
        """Increase of the held-out log-likelihood by one set relative to another."""
        if members not in self.held_out or rest not in self.held_out:
            return 0.0
        return self.held_out[rest][0] - self.held_out[members][0]

    def group(self, name: Name, members: Names, gain: float) -> tuple[Name, ...]:
        """The effect, and those that have nearly its evidence in its place.

        The force of an effect on the water is predicted with an error in proportion to it, so that
        differences of less than a share of the evidence that it adds do not identify the effect.
        """
        numbers, close = self.numbers, []
        for other in self.effects - members:
            replaced = members - {name} | {other}
            if replaced in self.evidence:
                limit = numbers["alike"]
                if name[0] in WATER_FORCES or other[0] in WATER_FORCES:
                    limit = max(numbers["alike_imitated"], numbers["alike_share"] * gain)
                behind = self.evidence[members] - self.evidence[replaced]
                if behind < limit:
                    close.append((behind, other))
        return (name, *(other for _, other in sorted(close)))

    def widened(self, group: tuple[Name, ...]) -> tuple[Name, ...]:
        """The group with the next likeliest effects until it is likely, unless that takes many."""
        target, most = self.numbers["group_likely"], self.numbers["group_most"]
        others = sorted(self.effects - set(group), key=lambda name: -self.likelihood((name,)))
        wide = group
        for name in others:
            if self.likelihood(wide) >= target or len(wide) >= most:
                break
            wide = (*wide, name)
        return wide if self.likelihood(wide) >= target else group

    def predicting(self, likely: Mapping[Name, float]) -> Names:
        """The subset of likely effects of which each increases the held-out likelihood.

        Each must also decrease the held-out error of the speed, unless it is nearly certain: an
        effect that bends the path or delays the camera changes the speed little.
        """
        members, numbers = frozenset(likely), self.numbers
        while members in self.held_out and members:
            speed = self.held_out[members][1]
            smaller = []
            for name in members:
                before = self.held_out.get(members - {name})
                if before is None:
                    continue
                slow = speed > (1 - numbers["held_better"]) * max(before[1], 1e-9)
                unsure = likely[name] < numbers["held_sure"]
                worse = self.held_out_gain(members, members - {name}) < numbers["held_gain"]
                if worse or (slow and unsure):
                    smaller.append(members - {name})
            if not smaller:
                return members
            members = max(smaller, key=lambda subset: self.evidence.get(subset, -np.inf))
        return members if members in self.held_out else frozenset()


def decide(raw: Mapping[str, Any], numbers: Numbers) -> Decided:
    """Decide which effects are reported, and the verdict, from the output of ``searched.raw``."""
    sets = _Sets.of(raw, numbers)
    evidence = sets.evidence
    some = [s for s in sets.held_out if s]
    settled = {_names(entry) for entry in raw["sets"] if entry["settled"]}
    best = max([s for s in some if s in settled] or some, key=lambda s: evidence[s])
    lead = evidence[best] - evidence[frozenset()]
    shapes = {
        fit: {name: gain - numbers[f"usual {name.split()[0]}"] for name, gain in gains.items()}
        for fit, gains in raw["nameless"].items()
    }
    shape, shape_gain = max(shapes["best"].items(), key=lambda item: item[1])
    usual = [[numbers[f"usual misfit {row} {band}"] for band in BANDS] for row in ROWS]
    misfit = float(np.max(np.log(np.maximum(np.array(raw["misfit"]) / usual, 1e-9))))
    unreferred = 0.0 if raw.get("referred", True) else 1.0
    # The evidence of a shape is divided by that of the best set: small errors in a strong effect
    # leave residuals that a shape fits, above all a change of the robot.
    size = max(lead, 0.0) + numbers["evidence_scale"]
    largest = {
        kind: max(
            (g for n, g in shapes["best"].items() if n.startswith("change") == kind), default=0
        )
        for kind in (False, True)
    }
    terms = {
        "constant": 1.0,
        "shape gain": float(np.log1p(max(largest[False], 0.0) / size)),
        "misfit": float(np.clip(misfit, -2, 4)),
        "set evidence": _log(lead),
        "held-out gain": _log(sets.held_out_gain(best, frozenset())),
        "change gain": float(np.log1p(max(largest[True], 0.0) / size)),
        "unreferred": unreferred,
        "shape lead": _log(max(shapes["plain"].values()) - lead),
    }
    unlisted = _logistic(terms, "unlisted", numbers)
    anything = _logistic(terms, "anything", numbers)
    flagged = anything >= numbers["flagged from"] or unlisted >= numbers["likely"]
    fewest = min(evidence.values())
    gains = {
        name: evidence[best] - evidence.get(best - {name}, fewest) + numbers["cost"]
        for name in best
    }
    named = []
    for name, gain in gains.items():
        group = sets.group(name, best, gain)
        if flagged and len(best) == 1:
            group = sets.widened(group)
        ahead = evidence[best] - max(evidence[s] for s in evidence if not s & set(group))
        imitator, most = float(name[0] in WATER_FORCES), max(gains.values())
        of_name = {
            "constant": 1.0,
            "lead": _log(ahead),
            "group size": float(np.log(len(group))),
            "shape over gain": max(_log(shape_gain) - _log(gain), 0.0),
            "misfit": float(np.clip(misfit, -2, 4)),
            "held-out gain": _log(sets.held_out_gain(best, best - {name})),
            "imitator": imitator,
            "behind largest gain": _log(most) - _log(gain),
            "unlisted": -float(np.log(max(1 - unlisted, 1e-3))),
            "camera": float(name[1] == "camera"),
            "set evidence": _log(lead),
            "not largest gain": float(gain < most),
            "gain": _log(gain),
            "unreferred imitator": imitator * unreferred,
        }
        probability = min(_logistic(of_name, "name", numbers), numbers["most_certain"])
        named.append(Named(name, group, probability, gain, of_name))
    likely = {e.name: e.probability for e in named if e.probability >= numbers["likely"]}
    offered = sets.predicting(likely)
    others = sets.effects - {n for effect in named for n in effect.group}
    named = [effect for effect in named if effect.probability >= numbers["stated"]]
    named.sort(key=lambda effect: -effect.gain)
    rivals = [(name, sets.likelihood((name,))) for name in others]
    rivals.sort(key=lambda rival: (-rival[1], rival[0]))
    verdict = _verdict(named, offered, unlisted, flagged, numbers["likely"])
    return Decided(
        verdict, tuple(named), offered, tuple(rivals), unlisted, shape, terms, sets.probability
    )


def _logistic(terms: Terms, curve: str, numbers: Numbers) -> float:
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


def _names(entry: Mapping[str, Any]) -> Names:
    return frozenset((str(a), str(b)) for a, b in entry["names"])
