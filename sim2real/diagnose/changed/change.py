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

from sim2real.diagnose.changed.contrast import Contrast, Unchanged, contrast
from sim2real.diagnose.changed.misstated_load import misstated
from sim2real.diagnose.changed.position_jumps import Steps
from sim2real.diagnose.changed.regression import (
    Directions,
    Explained,
    directions,
    energy,
    explained,
    first_pairs,
    fitted,
    loss,
    settled,
)
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.link.link_effect import LinkData, Uneven, link
from sim2real.diagnose.missing.effect_probabilities import EffectPosterior, Group
from sim2real.identification.servo_problem import Set
from sim2real.inference.evidence import student
from sim2real.inference.segments import Window
from sim2real.robot import Servo
from sim2real.servo.linearised import Residual
from sim2real.servo.parameters import BASE
from sim2real.servo.trace import Trace
from sim2real.structured import Fields, read_json

Array = NDArray[np.float64]

BANK = Path(__file__).with_name("unchanged.json")
_SCHEMA = "sim2real.unchanged/1"
_MOST = 10
"""Changes that are fitted for good; those of them that a second one is looked for beside."""


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


def _contrast(of: Explained, by: Directions, bank: Mapping[str, Unchanged] = BANKS) -> Contrast:
    return contrast(of, by, bank[of.way], _straight(of), DECISION.change.law_error)


def _straight(of: Explained) -> float:
    """How many times as far as its start a change goes along a straight line."""
    return DECISION.change.max_extrapolation if of.way == "law" else 1.0


@dataclass(frozen=True)
class Change:
    """What has changed on a joint.

    Attributes:
        groups: What it is, likeliest first; an effect and those that it can't be told from, then
            parameters of the plain servo that may be set anew instead. There is at least one.
            Nothing is resampled: stability repeats probability.
        probability: Of each effect, and of each parameter of the plain servo.
        row: Parameters of the case with what is likeliest, shape (P,).
        nameless: Probability that there is something that no effect explains.
        windows: Where that is, for each recording, if it has an end or a beginning.
        link: What is uneven on the link since, or None.
    """

    groups: tuple[Group, ...]
    probability: Mapping[str, float]
    row: Array
    nameless: float
    windows: tuple[tuple[Window, ...], ...] | None = None
    link: Uneven | None = None

    def posterior(self, base: Set) -> EffectPosterior:
        """The probabilities as those of sets of effects, nothing more than ``base`` among them."""
        effects = {n: p for n, p in self.probability.items() if n not in (*BASE, *base)}
        order = sorted(effects, key=lambda n: -effects[n])
        sets = (base, *(base | {n} for n in order))
        probability = np.array([1 - sum(effects.values()), *(effects[n] for n in order)])
        return EffectPosterior(sets, probability, probability)


def refined(of: Explained, found: Contrast, by: Directions) -> Contrast:
    """The contrast of its likeliest changes, each fitted to the case for good."""
    order = _likeliest(found)
    rows = [fitted(of, [found.effects[k]], _starts(found, by, int(k)))[0] for k in order]
    rests = [_without(of, row) for row in rows]
    count = sum(int(np.count_nonzero(of.seen(r))) for r in of.case)
    gone = (loss(of) - np.array([loss(rest) for rest in rests])) / max(count, 1)
    left = np.array([energy(settled(rest), of.case) for rest in rests])
    # Near its start, what a change does to first order is as good.
    linear = (np.abs(found.size[order]) < _straight(of)) & (found.gone[order] > gone)
    return replace(
        found,
        effects=tuple(found.effects[k] for k in order),
        gone=np.maximum(np.where(linear, found.gone[order], gone), 0.0),
        left=np.where(linear, found.left[order], left),
        size=found.size[order],
        rows=np.where(linear[:, None], found.rows[order], rows),
        usual=found.usual[order],
        before=found.before[order],
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
    first = _contrast(of, by, bank)
    found = first
    if first.evidence.max() > DECISION.change.min_evidence:
        found = refined(of, first, by)
    one = _alone(of, found)
    if of.way == "repeat" and found is not first and _leaves_more(of, found):
        one = _two(of, found, by) or one
    told = one.groups[0].probability >= DECISION.named
    rest = _without(of, one.row) if told else of
    wrong = max(_largest_step(of.left[r] - rest.left[r]) for r in of.case)
    usual = max(step_rad, DECISION.change.law_error * wrong)
    if of.way == "rest":  # what is left may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12 * of.scale2)))
    windows = Steps(rest, usual).windows(bank[of.way].jump)
    law = of.way == "law" and not told
    alien = law and energy(settled(of), of.case) > DECISION.change.foreign_misfit * of.scale2
    likely = of.way == "repeat" and not told and (windows is None or _lasting(of, windows))
    late = _uneven(of, bank[of.way].known) if likely else None
    if late is not None or (windows is None and not alien):
        return late or one
    less = {n: (1 - DECISION.uncatalogued_probability) * p for n, p in one.probability.items()}
    groups = tuple(
        replace(g, probability=(1 - DECISION.uncatalogued_probability) * g.probability)
        for g in one.groups
    )
    return replace(
        one,
        groups=groups,
        probability=less,
        nameless=DECISION.uncatalogued_probability,
        windows=windows,
    )


def _lasting(of: Explained, windows: tuple[tuple[Window, ...], ...]) -> bool:
    """Whether windows cover more than half of the case, as what a link does never stops."""
    covered = sum(last - first for some in windows for first, last in some)
    return covered > 0.5 * sum(float(np.ptp(of.traces[r].t)) for r in of.case)


def _uneven(
    of: Explained, known: float, *, lags: int = 2, least_gain: float = 1.0
) -> Change | None:
    """Jitter of the link that no repeat has, or None; ``known`` unchanged recordings in a bank.

    The noise remembers ``lags`` samples; ``least_gain`` of its whitening filter at frequency 0 is
    1, so that it takes nothing for itself that repeats may have from the link, too.
    """
    period = float(np.median(np.diff(of.traces[0].t)))
    found = [
        link(LinkData(((_residual(of, r),),), lags, least_gain)) for r in range(len(of.traces))
    ]
    late = [u.value if u.effect == "latency_jitter" else 0.0 for u in found]
    worst = max(of.case, key=lambda r: late[r])
    if late[worst] > period / 2:  # set-points would overtake each other
        return None
    null2 = max(DECISION.change.jitter_min_share * period, *late[: of.references]) ** 2
    odds = student(late[worst] ** 2 / null2, known + of.references) + LOG_PRIOR
    sure = min(float(expit(odds)), DECISION.most_certain)
    if sure < DECISION.named:
        return None
    group = Group((found[worst].effect,), sure, sure)
    return Change((group,), {found[worst].effect: sure}, of.row, 0.0, link=found[worst])


def _residual(of: Explained, r: int) -> Residual:
    one, left = of.traces[r], np.nan_to_num(of.left[r])
    kp, kd, latency = (float(x) for x in of.row[:3])
    return Residual(
        one.t, one.command, of.seen(r), -left, kp, kd, latency,
        one.load.inertia_kgm2, one.load.gravity_Nm,
    )  # fmt: skip


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
        if beyond > (1 - DECISION.change.explained_share) * excess and beyond > found.scale2:
            strange = DECISION.uncatalogued_probability
    share = np.exp(weight - weight[best])
    share *= [np.exp(DECISION.change.retuned_log_odds) if n in BASE else 1.0 for n in found.effects]
    share *= sure * (1 - strange) / share.sum()
    probability = {n: float(p) for n, p in zip(found.effects, share, strict=True)}
    group = _group(probability)
    foreign = of.way == "law" and found.left[best] > DECISION.change.misfit_ratio * of.scale2
    foreign = foreign or (of.way == "repeat" and _leaves_more(of, found))
    anew = any(n in BASE for n in group.members)
    if of.way == "rest" or foreign or anew:
        most = min(group.probability, DECISION.change.most_certain)
        group = replace(group, probability=most, stability=most)
    row = found.rows[found.effects.index(group.members[0])]
    # A change, and no effect, unless it may well be one.
    retuned = sum(p for n, p in probability.items() if n in BASE and n not in group.members)
    return Change((group,), probability, row, sure * strange + retuned)


def _group(probability: Mapping[str, float]) -> Group:
    """Effects that cannot be told apart, and what of the plain servo may be set anew instead.

    The likeliest is an effect; where a parameter is so much likelier that it can be told from it,
    none stands beside it.
    """
    order = sorted(probability, key=lambda n: -probability[n])
    first = next(n for n in order if n not in BASE)
    near = probability[first] >= DECISION.group_share * probability[order[0]]
    least = DECISION.group_share * probability[first]
    effects = [n for n in order if n not in BASE and probability[n] >= least]
    plain = [n for n in order if n in BASE and probability[n] >= least and near]
    members = (*effects, *plain)
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    return Group(members, sure, sure)


def _leaves_more(of: Explained, found: Contrast) -> bool:
    """Whether the best change leaves more than repeats do and than the error of its law."""
    best = int(np.argmin(found.left))
    wrong = DECISION.change.law_error**2 * found.gone[best]
    return bool(found.left[best] > max(DECISION.change.misfit_ratio * of.scale2, wrong))


def _two(of: Explained, found: Contrast, by: Directions, *, partners: int = 2) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    fits: dict[Set, tuple[Array, float]] = {}

    def fit(starts: Mapping[Set, Array]) -> Set:
        """Fit pairs from these servos; the best of all so far."""
        for pair, row in starts.items():
            if pair not in fits:
                for_good = fitted(of, sorted(pair), [row])
                straight = at_sight.get(pair, for_good)
                fits[pair] = min(for_good, straight, key=lambda fit: fit[1])
        return min(fits, key=lambda pair: fits[pair][1])

    at_sight = first_pairs(of, by)
    fit({pair: row for pair, (row, _) in list(at_sight.items())[:_MOST]})
    order = [int(k) for k in np.argsort(found.left) if found.effects[k] not in BASE]
    for k in order[:partners]:
        head, row = found.effects[k], found.rows[k]
        beside = _contrast(_without(of, row), by)
        ranked = (int(p) for p in np.argsort(-beside.gone))
        likely = [p for p in ranked if beside.effects[p] not in (*BASE, head)][: _MOST // 2]
        fit({frozenset((head, beside.effects[p])): row + beside.rows[p] - of.row for p in likely})
    best = fit({})
    for one in sorted(best):  # its rivals beside the other one
        with_it = {pair: row for pair, (row, _) in at_sight.items() if one in pair}
        fit(dict(list(with_it.items())[: _MOST // 2]))
    best = fit({})
    row, left = fits[best]
    whole = energy(of, of.case)
    beyond = max(left - of.scale2, 0.0)
    strange = beyond > (1 - DECISION.change.explained_share) * whole and beyond > of.scale2
    if strange or DECISION.change.misfit_ratio * left > float(found.left.min()):
        return None
    probability: dict[str, float] = {}
    groups = []
    for head in sorted(best):
        (other,) = best - {head}
        rivals = {next(iter(p - {other})): m for p, (_, m) in fits.items() if other in p}
        # As wrong as a law may be of what this one explains beside the other.
        alone = {e: m for e, m in zip(found.effects, found.left, strict=True)}.get(other, whole)
        blurred = of.scale2 + DECISION.change.law_error**2 * max(alone - left, 0.0)
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
