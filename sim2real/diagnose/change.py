"""What has changed, given how recordings of an unchanged servo differ among themselves.

Every servo lacks some physics, and what it lacks looks different in each recording: an effect that
is freed in one reference alone explains something there, though nothing has changed. How large each
effect looks in unchanged recordings is its *null size*: the mean square of the angles that it takes
away, over what the references leave. It is read off a bank of unchanged recordings of other servos
(``unchanged.json``) and off the case's own references, and the case is judged by it with Student's
tails, references being few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.posterior import Group, Posterior
from sim2real.inference.segments import Window
from sim2real.residuals.explained import (
    Directions,
    Explained,
    directions,
    energy,
    explained,
    first_look,
    fitted,
)
from sim2real.residuals.jumps import Steps
from sim2real.residuals.misstated import misstated
from sim2real.residuals.problem import Set
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE
from sim2real.servo.trace import Trace
from sim2real.structured import Fields, read_json

Array = NDArray[np.float64]

BANK = Path(__file__).with_name("unchanged.json")
_SCHEMA = "sim2real.unchanged/1"
_MOST, _PARTNERS = 10, 2
"""Changes that are fitted for good; those of them that a second one is looked for beside."""
_UNSURE = 0.85
"""Most that is said of what was seen at rest only, as a sensor may be bent there, and where the
law leaves far more of the case than of the references."""
_MORE = 4.0
"""How many times less two changes must leave than one, which must leave so much to be told."""


@dataclass(frozen=True)
class Unchanged:
    """What recordings look like in which nothing has changed, by the way they are explained.

    Attributes:
        known: How many of them there are.
        null: Null size of each effect, mean squares over what references leave.
        jump: Largest step of what is left, over the references', that is no sign of anything.
    """

    known: float
    null: Mapping[str, float]
    jump: float


def read_bank(path: Path = BANK) -> dict[str, Unchanged]:
    """The bank of a file, made by ``benchmarks/unchanged_bank.py``.

    Raises:
        InputError: If an entry is missing or no number.
    """
    ways = Fields(path, "", read_json(path, _SCHEMA)).table("ways")
    found = {}
    for way in ways.content:
        one = ways.table(way)
        null = one.table("null")
        sizes = {name: null.number(name) for name in null.content}
        found[way] = Unchanged(one.number("known"), sizes, one.number("jump"))
    return found


BANKS = read_bank()
"""What ships."""


@dataclass(frozen=True)
class Contrast:
    """What a change of each effect would explain of a joint's case.

    Attributes:
        effects: The effects, and parameters of the plain servo, of which there are N.
        gone: Mean square that each takes away from the case, rad2, shape (N,).
        null: The same where nothing has changed, shape (N,).
        left: Mean square that each leaves, shape (N,).
        rows: The case's servo with each, shape (N, P).
        known: Unchanged recordings behind the null sizes, the bank's included.
        scale2: Mean square that is left of the references.
    """

    effects: tuple[str, ...]
    gone: Array
    null: Array
    left: Array
    rows: Array
    known: float
    scale2: float

    @property
    def evidence(self) -> Array:
        """Log odds of each change, of unknown size, against none, without the prior, (N,).

        The score follows Student's law where there is no change; Laplace's integral over the size.
        """
        score2 = self.gone / self.null
        more = 0.5 * (self.known + 1) * np.log1p(score2 / self.known)
        return np.asarray(more - 0.5 * np.log1p(score2))

    @property
    def misfit(self) -> Array:
        """What each leaves beyond what the best leaves, in nats, shape (N,).

        A law is not quite what a servo does: it may be wrong by a share of what it explains.
        """
        best = int(np.argmin(self.left))
        blurred = self.null[best] + DECISION.change_law_error**2 * self.gone[best]
        return np.asarray(0.5 * (self.left - self.left[best]) / blurred)


def contrast(of: Explained, by: Directions, bank: Mapping[str, Unchanged] = BANKS) -> Contrast:
    """Weigh a change of each effect against none, at first sight."""
    names = tuple(dict.fromkeys(by.names))
    place = [np.flatnonzero([n == name for n in by.names]) for name in names]
    gone, size = first_look(of, by, of.case)
    # What is not fitted for good must need no far extrapolation.
    far = np.maximum(np.abs(size) / DECISION.change_farthest, 1.0) ** 2
    near = gone / far if of.way == "law" else gone
    best = np.array([mine[np.argmax(near[mine])] for mine in place])
    telling = [r for r in range(of.references) if of.seen(r).any()]
    before = [first_look(of, by, [r])[0] for r in telling]
    unchanged = bank[of.way]
    usual = float(np.median(list(unchanged.null.values())))
    null = np.array([unchanged.null.get(name, usual) for name in names]) * unchanged.known
    null = null * of.scale2
    for one in before:
        null = null + [one[mine].max() for mine in place]
    known = unchanged.known + len(before)
    rows = of.row + (by.rows[best] - of.row) * np.clip(size[best], -1, 1)[:, None]
    whole = energy(of, of.case)
    return Contrast(names, near[best], null / known, whole - gone[best], rows, known, of.scale2)


@dataclass(frozen=True)
class Change:
    """What has changed on a joint.

    Attributes:
        groups: What it is, likeliest first; an effect and those that it can't be told from. There
            is at least one. Nothing is resampled: stability repeats probability.
        probability: Of each effect, and of each parameter of the plain servo.
        row: Parameters of the case with what is likeliest, shape (P,).
        nameless: Probability that there is something that no effect explains.
        windows: Where that is, for each recording, if it has an end or a beginning.
    """

    groups: tuple[Group, ...]
    probability: Mapping[str, float]
    row: Array
    nameless: float
    windows: tuple[tuple[Window, ...], ...] | None = None

    def posterior(self, base: Set) -> Posterior:
        """The probabilities as those of sets of effects, nothing more than ``base`` among them."""
        effects = {n: p for n, p in self.probability.items() if n not in (*BASE, *base)}
        order = sorted(effects, key=lambda n: -effects[n])
        sets = (base, *(base | {n} for n in order))
        probability = np.array([1 - sum(effects.values()), *(effects[n] for n in order)])
        return Posterior(sets, probability, probability)


def refined(of: Explained, found: Contrast, by: Directions) -> Contrast:
    """The contrast of its likeliest changes, each fitted to the case for good."""
    order = _likeliest(found)
    fits = [fitted(of, [found.effects[k]], _starts(found, by, int(k))) for k in order]
    left = np.array([mean for _, mean in fits])
    if of.way == "law":  # where the servo may change along, to first order
        left = np.minimum(left, found.left[order])
    gone = np.maximum(energy(of, of.case) - left, 0.0)
    return replace(
        found,
        effects=tuple(found.effects[k] for k in order),
        gone=gone,
        null=found.null[order],
        left=left,
        rows=np.array([row for row, _ in fits]),
    )


def _likeliest(found: Contrast) -> NDArray[np.intp]:
    """Places of those that are fitted: at least one effect, and whatever may be set anew."""
    order = [int(k) for k in np.argsort(-found.gone)]
    first = next(k for k in order if found.effects[k] not in BASE)
    anew = [k for k in order[_MOST:] if found.effects[k] in BASE]
    return np.array([first, *(k for k in order[:_MOST] if k != first), *anew])


def _starts(found: Contrast, by: Directions, k: int) -> list[Array]:
    every = [row for row, name in zip(by.rows, by.names, strict=True) if name == found.effects[k]]
    return [found.rows[k], every[0], every[-1]]


def changed(of: Explained, step_rad: float = 0.0, bank: Mapping[str, Unchanged] = BANKS) -> Change:
    """What has changed in the case: each effect alone, two where a repeat shows two, or nothing.

    Args:
        of: The recordings, explained.
        step_rad: Step of the case's sensor, which is no jump.
        bank: How large changes look where there are none.
    """
    by = directions(of)
    first = contrast(of, by, bank)
    found = first
    if first.evidence.max() > DECISION.change_worth:
        found = refined(of, first, by)
    one = _alone(of, found)
    if of.way == "repeat" and found is not first and _leaves_more(of, found):
        one = _two(of, found, by) or one
    told = one.groups[0].probability >= DECISION.named
    rest = _without(of, one.row) if told else of
    wrong = max(_largest_step(of.left[r] - rest.left[r]) for r in of.case)
    usual = max(step_rad, DECISION.change_law_error * wrong)
    if of.way == "rest":  # what is left may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12 * of.scale2)))
    windows = Steps(rest, usual).windows(bank[of.way].jump)
    if windows is None:
        return one
    less = {n: (1 - DECISION.nameless) * p for n, p in one.probability.items()}
    groups = tuple(
        replace(g, probability=(1 - DECISION.nameless) * g.probability) for g in one.groups
    )
    return replace(
        one, groups=groups, probability=less, nameless=DECISION.nameless, windows=windows
    )


def _largest_step(values: Array) -> float:
    return float(np.nanmax(np.abs(np.diff(values)), initial=0.0))


def _without(of: Explained, row: Array) -> Explained:
    """The recordings less what a change of the servo to ``row`` (P,) does in the case."""
    angles = of.simulated(np.array([of.row, row]), of.case)
    case = (left - (a[1] - a[0]) for left, a in zip(of.left[of.references :], angles, strict=True))
    return replace(of, left=(*of.left[: of.references], *case))


def _alone(of: Explained, found: Contrast) -> Change:
    """One change, or none, or one that has no name."""
    weight = found.evidence - found.misfit
    best = int(np.argmax(weight))
    sure = float(expit(found.evidence[best] + LOG_PRIOR))
    strange = 0.0
    if of.way != "law":
        excess = max(float(found.gone[best] + found.left[best]) - found.scale2, 0.0)
        beyond = max(float(found.left[best]) - found.scale2, 0.0)
        if beyond > (1 - DECISION.change_explained) * excess and beyond > found.scale2:
            strange = DECISION.nameless
    share = np.exp(weight - weight[best])
    share *= [np.exp(DECISION.change_retuned) if n in BASE else 1.0 for n in found.effects]
    share *= sure * (1 - strange) / share.sum()
    probability = {n: float(p) for n, p in zip(found.effects, share, strict=True)}
    group = _group(probability)
    foreign = of.way == "law" and found.left[best] > _MORE * of.scale2
    if of.way == "rest" or foreign:
        most = min(group.probability, _UNSURE)
        group = replace(group, probability=most, stability=most)
    row = found.rows[found.effects.index(group.members[0])]
    retuned = sum(p for n, p in probability.items() if n in BASE)  # a change, and no effect
    return Change((group,), probability, row, sure * strange + retuned)


def _group(probability: Mapping[str, float]) -> Group:
    order = sorted((n for n in probability if n not in BASE), key=lambda n: -probability[n])
    least = DECISION.group_share * probability[order[0]]
    members = tuple(n for n in order if probability[n] >= least)
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    return Group(members, sure, sure)


def _leaves_more(of: Explained, found: Contrast) -> bool:
    """Whether the best change leaves more than repeats do and than the error of its law."""
    best = int(np.argmin(found.left))
    wrong = DECISION.change_law_error**2 * found.gone[best]
    return bool(found.left[best] > max(_MORE * of.scale2, wrong))


def _two(of: Explained, found: Contrast, by: Directions) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    order = [int(k) for k in np.argsort(found.left) if found.effects[k] not in BASE]
    fits: dict[Set, tuple[Array, float]] = {}
    for k in order[:_PARTNERS]:
        head, row = found.effects[k], found.rows[k]
        rest = _without(of, row)
        beside = contrast(rest, by)
        ranked = (int(p) for p in np.argsort(-beside.gone))
        likely = [p for p in ranked if beside.effects[p] not in (*BASE, head)]
        for p in likely[:_MOST]:
            pair = frozenset((head, beside.effects[p]))
            if pair not in fits:
                start = row + beside.rows[p] - of.row
                fits[pair] = fitted(of, sorted(pair), [start])
    best = min(fits, key=lambda pair: fits[pair][1])
    row, left = fits[best]
    whole = energy(of, of.case)
    beyond = max(left - of.scale2, 0.0)
    strange = beyond > (1 - DECISION.change_explained) * whole and beyond > of.scale2
    if strange or _MORE * left > float(found.left.min()):
        return None
    probability: dict[str, float] = {}
    groups = []
    for head in sorted(best):
        (other,) = best - {head}
        rivals = {next(iter(p - {other})): m for p, (_, m) in fits.items() if other in p}
        # As wrong as a law may be of what this one explains beside the other.
        alone = {e: m for e, m in zip(found.effects, found.left, strict=True)}.get(other, whole)
        blurred = of.scale2 + DECISION.change_law_error**2 * max(alone - left, 0.0)
        weight = {n: float(np.exp(-0.5 * (m - left) / blurred)) for n, m in rivals.items()}
        total = sum(weight.values())
        mine = {n: DECISION.most_certain * w / total for n, w in weight.items()}
        groups.append(_group(mine))
        probability |= {n: 0.5 * p for n, p in mine.items() if p > probability.get(n, 0.0)}
    return Change(tuple(groups), probability, row, 0.0)


def what_changed(
    before: Sequence[Trace],
    case: Sequence[Trace],
    row: Array,
    servo: Servo,
    step_rad: float = 0.0,
) -> Change:
    """What of a joint differs from its references.

    Args:
        before: The joint's references.
        case: Its recordings in question.
        row: Parameters of the servo as the references tell it, shape (P,).
        servo: Its data sheet.
        step_rad: Step of the case's sensor.
    """
    of = explained(before, case, row, servo)
    load = misstated(of)
    if load is not None:
        sure = min(float(expit(load.gain)), DECISION.most_certain)
        if sure >= DECISION.named:  # a change seen through a wrong load is none
            groups = tuple(Group((effect,), sure, sure) for effect in load.effects)
            return Change(groups, dict.fromkeys(load.effects, sure), load.row, 0.0)
    return changed(of, step_rad)
