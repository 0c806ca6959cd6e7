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

from sim2real.arrays import Array
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
from sim2real.diagnose.explained import Explained, energy, explained, loss, misstated, settled
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
"""Changes that are fitted to the case; those of them with which a second one is searched for."""


@dataclass(frozen=True)
class Change:
    """What has changed on a joint."""

    # what it is, most probable first; an effect and those that it is confused with, then parameters
    # of the plain servo that may be set anew instead. There is at least one. Nothing is resampled:
    # stability repeats probability
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
        return EffectPosterior(sets, probability, probability)


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
            groups = tuple(Group((effect,), sure, sure) for effect in effects)
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
    remaining = _without(of, change.row) if named else of
    steps = [np.diff(of.residuals[r] - remaining.residuals[r]) for r in of.case]
    explained_rad = max(float(np.nanmax(np.abs(x), initial=0.0)) for x in steps)
    usual = max(step_rad, DECISION.change.law_error * explained_rad)
    if of.way == "rest":  # the residual may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12 * of.scale2)))
    windows = jump_windows(remaining, usual)
    limit = DECISION.change.foreign_misfit * of.scale2
    foreign = of.way == "law" and not named and energy(settled(of)) > limit
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
    order = np.array([first, *(k for k in ranked[:_MOST] if k != first), *parameters])
    rows = []
    for k in order:
        name = effects.effects[k]
        own = [row for row, n in zip(by.rows, by.names, strict=True) if n == name]
        rows.append(fitted(of, [name], [effects.rows[k], own[0], own[-1]])[0])
    others = [_without(of, row) for row in rows]
    gone = (loss(of) - np.array([loss(x) for x in others])) / max(of.count(of.case), 1)
    remaining = np.array([energy(settled(x)) for x in others])
    # Near its start, what a change does to first order is as good.
    linear = (np.abs(effects.size[order]) < straight(of)) & (effects.gone[order] > gone)
    return replace(
        effects,
        effects=tuple(effects.effects[k] for k in order),
        gone=np.maximum(np.where(linear, effects.gone[order], gone), 0.0),
        remaining=np.where(linear, effects.remaining[order], remaining),
        size=effects.size[order],
        rows=np.where(linear[:, None], effects.rows[order], rows),
        usual=effects.usual[order],
        in_references=effects.in_references[order],
    )


def _without(of: Explained, row: Array) -> Explained:
    """The recordings less what a change of the servo to ``row`` (P,) does in the case."""
    angles = of.simulated(np.array([of.row, row]), of.case)
    case = (
        residual - (a[1] - a[0])
        for residual, a in zip(of.residuals[of.references :], angles, strict=True)
    )
    return replace(of, residuals=(*of.residuals[: of.references], *case))


def _single(of: Explained, effects: Contrast) -> Change:
    """One change, or none, or one that has no name."""
    weight = effects.evidence - effects.behind
    best = int(np.argmax(weight))
    sure = float(expit(effects.evidence[best] + LOG_PRIOR))
    strange = 0.0
    if of.way != "law":
        excess = max(float(effects.gone[best] + effects.remaining[best]) - effects.scale2, 0.0)
        beyond = max(float(effects.remaining[best]) - effects.scale2, 0.0)
        if beyond > (1 - DECISION.change.explained_share) * excess and beyond > effects.scale2:
            strange = DECISION.uncatalogued_probability
    retuned = np.exp(DECISION.change.retuned_log_odds)
    share = np.exp(weight - weight[best])
    share *= [retuned if n in BASE else 1.0 for n in effects.effects]
    share *= sure * (1 - strange) / share.sum()
    probability = {n: float(p) for n, p in zip(effects.effects, share, strict=True)}
    group = _group(probability)
    foreign = of.way == "law" and effects.remaining[best] > DECISION.change.misfit_ratio * of.scale2
    foreign = foreign or (of.way == "repeat" and _leaves_more(of, effects))
    if of.way == "rest" or foreign or any(n in BASE for n in group.members):
        most = min(group.probability, DECISION.change.most_certain)
        group = replace(group, probability=most, stability=most)
    row = effects.rows[effects.effects.index(group.members[0])]
    # A change, and no effect, unless it may well be one.
    anew = sum(p for n, p in probability.items() if n in BASE and n not in group.members)
    return Change((group,), probability, row, sure * strange + anew)


def _group(probability: Mapping[str, float]) -> Group:
    """Effects that are indistinguishable, and parameters of the plain servo that may have changed.

    The most probable is an effect; where a parameter is so much more probable that the two are
    distinguishable, no parameter is listed with it.
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


def _leaves_more(of: Explained, effects: Contrast) -> bool:
    """Whether the best change leaves more than repeats do and than the error of its law."""
    best = int(np.argmin(effects.remaining))
    wrong = DECISION.change.law_error**2 * effects.gone[best]
    return bool(effects.remaining[best] > max(DECISION.change.misfit_ratio * of.scale2, wrong))


def _pair(of: Explained, effects: Contrast, by: Directions, *, partners: int = 2) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    linear = first_pairs(of, by)
    fits: dict[Set, tuple[Array, float]] = {}

    def fit(starts: Mapping[Set, Array]) -> Set:
        """Fit pairs from these servos; the best of all so far."""
        for pair, row in starts.items():
            if pair not in fits:
                fit = fitted(of, sorted(pair), [row])
                fits[pair] = min(fit, linear.get(pair, fit), key=lambda fit: fit[1])
        return min(fits, key=lambda pair: fits[pair][1])

    fit({pair: row for pair, (row, _) in list(linear.items())[:_MOST]})
    order = [int(k) for k in np.argsort(effects.remaining) if effects.effects[k] not in BASE]
    for k in order[:partners]:
        head, row = effects.effects[k], effects.rows[k]
        second = contrast(_without(of, row), by)
        ranked = (int(p) for p in np.argsort(-second.gone))
        likely = [p for p in ranked if second.effects[p] not in (*BASE, head)][: _MOST // 2]
        fit({frozenset((head, second.effects[p])): row + second.rows[p] - of.row for p in likely})
    best = fit({})
    for name in sorted(best):  # its rivals, together with the other one
        with_it = {pair: row for pair, (row, _) in linear.items() if name in pair}
        fit(dict(list(with_it.items())[: _MOST // 2]))
    best = fit({})
    row, remaining = fits[best]
    whole = energy(of)
    beyond = max(remaining - of.scale2, 0.0)
    strange = beyond > (1 - DECISION.change.explained_share) * whole and beyond > of.scale2
    if strange or DECISION.change.misfit_ratio * remaining > float(effects.remaining.min()):
        return None
    probability: dict[str, float] = {}
    groups = []
    remaining_by = dict(zip(effects.effects, effects.remaining, strict=True))
    for head in sorted(best):
        (other,) = best - {head}
        rivals = {next(iter(p - {other})): m for p, (_, m) in fits.items() if other in p}
        # As wrong as a law may be of what this one explains together with the other.
        error2 = DECISION.change.law_error**2 * max(remaining_by.get(other, whole) - remaining, 0.0)
        blurred = of.scale2 + error2
        weight = {n: float(np.exp(-0.5 * (m - remaining) / blurred)) for n, m in rivals.items()}
        total = sum(weight.values())
        mine = {n: DECISION.most_certain * w / total for n, w in weight.items()}
        groups.append(_group(mine))
        probability |= {n: 0.5 * p for n, p in mine.items() if p > probability.get(n, 0.0)}
    return Change(tuple(groups), probability, row)


def jumps(of: Explained, r: int) -> tuple[Array, Array]:
    """Times and sizes of the residual's steps between samples that follow each other.

    What acts on a shaft moves it smoothly. A residual jumps where the sensor, the clock or the horn
    does something of its own.
    """
    t, residual = of.traces[r].t, of.residuals[r]
    apart, size = np.diff(t), np.abs(np.diff(residual))
    good = (apart < 1.5 * float(np.median(apart))) & np.isfinite(size)
    return t[1:][good], size[good]


def largest_jump(of: Explained, places: Sequence[int]) -> float:
    """Largest step of the residual in some recordings, rad; 0 where there is none."""
    return max((float(jumps(of, r)[1].max(initial=0.0)) for r in places), default=0.0)


def jump_windows(of: Explained, step_rad: float = 0.0) -> Windows | None:
    """From the first to the last jump that no reference has, in each recording of the case.

    To the recording's end where there is but one jump, or where the residual stays far larger than
    before. None where there are none.
    """
    usual = max(largest_jump(of, range(of.references)), step_rad)
    if usual <= 0:
        return None
    windows: list[tuple[Window, ...]] = []
    for r in of.case:
        at, size = jumps(of, r)
        when = at[size > BANKS[of.way].jump * usual]
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
    t, residual2 = of.traces[r].t, of.residuals[r] ** 2
    seen = of.seen(r)
    before, after = residual2[seen & (t < first)], residual2[seen & (t > last)]
    if before.size == 0 or after.size == 0:
        return False
    usual = max(float(np.mean(before)), of.scale2)
    return float(np.mean(after)) > DECISION.change.lasting_ratio**2 * usual


def _lasting(of: Explained, windows: Windows) -> bool:
    """Whether windows cover more than half of the case, as what a link does never stops."""
    covered = sum(last - first for pieces in windows for first, last in pieces)
    return covered > 0.5 * sum(float(np.ptp(of.traces[r].t)) for r in of.case)


def _irregular_timing(of: Explained, *, lags: int = 2, least_gain: float = 1.0) -> Change | None:
    """Jitter of the link that no repeat has, or None."""
    period = of.traces[0].period_s
    links = []
    for r, trace in enumerate(of.traces):
        seen = replace(trace, used=of.seen(r))
        residual = Residual(seen, -np.nan_to_num(of.residuals[r]), *of.row[:3].tolist())
        links.append(link_of(LinkData(((residual,),), lags, least_gain)))
    late = [u.value if u.effect == "latency_jitter" else 0.0 for u in links]
    worst = max(of.case, key=lambda r: late[r])
    if late[worst] > period / 2:  # set-points would overtake each other
        return None
    null2 = max(DECISION.change.jitter_min_share * period, *late[: of.references]) ** 2
    odds = student(late[worst] ** 2 / null2, BANKS[of.way].known + of.references) + LOG_PRIOR
    sure = min(float(expit(odds)), DECISION.most_certain)
    if sure < DECISION.named:
        return None
    effect = links[worst].effect
    return Change((Group((effect,), sure, sure),), {effect: sure}, of.row, link=links[worst])
