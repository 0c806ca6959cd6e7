"""What a search in swims is worth saying: names, groups, probabilities, or that nothing fits.

Pure functions of what ``searched.raw`` keeps, so that ``benchmarks/pool_decisions.py`` reads
the thresholds off many searches without repeating one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.inference.coordinates import RESISTS
from sim2real.diagnose.result import Verdict

Array = NDArray[np.float64]
Name = tuple[str, str]
Names = frozenset[Name]
Spoken = tuple[float, ...]
Strange = tuple[float, float, float, float, float, float, float]

STATED, LIKELY = 0.05, 0.5
"""Probabilities from which an effect is told at all, and from which a model has it."""
_ENOUGH, _WIDEST = 0.7, 4
"""Probability that makes a group of several worth telling, and how many it may have."""
_EVIDENT = 30.0
"""Evidence beside which that of a shape counts where the best set has none."""


@dataclass(frozen=True)
class Named:
    """One effect that is named.

    Attributes:
        name: Effect and component.
        group: What these swims cannot tell from it, itself first.
        probability: That one of the group is there.
        gain: Evidence that it adds to the others.
        spoken: What its odds are made of, as ``terms_of`` takes it.
    """

    name: Name
    group: tuple[Name, ...]
    probability: float
    gain: float
    spoken: Spoken = ()


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
        strange: What the odds of ``unlisted`` are made of, as ``strange_terms`` takes it.
    """

    verdict: Verdict
    named: tuple[Named, ...]
    offered: Names
    rivals: tuple[tuple[Name, float], ...]
    unlisted: float
    shape: str
    strange: Strange = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
    usual = [[numbers[f"usual misfit {k} {b}"] for b in range(3)] for k in range(4)]
    off = float(np.max(np.log(np.maximum(np.array(raw["misfit"]) / usual, 1e-9))))
    ahead = worth[best] - worth[frozenset()]
    instead = max(without.values()) - ahead
    helps = _helps(best, frozenset(), held)
    alone = 0.0 if raw.get("referred", True) else 1.0
    strange = (
        max(shaped, default=0.0), max(changed, default=0.0), off, ahead, helps, alone, instead,
    )  # fmt: skip
    unlisted = _odds(strange_terms(strange), "strange", numbers)
    there = _odds(strange_terms(strange), "there", numbers)
    flagged = there >= numbers["flagged from"] or unlisted >= LIKELY
    gains = {
        name: worth[best] - worth.get(best - {name}, min(worth.values())) + cost for name in best
    }
    named = []
    for name, gain in gains.items():
        group = _group(name, best, worth, numbers)
        if flagged and len(best) == 1:
            group = _widened(group, keys, share)
        rest = best - {name}
        margin = worth[best] - max(worth[s] for s in keys if not s & set(group))
        spoken = (
            margin, gain, float(len(group)), more, off, _helps(best, rest, held),
            float(name[0] in RESISTS), max(gains.values()), unlisted, float(name[1] == "camera"),
            ahead, alone,
        )  # fmt: skip
        certain = min(_odds(terms_of(spoken), "odds", numbers), numbers["most_certain"])
        named.append(Named(name, group, certain, gain, spoken))
    likely = {one.name: one.probability for one in named if one.probability >= LIKELY}
    offered = _predicting(best & set(likely), held, worth, likely, numbers)
    others = {name for s in keys for name in s} - {n for one in named for n in one.group}
    named = [one for one in named if one.probability >= STATED]
    named.sort(key=lambda one: -one.gain)
    rivals = [(name, _there((name,), keys, share)) for name in others]
    rivals.sort(key=lambda one: (-one[1], one[0]))
    return Decided(
        _verdict(named, offered, unlisted, flagged), tuple(named), offered, tuple(rivals),
        unlisted, shape, strange,
    )  # fmt: skip


def _helps(now: Names, rest: Names, held: Mapping[Names, tuple[float, float]]) -> float:
    """How much likelier a set makes what was held out than another."""
    return held[rest][0] - held[now][0] if now in held and rest in held else 0.0


def _there(group: Sequence[Name], keys: Sequence[Names], share: Array) -> float:
    """Probability of the sets that have one of a group."""
    return float(sum(p for s, p in zip(keys, share, strict=True) if s & set(group)))


def _widened(group: tuple[Name, ...], keys: Sequence[Names], share: Array) -> tuple[Name, ...]:
    """A group with the next likeliest, until one of them is likely; itself if that takes many."""
    others = {name for s in keys for name in s} - set(group)
    wide = group
    for name in sorted(others, key=lambda one: -_there((one,), keys, share)):
        if _there(wide, keys, share) >= _ENOUGH or len(wide) >= _WIDEST:
            break
        wide = (*wide, name)
    return wide if _there(wide, keys, share) >= _ENOUGH else group


def _odds(terms: Sequence[float], which: str, numbers: Mapping[str, float]) -> float:
    """A probability: the logistic curve of a sum of terms."""
    told = float(sum(numbers[f"{which} {k}"] * term for k, term in enumerate(terms)))
    return float(1 / (1 + np.exp(-np.clip(told, -40, 40))))


def terms_of(spoken: Spoken) -> tuple[float, ...]:
    """What the odds of a name are a sum of.

    Args:
        spoken: By how much evidence the set is ahead of all that lack its group, what it adds
            itself, how many its group has, how much a shape without a name would add, how much more
            is left than usual, how much likelier it makes what was held out, whether it is an
            imitator, what the one that brings most adds, the probability that something is there
            that the catalogue lacks, whether it is the camera's, the evidence of the set, and
            whether no references were known.
    """
    margin, gain, many, more, off, helps, imitates, most, unlisted, camera, ahead, alone = spoken
    return (
        1.0, _log(margin), float(np.log(many)), max(_log(more) - _log(gain), 0.0),
        float(np.clip(off, -2, 4)), _log(helps), imitates, _log(most) - _log(gain),
        -float(np.log(max(1 - unlisted, 1e-3))), camera, _log(ahead), float(gain < most),
        _log(gain), imitates * alone,
    )  # fmt: skip


def strange_terms(strange: Strange) -> tuple[float, ...]:
    """What the odds of something that the catalogue lacks, or of anything, are a sum of.

    What a shape adds counts over the evidence of the best set: a strong effect that is not quite
    right leaves something that one of them fits, above all of a robot that becomes another.

    Args:
        strange: How much a shape without a name would add, how much a robot that becomes another
            one, how much more is left than usual, the evidence of the best set, how much likelier
            that makes what was held out, whether no references were known, and by how much a shape
            alone is ahead of the best set.
    """
    shaped, changed, off, best, helps, alone, instead = strange
    size = max(best, 0.0) + _EVIDENT
    return (
        1.0, float(np.log1p(max(shaped, 0.0) / size)), float(np.clip(off, -2, 4)), _log(best),
        _log(helps), float(np.log1p(max(changed, 0.0) / size)), alone, _log(instead),
    )  # fmt: skip


def _log(value: float) -> float:
    """Evidence, of which more and more counts less and less; either sign."""
    return float(np.sign(value) * np.log1p(abs(value)))


def _verdict(named: list[Named], offered: Names, unlisted: float, flagged: bool) -> Verdict:
    """In a word; explained is only what the model that is offered has."""
    likely = [one for one in named if one.probability >= LIKELY]
    if likely and (unlisted >= LIKELY or any(one.name not in offered for one in likely)):
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
