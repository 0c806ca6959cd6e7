"""What has changed, given how recordings of an unchanged servo differ among themselves.

An effect that is freed in one reference alone explains something there, though nothing has changed.
How much is the *null gain* of a change. A case is judged by it with Student's tails, references
being few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from sim2real.arrays import Array, Index
from sim2real.diagnose.contrast import LOAD, Comparison, Fitted
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.explained import LOAD_COLUMNS, Explained, explained
from sim2real.diagnose.link_effect import IrregularTiming, link_of
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.screening import FITTED
from sim2real.diagnose.unmodelled import Windows
from sim2real.effects import SET_ANEW
from sim2real.identification.servo_problem import Set
from sim2real.inference.evidence import student
from sim2real.inference.segments import Window
from sim2real.robot import Servo
from sim2real.servo.linearised import Residual
from sim2real.servo.trace import Trace

_MOST = 10
"""Changes, and pairs of them, that are fitted to the case."""
_NEAR = 0.3
"""Share of the best change's evidence from which another one stays in question."""
_HEADS = 3
"""Single changes to which a second one is added."""


@dataclass(frozen=True)
class Change:
    """What has changed on a joint."""

    # what it is, most probable first, each with those that it is confused with
    groups: tuple[Group, ...]
    probability: Mapping[str, float]  # of each change
    row: Array  # parameters of the case with what is most probable, shape (P,)
    nameless: float = 0.0  # probability that there is something that no change explains
    # where that is, for each recording, if it has an end or a beginning
    windows: Windows | None = None
    link: IrregularTiming | None = None  # irregular timing of the link since, or None
    # parameters of the changes that ``row`` has, by change and name
    sizes: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    left: float = 1.0  # mean square that it leaves, in that of the references

    @property
    def named(self) -> tuple[Group, ...]:
        """The groups that are probable."""
        return tuple(g for g in self.groups if g.probability >= DECISION.named)

    @property
    def effects(self) -> Set:
        """Effects of the catalogue that ``row`` has for what is named."""
        heads = {g.head for g in self.named} - {self.link.effect if self.link else ""}
        load = LOAD_COLUMNS.values() if LOAD in heads else ()
        return frozenset((heads - {*SET_ANEW}).union(load))


def what_changed(
    references: Sequence[Trace],
    case: Sequence[Trace],
    row: Array,
    servo: Servo,
    step_rad: float = 0.0,
) -> Change:
    """What of a joint differs from its references, whose servo has the parameters ``row`` (P,).

    Each change alone, two where the references show that one leaves something, or nothing.
    ``step_rad`` is the step of the case's sensor where that is coarser than stated.
    """
    of = explained(references, case, row, servo.position_step_rad)
    if not of.case.any():
        return Change((Group((LOAD,), 0.0),), {}, row)
    by = Comparison(of, servo)
    looks = by.screened(by.case, of.row)
    ranked = sorted(looks, key=lambda name: -looks[name][0])
    some = dict.fromkeys([*ranked[:_MOST], *(n for n in ranked if n in SET_ANEW)])
    fits = [by.fitted([name], looks[name][1], of.row) for name in some]
    best = max(fits, key=lambda fit: fit.evidence)
    by.doubt(best)
    least = _NEAR * best.evidence if best.evidence > 0 else best.evidence
    fits = [by.fitted(fit.names, fit.row, of.row) for fit in fits if fit.evidence >= least]
    change = _single(by, fits)
    wrong = DECISION.change.law_error**2 * by.start_bare
    least = min(fit.bare for fit in fits)
    if of.way == "repeat" and least > max(DECISION.change.misfit_ratio, wrong):
        change = _pair(by, fits) or change
    return _with_nameless(by, change, step_rad)


def _single(by: Comparison, fits: Sequence[Fitted]) -> Change:
    """One change, or none, or one that has no name."""
    numbers, way = DECISION.change, by.of.way
    best = max(fits, key=lambda fit: fit.evidence)
    # The mean gain of a change in unchanged recordings, of which the references are known.
    count = by.case.count * by.case.trust
    usual = numbers.null_rest * count if way == "rest" else numbers.null_repeat
    usual += numbers.null_law * count * by.misfit
    seen = []
    for reference in by.references:
        looks = by.screened(reference, by.of.row, only=best.names)
        seen.append(max(float(looks[name][0]) if name in looks else 0.0 for name in best.names))
    known = numbers.null_known + len(seen)
    null = (numbers.null_known * usual + sum(seen)) / known
    sure = float(expit(student(best.gain * best.trust / null, known) + LOG_PRIOR))
    behind = np.array([best.evidence - fit.evidence for fit in fits]) * best.trust
    share = np.exp(-behind / (1 + numbers.law_error**2 * 2 * best.gain * best.trust))
    # As likely of all parameters together as of all effects.
    share *= [len(FITTED) / len(SET_ANEW) if fit.names[0] in SET_ANEW else 1.0 for fit in fits]
    share *= sure / share.sum()
    probability = {fit.names[0]: float(p) for fit, p in zip(fits, share, strict=True)}
    group = _group(probability)
    (head,) = (fit for fit in fits if fit.names[0] == group.head)
    if way == "rest" or head.left > numbers.misfit_ratio:
        group = replace(group, probability=min(group.probability, numbers.most_certain))
    return Change((group,), probability, head.row, sizes=head.sizes, left=head.left)


def _group(probability: Mapping[str, float]) -> Group:
    """The most probable change and those that are indistinguishable from it."""
    order = sorted(probability, key=lambda n: -probability[n])
    members = [n for n in order if probability[n] >= DECISION.group_share * probability[order[0]]]
    sure = min(sum(probability[n] for n in members), DECISION.most_certain)
    return Group(tuple(members), sure)


def _pair(by: Comparison, fits: Sequence[Fitted]) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    alone = {fit.names[0]: fit for fit in fits}
    found: dict[Set, Fitted] = {}

    def extend(name: str, most: int) -> None:
        """Fit the changes that add most to this one."""
        first = alone.get(name) or by.fitted([name], by.of.row)
        looks = by.screened(by.case, first.row, present=frozenset((name,)))
        for other in sorted(looks, key=lambda n: -looks[n][0])[:most]:
            pair = frozenset((name, other))
            if pair not in found:
                found[pair] = by.fitted([name, other], looks[other][1])

    def best() -> Fitted:
        return max(found.values(), key=lambda fit: fit.evidence)

    for fit in sorted(fits, key=lambda fit: fit.bare)[:_HEADS]:
        extend(fit.names[0], _MOST // 2)
    for name in best().names:  # its rivals, together with the other one
        extend(name, _MOST // 2)
    two = best()
    least = min(fit.bare for fit in fits)
    if _unexplained(by, two.left) or DECISION.change.misfit_ratio * two.bare > least:
        return None
    probability: dict[str, float] = {}
    groups = []
    for head, other in (two.names, two.names[::-1]):
        rivals = {next(iter(p - {other})): fit for p, fit in found.items() if other in p}
        # As wrong as a law may be of what this one explains together with the other.
        more = max(two.gain - alone[other].gain if other in alone else two.gain, 0.0)
        blur = 1 + DECISION.change.law_error**2 * 2 * more * two.trust
        cost = {n: two.evidence - fit.evidence for n, fit in rivals.items()}
        weight = {n: float(np.exp(-x * two.trust / blur)) for n, x in cost.items()}
        total = sum(weight.values())
        mine = {n: DECISION.most_certain * w / total for n, w in weight.items()}
        groups.append(_group({head: mine.pop(head)} | mine))
        probability |= {n: 0.5 * p for n, p in mine.items() if p > probability.get(n, 0.0)}
        probability[head] = 0.5 * groups[-1].probability
    return Change(tuple(groups), probability, two.row, sizes=two.sizes, left=two.left)


def _unexplained(by: Comparison, left: float) -> bool:
    """Whether most of what a case has beyond its references is left, mean squares in theirs."""
    numbers = DECISION.change
    return left > max((1 - numbers.explained_share) * by.start, numbers.misfit_ratio)


def _with_nameless(by: Comparison, change: Change, step_rad: float) -> Change:
    """The change, and what is in the case besides that it does not explain."""
    of, numbers = by.of, DECISION.change
    remaining = replace(of, row=change.row).residual if change.named else of.residual
    # beyond what is named, a law is wrong by a share of what it explains
    jump = _largest_jump(of, of.residual - remaining)
    windows = jump_windows(of, remaining, max(step_rad, numbers.law_error * jump))
    left = change.left if change.named else by.start
    limit = numbers.foreign_misfit if of.way == "law" else numbers.misfit_ratio
    foreign = not change.named and left > limit
    if of.way == "repeat" and not change.named:
        # What a link does never stops.
        covered = sum(last - first for pieces in windows or () for first, last in pieces)
        lasting = covered > 0.5 * sum(trace.duration_s for trace in of.traces[of.references :])
        late = _irregular_timing(of) if windows is None or lasting else None
        if late is not None:
            return late
    badly = of.way != "law" and bool(change.named) and _unexplained(by, left)
    if windows is None and not foreign and not badly:
        return change
    known = 1 - DECISION.uncatalogued_probability
    return replace(
        change,
        groups=tuple(replace(g, probability=known * g.probability) for g in change.groups),
        probability={n: known * p for n, p in change.probability.items()},
        nameless=DECISION.uncatalogued_probability,
        windows=windows,
    )


def _jumps(of: Explained, residual: Array) -> tuple[Array, Array, Index]:
    """Times, sizes and recordings of steps of a residual (n,) between neighbouring samples.

    What acts on a shaft moves it smoothly. A residual jumps where the sensor, the clock or the horn
    does something of its own.
    """
    t = np.concatenate([trace.t[trace.used] for trace in of.traces])
    period = np.array([float(np.median(np.diff(trace.t))) for trace in of.traces])
    apart, place = np.diff(t), of.problem.recording
    good = (place[1:] == place[:-1]) & (apart < 1.5 * period[place[1:]])
    return t[1:][good], np.abs(np.diff(residual))[good], place[1:][good]


def _largest_jump(of: Explained, residual: Array, *, case: bool = True) -> float:
    """Largest step of a residual in the case or in the references, rad; 0 where none is."""
    _, size, place = _jumps(of, residual)
    return float(size[(place >= of.references) == case].max(initial=0.0))


def jump_windows(of: Explained, residual: Array, step_rad: float = 0.0) -> Windows | None:
    """From the first to the last jump that no reference has, in each recording of the case.

    To the recording's end where there is but one jump, or where the residual (n,) stays far larger
    than before. None where there are none.
    """
    usual = max(_largest_jump(of, of.residual, case=False), step_rad, of.least_sd)
    if of.way == "rest":  # the residual may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12)) * of.least_sd)
    if usual <= 0:
        return None
    numbers = DECISION.change
    ratio = numbers.repeated_jump_ratio if of.way == "repeat" else numbers.jump_ratio
    at, size, place = _jumps(of, residual)
    windows: list[tuple[Window, ...]] = []
    for r, trace in enumerate(of.traces[of.references :], start=of.references):
        when = at[(place == r) & (size > ratio * usual)]
        if not when.size:
            windows.append(())
            continue
        first, last = float(when[0]), float(when[-1])
        t, error2 = trace.t[trace.used], residual[of.problem.recording == r] ** 2
        before, after = error2[t < first], error2[t > last]
        stays = when.size == 1
        if before.size and after.size and not stays:
            usual2 = max(float(np.mean(before)), float(np.mean(of.residual[~of.case] ** 2)))
            stays = float(np.mean(after)) > numbers.lasting_ratio**2 * usual2
        if stays:
            last = float(trace.t[-1])
        windows.append(((first, last),))
    return tuple(windows) if any(windows) else None


def _irregular_timing(of: Explained) -> Change | None:
    """Jitter of the link that no repeat has, or None."""
    period, links = of.traces[0].period_s, []
    if not all(trace.used.any() for trace in of.traces):  # of commands that no other has
        return None
    for r, trace in enumerate(of.traces):
        error = np.zeros(trace.t.size)
        error[trace.used] = -of.residual[of.problem.recording == r]
        residual = Residual(trace, error, *of.row[:3].tolist())
        links.append(link_of([[residual]], lags=2, least_gain=1.0))
    late = [u.sizes.get("latency_jitter", (0.0, np.inf))[0] for u in links]
    worst = max(range(of.references, len(links)), key=lambda r: late[r])
    if late[worst] > period / 2:  # set-points would overtake each other
        return None
    null2 = max(DECISION.change.jitter_min_share * period, *late[: of.references]) ** 2
    known = DECISION.change.null_known + of.references
    odds = student(late[worst] ** 2 / null2, known) + LOG_PRIOR
    sure = min(float(expit(odds)), DECISION.most_certain)
    if sure < DECISION.named:
        return None
    effect = links[worst].effect
    return Change((Group((effect,), sure),), {effect: sure}, of.row, link=links[worst])
