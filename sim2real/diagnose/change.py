"""What has changed, given how recordings of an unchanged servo differ among themselves.

What a servo lacks looks different in each recording: an effect that is freed in one reference alone
explains something there, though nothing has changed. How much, as a mean square over the
references' residual, is its *null size*. It is read off recordings of other unchanged servos
(``unchanged.json``) and off the case's own references, and the case is judged by it with Student's
tails, references being few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from sim2real.arrays import Array, Index
from sim2real.diagnose.contrast import (
    BANKS,
    Contrast,
    Directions,
    contrast,
    directions,
    first_pairs,
    fitted,
    straight,
)
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import EffectPosterior, Group
from sim2real.diagnose.explained import Explained, explained, misstated
from sim2real.diagnose.link_effect import IrregularTiming, LinkData, link_of
from sim2real.diagnose.unmodelled import Windows
from sim2real.identification.servo_problem import Set
from sim2real.inference.evidence import student
from sim2real.inference.segments import Window
from sim2real.robot import Servo
from sim2real.servo.linearised import Residual
from sim2real.servo.parameters import BASE
from sim2real.servo.trace import Trace

_MOST = 10
"""Changes, and pairs of them, that are fitted to the case."""


@dataclass(frozen=True)
class Change:
    """What has changed on a joint."""

    # what it is, most probable first; an effect and those that it is confused with, then parameters
    # of the plain servo that may be set anew instead. There is at least one
    groups: tuple[Group, ...]
    probability: Mapping[str, float]  # of each effect, and of each parameter of the plain servo
    row: Array  # parameters of the case with what is most probable, shape (P,)
    nameless: float = 0.0  # probability that there is something that no effect explains
    # where that is, for each recording, if it has an end or a beginning
    windows: Windows | None = None
    link: IrregularTiming | None = None  # irregular timing of the link since, or None

    def posterior(self, base: Set) -> EffectPosterior:
        """The probabilities as those of sets of effects, nothing more than ``base`` among them."""
        effects = {n: p for n, p in self.probability.items() if n not in (*BASE, *base)}
        order = sorted(effects, key=lambda n: -effects[n])
        sets = (base, *(base | {n} for n in order))
        probability = np.array([1 - sum(effects.values()), *(effects[n] for n in order)])
        return EffectPosterior(sets, probability)


def what_changed(
    references: Sequence[Trace],
    case: Sequence[Trace],
    row: Array,
    servo: Servo,
    step_rad: float = 0.0,
) -> Change:
    """What of a joint differs from its references, whose servo has the parameters ``row`` (P,)."""
    of = explained(references, case, row, servo)
    load = misstated(of)
    if load is not None:
        effects, with_load, gain = load
        sure = min(float(expit(gain)), DECISION.most_certain)
        if sure >= DECISION.named:  # a change seen through a wrong load is none
            groups = tuple(Group((effect,), sure) for effect in effects)
            return Change(groups, dict.fromkeys(effects, sure), with_load)
    return changed(of, step_rad)


def changed(of: Explained, step_rad: float = 0.0) -> Change:
    """What has changed in the case: each effect alone, two where a repeat shows two, or nothing."""
    by = directions(of)
    effects = first = contrast(of, by)
    if first.evidence.max() > DECISION.change.min_evidence:
        effects = _refined(of, first, by)
    change = _single(of, effects)
    if of.way == "repeat" and effects is not first and _leaves_more(of, effects):
        change = _pair(of, effects, by) or change
    named = change.groups[0].probability >= DECISION.named
    remaining = of.without(change.row) if named else of
    explained_rad = largest_jump(replace(of, residual=of.residual - remaining.residual))
    usual = max(step_rad, DECISION.change.law_error * explained_rad)
    if of.way == "rest":  # the residual may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12 * of.scale2)))
    windows = jump_windows(remaining, usual)
    limit = DECISION.change.foreign_misfit * of.scale2
    foreign = of.way == "law" and not named and of.settled.energy > limit
    if of.way == "repeat" and not named and (windows is None or _lasting(of, windows)):
        late = _irregular_timing(of)
        if late is not None:
            return late
    if windows is None and not foreign:
        return change
    known = 1 - DECISION.uncatalogued_probability
    return replace(
        change,
        groups=tuple(replace(g, probability=known * g.probability) for g in change.groups),
        probability={n: known * p for n, p in change.probability.items()},
        nameless=DECISION.uncatalogued_probability,
        windows=windows,
    )


def _refined(of: Explained, effects: Contrast, by: Directions) -> Contrast:
    """The contrast of its most probable changes, each fitted to the case."""
    ranked = [int(k) for k in np.argsort(-effects.gone)]
    first = next(k for k in ranked if effects.effects[k] not in BASE)
    parameters = [k for k in ranked[_MOST:] if effects.effects[k] in BASE]
    linear = effects[np.array([first, *(k for k in ranked[:_MOST] if k != first), *parameters])]
    rows = []
    for name, row in zip(linear.effects, linear.rows, strict=True):
        own = by.rows[[n == name for n in by.names]]
        rows.append(fitted(of, [name], [row, own[0], own[-1]])[0])
    others = [of.without(row) for row in rows]
    gone = (of.loss - np.array([x.loss for x in others])) / max(int(of.case.sum()), 1)
    remaining = np.array([x.settled.energy for x in others])
    # Near its start, what a change does to first order is as good.
    near = (np.abs(linear.size) < straight(of)) & (linear.gone > gone)
    return replace(
        linear,
        gone=np.maximum(np.where(near, linear.gone, gone), 0.0),
        remaining=np.where(near, linear.remaining, remaining),
        rows=np.where(near[:, None], linear.rows, rows),
    )


def _single(of: Explained, effects: Contrast) -> Change:
    """One change, or none, or one that has no name."""
    weight = effects.evidence - effects.behind
    best = int(np.argmax(weight))
    sure = float(expit(effects.evidence[best] + LOG_PRIOR))
    left, strange = float(effects.remaining[best]), 0.0
    if of.way != "law" and _unexplained(of, left, float(effects.gone[best]) + left):
        strange = DECISION.uncatalogued_probability
    retuned = np.exp(DECISION.change.retuned_log_odds)
    share = np.exp(weight - weight[best])
    share *= [retuned if n in BASE else 1.0 for n in effects.effects]
    share *= sure * (1 - strange) / share.sum()
    probability = {n: float(p) for n, p in zip(effects.effects, share, strict=True)}
    group = _group(probability)
    foreign = of.way == "law" and left > DECISION.change.misfit_ratio * of.scale2
    foreign = foreign or (of.way == "repeat" and _leaves_more(of, effects))
    if of.way == "rest" or foreign or any(n in BASE for n in group.members):
        most = min(group.probability, DECISION.change.most_certain)
        group = replace(group, probability=most)
    row = effects.rows[effects.effects.index(group.members[0])]
    # A change, and no effect, unless it may well be one.
    anew = sum(p for n, p in probability.items() if n in BASE and n not in group.members)
    return Change((group,), probability, row, sure * strange + anew)


def _unexplained(of: Explained, left: float, whole: float) -> bool:
    """Whether most of what a case has beyond its references, mean squares in rad2, is left."""
    beyond, every = left - of.scale2, max(whole - of.scale2, 0.0)
    return beyond > max((1 - DECISION.change.explained_share) * every, of.scale2)


def _group(probability: Mapping[str, float]) -> Group:
    """Effects that are indistinguishable, and parameters of the plain servo that may have changed.

    The most probable is an effect; where a parameter is so much more probable that the two are
    distinguishable, no parameter is listed with it.
    """
    order = sorted(probability, key=lambda n: -probability[n])
    first = next(n for n in order if n not in BASE)
    near = probability[first] >= DECISION.group_share * probability[order[0]]
    likely = [n for n in order if probability[n] >= DECISION.group_share * probability[first]]
    effects = [n for n in likely if n not in BASE]
    members = (*effects, *(n for n in likely if n in BASE and near))
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    return Group(members, sure)


def _leaves_more(of: Explained, effects: Contrast) -> bool:
    """Whether the best change leaves more than repeats do and than the error of its law."""
    best = int(np.argmin(effects.remaining))
    wrong = DECISION.change.law_error**2 * effects.gone[best]
    return bool(effects.remaining[best] > max(DECISION.change.misfit_ratio * of.scale2, wrong))


def _pair(of: Explained, effects: Contrast, by: Directions) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    pairs, fits = first_pairs(of, by), dict[Set, tuple[Array, float]]()

    def best_with(members: Set, count: int) -> Set:
        """The best pair of all so far, after the first few that have these members."""
        for pair, row in [one for one in pairs.items() if members <= one[0]][:count]:
            if pair not in fits:
                fits[pair] = fitted(of, sorted(pair), [row])
        return min(fits, key=lambda pair: fits[pair][1])

    best = best_with(frozenset(), _MOST)
    for name in sorted(best):  # its rivals, together with the other one
        best = best_with(frozenset((name,)), _MOST // 2)
    row, remaining = fits[best]
    if (
        _unexplained(of, remaining, of.energy + of.scale2)
        or DECISION.change.misfit_ratio * remaining > effects.remaining.min()
    ):
        return None
    probability: dict[str, float] = {}
    groups, alone = [], dict(zip(effects.effects, effects.remaining.tolist(), strict=True))
    for head in sorted(best):
        (other,) = best - {head}
        rivals = {next(iter(p - {other})): m for p, (_, m) in fits.items() if other in p}
        # As wrong as a law may be of what this one explains together with the other.
        gain = max(alone.get(other, of.energy) - remaining, 0.0)
        blurred = of.scale2 + DECISION.change.law_error**2 * gain
        weight = {n: float(np.exp(-0.5 * (m - remaining) / blurred)) for n, m in rivals.items()}
        total = sum(weight.values())
        mine = {n: DECISION.most_certain * w / total for n, w in weight.items()}
        groups.append(_group(mine))
        probability |= {n: 0.5 * p for n, p in mine.items() if p > probability.get(n, 0.0)}
    return Change(tuple(groups), probability, row)


def jumps(of: Explained) -> tuple[Array, Array, Index]:
    """Times, sizes and recordings of the residual's steps between samples that follow each other.

    What acts on a shaft moves it smoothly. A residual jumps where the sensor, the clock or the horn
    does something of its own.
    """
    t = np.concatenate([trace.t[trace.used] for trace in of.traces])
    period = np.array([float(np.median(np.diff(trace.t))) for trace in of.traces])
    apart, place = np.diff(t), of.recording
    good = (place[1:] == place[:-1]) & (apart < 1.5 * period[place[1:]])
    return t[1:][good], np.abs(np.diff(of.residual))[good], place[1:][good]


def largest_jump(of: Explained, *, case: bool = True) -> float:
    """Largest step of the residual in the case or in the references, rad; 0 where none is."""
    _, size, place = jumps(of)
    return float(size[(place >= of.references) == case].max(initial=0.0))


def jump_windows(of: Explained, step_rad: float = 0.0) -> Windows | None:
    """From the first to the last jump that no reference has, in each recording of the case.

    To the recording's end where there is but one jump, or where the residual stays far larger than
    before. None where there are none.
    """
    usual = max(largest_jump(of, case=False), step_rad)
    if usual <= 0:
        return None
    at, size, place = jumps(of)
    windows: list[tuple[Window, ...]] = []
    for r in range(of.references, len(of.traces)):
        when = at[(place == r) & (size > BANKS[of.way]["jump"] * usual)]
        if not when.size:
            windows.append(())
            continue
        first, last = float(when[0]), float(when[-1])
        if when.size == 1 or _stays(of, r, first, last):
            last = float(of.traces[r].t[-1])
        windows.append(((first, last),))
    return tuple(windows) if any(windows) else None


def _stays(of: Explained, r: int, first: float, last: float) -> bool:
    """Whether a recording is far off after the last jump, and was not before the first."""
    t, residual2 = of.traces[r].t[of.traces[r].used], of.residual[of.recording == r] ** 2
    before, after = residual2[t < first], residual2[t > last]
    if before.size == 0 or after.size == 0:
        return False
    usual = max(float(np.mean(before)), of.scale2)
    return float(np.mean(after)) > DECISION.change.lasting_ratio**2 * usual


def _lasting(of: Explained, windows: Windows) -> bool:
    """Whether windows cover more than half of the case, as what a link does never stops."""
    covered = sum(last - first for pieces in windows for first, last in pieces)
    return covered > 0.5 * sum(trace.duration_s for trace in of.traces[of.references :])


def _irregular_timing(of: Explained, *, lags: int = 2, least_gain: float = 1.0) -> Change | None:
    """Jitter of the link that no repeat has, or None."""
    period = of.traces[0].period_s
    links = []
    for r, trace in enumerate(of.traces):
        error = np.zeros(trace.t.size)
        error[trace.used] = -of.residual[of.recording == r]
        residual = Residual(trace, error, *of.row[:3].tolist())
        links.append(link_of(LinkData(((residual,),), lags, least_gain)))
    late = [u.value if u.effect == "latency_jitter" else 0.0 for u in links]
    worst = max(range(of.references, len(links)), key=lambda r: late[r])
    if late[worst] > period / 2:  # set-points would overtake each other
        return None
    null2 = max(DECISION.change.jitter_min_share * period, *late[: of.references]) ** 2
    odds = student(late[worst] ** 2 / null2, BANKS[of.way]["known"] + of.references) + LOG_PRIOR
    sure = min(float(expit(odds)), DECISION.most_certain)
    if sure < DECISION.named:
        return None
    effect = links[worst].effect
    return Change((Group((effect,), sure),), {effect: sure}, of.row, link=links[worst])
