"""Decisions from a search in swims: reported effects, groups, probabilities and the verdict.

Pure functions of ``Searched.raw``: ``benchmarks/pool_decisions.py`` fits thresholds to many.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import softmax

from sim.inference.coordinates import SERVOS, WATER_FORCES, Name, Names
from sim.inference.signal_error import BANDS, ROWS
from sim2real.diagnose.result import Verdict

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


class _Sets:
    """The sets of a search."""

    def __init__(self, raw: Mapping[str, Any], numbers: Numbers) -> None:
        self.numbers, cost = numbers, numbers["cost"]
        # evidence of each set, less the cost of its effects
        self.evidence = {_names(e): e["evidence"] - cost * len(e["names"]) for e in raw["sets"]}
        shares = softmax(np.array(list(self.evidence.values())) / numbers["temperature"]).tolist()
        self.probability = dict(zip(self.evidence, shares, strict=True))
        # loss, and error of the speed, on the end of the swims, of the best's subsets
        self.held_out = {_names(e): (e["loss"], e["speed"]) for e in raw["held"]}
        self.effects = frozenset(name for members in self.evidence for name in members)
        some = [s for s in self.held_out if s]
        settled = {_names(entry) for entry in raw["sets"] if entry["settled"]}
        self.best = max([s for s in some if s in settled] or some, key=lambda s: self.evidence[s])

    def likelihood(self, group: Sequence[Name]) -> float:
        """Sum of the probabilities of the sets that contain an effect of a group."""
        return float(sum(p for s, p in self.probability.items() if s & set(group)))

    def held_out_gain(self, members: Names, rest: Names) -> float:
        """Increase of the held-out log-likelihood by one set relative to another."""
        known = members in self.held_out and rest in self.held_out
        return float(self.held_out[rest][0] - self.held_out[members][0]) if known else 0.0

    def gain(self, name: Name) -> float:
        """Evidence that an effect adds to the others of the best set."""
        rest = self.evidence.get(self.best - {name}, min(self.evidence.values()))
        return float(self.evidence[self.best] - rest + self.numbers["cost"])

    def group(self, name: Name, *, wide: bool) -> tuple[Name, ...]:
        """The effect, and those that have nearly its evidence in its place in the best set.

        Forces on the water are predicted with an error in proportion, so that a share of the
        gain does not identify one. If ``wide``, with the likeliest others until it is likely.
        """
        numbers, close = self.numbers, []
        for other in self.effects - self.best:
            limit = numbers["alike"]
            if name[0] in WATER_FORCES or other[0] in WATER_FORCES:
                share = numbers["alike_share"] * self.gain(name)
                limit = max(numbers["alike_imitated"], share)
            replaced = self.evidence.get(self.best - {name} | {other}, -np.inf)
            behind = self.evidence[self.best] - replaced
            if behind < limit:
                close.append((behind, other))
        group = (name, *(other for _, other in sorted(close)))
        others = sorted(self.effects - set(group), key=lambda name: -self.likelihood((name,)))
        most = int(numbers["group_most"]) - len(group)
        for count in range(most + 1) if wide else ():
            if self.likelihood((*group, *others[:count])) >= numbers["group_likely"]:
                return (*group, *others[:count])
        return group

    def predicting(self, likely: Mapping[Name, float]) -> Names:
        """Likely effects that each increase the held-out likelihood, unsure ones the speed's.

        Effects of servos show in the joints' angles, and need not change the speed.
        """
        members, numbers, smaller = frozenset(likely), self.numbers, []
        if members not in self.held_out:
            return frozenset()
        for name in members:
            rest = members - {name}
            if rest in self.held_out:
                least = (1 - numbers["held_better"]) * max(self.held_out[rest][1], 1e-9)
                unsure = likely[name] < numbers["held_sure"] and name[1] != SERVOS
                slow = self.held_out[members][1] > least and unsure
                if slow or self.held_out_gain(members, rest) < numbers["held_gain"]:
                    smaller.append(rest)
        if not smaller:
            return members
        best = max(smaller, key=lambda subset: self.evidence.get(subset, -np.inf))
        return self.predicting({name: likely[name] for name in best})


def decide(raw: Mapping[str, Any], numbers: Numbers) -> Decided:
    """Decide which effects are reported, and the verdict, from ``Searched.raw``."""
    sets = _Sets(raw, numbers)
    terms, shape, shape_gain = _terms(raw, sets)
    unlisted, likely = _logistic(terms, "unlisted", numbers), numbers["likely"]
    anything = _logistic(terms, "anything", numbers)
    flagged = anything >= numbers["flagged from"] or unlisted >= likely
    most, found = max(map(sets.gain, sets.best)), []
    for name in sets.best:
        group, gain = sets.group(name, wide=flagged and len(sets.best) == 1), sets.gain(name)
        behind = max(evidence for s, evidence in sets.evidence.items() if not s & set(group))
        imitator = float(name[0] in WATER_FORCES)
        of_name = {
            "constant": 1.0,
            "lead": _log(sets.evidence[sets.best] - behind),
            "group size": float(np.log(len(group))),
            "shape over gain": max(_log(shape_gain) - _log(gain), 0.0),
            "misfit": terms["misfit"],
            "held-out gain": _log(sets.held_out_gain(sets.best, sets.best - {name})),
            "imitator": imitator,
            "behind largest gain": _log(most) - _log(gain),
            "unlisted": -float(np.log(max(1 - unlisted, 1e-3))),
            "camera": float(name[1] == "camera"),
            "set evidence": terms["set evidence"],
            "not largest gain": float(gain < most),
            "gain": _log(gain),
            "unreferred imitator": imitator * terms["unreferred"],
        }
        probability = min(_logistic(of_name, "name", numbers), numbers["most_certain"])
        found.append(Named(name, group, probability, gain, of_name))
    others = sets.effects - {n for effect in found for n in effect.group}
    rivals = sorted(((name, sets.likelihood((name,))) for name in others), key=lambda r: (-r[1], r))
    named = sorted((e for e in found if e.probability >= numbers["stated"]), key=lambda e: -e.gain)
    certain = {e.name: e.probability for e in found if e.probability >= likely}
    offered = sets.predicting(certain)
    verdict: Verdict = "explained"
    # only effects of the offered model count as explained
    if certain and (unlisted >= likely or certain.keys() - offered):
        verdict = "partly_explained"
    elif not certain:
        verdict = "unexplained" if flagged else "consistent"
    elif any(len(e.group) > 1 for e in found if e.name in certain):
        verdict = "ambiguous"
    return Decided(
        verdict, tuple(named), offered, tuple(rivals), unlisted, shape, terms, sets.probability
    )


def _terms(raw: Mapping[str, Any], sets: _Sets) -> tuple[Terms, str, float]:
    """Terms of the log odds of an effect, listed or not; the shape with most evidence, and that."""
    numbers, lead = sets.numbers, sets.evidence[sets.best] - sets.evidence[frozenset()]
    plain, best = (
        {name: x - numbers[f"usual {name.split()[0]}"] for name, x in raw["nameless"][fit].items()}
        for fit in ("plain", "best")
    )
    shape = max(best, key=lambda name: best[name])
    usual = [[numbers[f"usual misfit {row} {band}"] for band in BANDS] for row in ROWS]
    misfit = float(np.max(np.log(np.maximum(np.array(raw["misfit"]) / usual, 1e-9))))
    # The evidence of a shape is divided by that of the best set: small errors in a strong effect
    # leave residuals that a shape fits, above all a change of the robot.
    size = max(lead, 0.0) + numbers["evidence_scale"]
    of_change, of_others = (
        max([0.0, *(gain for name, gain in best.items() if name.startswith("change") is change)])
        for change in (True, False)
    )
    terms = {
        "constant": 1.0,
        "shape gain": float(np.log1p(of_others / size)),
        "misfit": float(np.clip(misfit, -2, 4)),
        "set evidence": _log(lead),
        "held-out gain": _log(sets.held_out_gain(sets.best, frozenset())),
        "change gain": float(np.log1p(of_change / size)),
        "unreferred": float(not raw.get("referred", True)),
        "shape lead": _log(max(plain.values()) - lead),
    }
    return terms, shape, best[shape]


def _logistic(terms: Terms, curve: str, numbers: Numbers) -> float:
    """Probability: the logistic function of a weighted sum of terms."""
    log_odds = float(sum(numbers[f"{curve}: {name}"] * term for name, term in terms.items()))
    return float(1 / (1 + np.exp(-np.clip(log_odds, -40, 40))))


def _log(value: float) -> float:
    """Signed logarithm of evidence: sign(x) log(1 + abs(x))."""
    return float(np.sign(value) * np.log1p(abs(value)))


def _names(entry: Mapping[str, Any]) -> Names:
    return frozenset((str(a), str(b)) for a, b in entry["names"])
