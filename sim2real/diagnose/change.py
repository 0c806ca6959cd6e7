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

from sim2real.arrays import Array
from sim2real.diagnose.contrast import LOAD, LOADS, Comparison, Fitted, compared, screened
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.explained import Explained, explained
from sim2real.diagnose.link_effect import IrregularTiming, LinkData, link_of
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.screening import FITTED
from sim2real.diagnose.unmodelled import Windows
from sim2real.effects import SET_ANEW
from sim2real.identification.servo_problem import Set
from sim2real.inference.evidence import student
from sim2real.inference.least_squares import rms
from sim2real.inference.segments import Window
from sim2real.noise import noise_floor
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
        heads = {g.members[0] for g in self.named} - {self.link.effect if self.link else ""}
        return frozenset((heads - {*SET_ANEW}) | {*(LOADS if LOAD in heads else ())})


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
    by = compared(of, servo)
    looks = screened(by.case, of.row, by.every)
    some = dict.fromkeys([*[*looks][:_MOST], *(name for name in looks if name in SET_ANEW)])
    fits = [by.fitted([name], [looks[name][1], of.row]) for name in some]
    best = max(fits, key=lambda fit: fit.evidence)
    by, least = by.doubted(best), min(_NEAR * best.evidence, best.evidence)
    near = [fit for fit in fits if fit.evidence >= least]
    fits = [by.fitted(fit.names, [fit.fit.row, of.row]) for fit in near]
    change = _single(by, fits)
    wrong = DECISION.change.law_error**2 * by.start[1]
    least = min(fit.left[1] for fit in fits)
    if of.way == "repeat" and least > max(DECISION.change.misfit_ratio, wrong):
        change = _pair(by, fits) or change
    return _with_nameless(by, change, step_rad)


def _single(by: Comparison, fits: Sequence[Fitted]) -> Change:
    """One change, or none, or one that has no name."""
    best = max(fits, key=lambda fit: fit.evidence)
    known, null = _null_gain(by, best)
    sure = float(expit(student(best.gain / null, known) + LOG_PRIOR))
    by_name = {fit.names[0]: fit for fit in fits}
    # as likely of all parameters together as of all effects
    more = len(FITTED) / len(SET_ANEW)
    group, probability = _group(by_name, best.gain, sure, more)
    head = by_name[group.members[0]]
    if by.of.way == "rest" or head.left[0] > DECISION.change.misfit_ratio:
        most = min(group.probability, DECISION.change.most_certain)
        group = replace(group, probability=most)
    return Change((group,), probability, head.fit.row, sizes=head.sizes, left=head.left[0])


def _null_gain(by: Comparison, best: Fitted) -> tuple[float, float]:
    """Number of unchanged recordings that are known, and the mean gain of a change in them."""
    numbers = DECISION.change
    usual = numbers.null_rest * by.count if by.of.way == "rest" else numbers.null_repeat
    if by.of.way == "law":  # the share of the residual that is not the sensor's noise
        traces = by.of.traces[: by.of.references]
        floor = max(noise_floor(t.t, t.command, t.position) for t in traces)
        usual += numbers.null_law * by.count * max(0.0, 1 - floor**2 / float(by.noise[0]))
    kinds = {name: by.every[name] for name in best.names}
    looks = [screened(one, by.of.row, kinds) for one in by.references]
    gains = [max((gain for gain, _ in look.values()), default=0.0) for look in looks]
    known = numbers.null_known + len(gains)
    return known, (numbers.null_known * usual + sum(gains)) / known


def _group(
    fits: Mapping[str, Fitted], gain: float, sure: float, set_anew: float = 1.0
) -> tuple[Group, dict[str, float]]:
    """The most probable change and those that are indistinguishable from it; the share of each.

    Together they are as probable as ``sure``; a parameter that is ``set_anew`` is that much more
    probable than an effect. Laws are wrong by a share of a ``gain``.
    """
    blur = 1 + DECISION.change.law_error**2 * 2 * gain
    evidence = np.array([fit.evidence for fit in fits.values()])
    share = np.exp((evidence - evidence.max()) / blur)
    share *= [set_anew if name in SET_ANEW else 1.0 for name in fits]
    share *= sure / share.sum()
    ranked = sorted(zip(fits, share.tolist(), strict=True), key=lambda entry: -entry[1])
    alike = [(name, p) for name, p in ranked if p >= DECISION.group_share * ranked[0][1]]
    total = min(sum(p for _, p in alike), DECISION.most_certain)
    return Group(tuple(name for name, _ in alike), total), dict(ranked)


def _pair(by: Comparison, fits: Sequence[Fitted]) -> Change | None:
    """Two changes together, where they explain far more than any does alone."""
    alone = {fit.names[0]: fit for fit in fits}
    found: dict[Set, Fitted] = {}
    heads = sorted(alone, key=lambda name: alone[name].left[1])[:_HEADS]
    for _ in range(2):  # then the rivals of either of the best two, together with the other one
        for name in heads:
            alone[name] = first = alone.get(name) or by.fitted([name], [by.of.row])
            looks = screened(by.case, first.fit.row, by.joining(first.fit.row, name))
            for other in [*looks][: _MOST // 2]:
                if frozenset((name, other)) not in found:
                    pair = by.fitted([name, other], [looks[other][1]])
                    found[frozenset((name, other))] = pair
        two = max(found.values(), key=lambda fit: fit.evidence)
        heads = list(two.names)
    least = min(fit.left[1] for fit in fits)
    if _unexplained(by, two.left[0]) or DECISION.change.misfit_ratio * two.left[1] > least:
        return None
    probability, groups = dict[str, float](), []
    for head, other in (two.names, two.names[::-1]):
        rivals = {next(iter(p - {other})): fit for p, fit in found.items() if other in p}
        # As wrong as a law may be of what this one explains together with the other.
        more = max(two.gain - (alone[other].gain if other in alone else 0.0), 0.0)
        group, mine = _group({head: two} | rivals, more, DECISION.most_certain)
        groups.append(group)
        for name, p in mine.items():
            probability[name] = max(probability.get(name, 0.0), 0.5 * p)
    return Change(tuple(groups), probability, two.fit.row, sizes=two.sizes, left=two.left[0])


def _unexplained(by: Comparison, left: float) -> bool:
    """Whether most of what a case has beyond its references is left, mean squares in theirs."""
    numbers = DECISION.change
    return left > max((1 - numbers.explained_share) * by.start[0], numbers.misfit_ratio)


def _with_nameless(by: Comparison, change: Change, step_rad: float) -> Change:
    """The change, and what is in the case besides that it does not explain."""
    of, numbers, named = by.of, DECISION.change, bool(change.named)
    residual = replace(of, row=change.row).residual if named else of.residual
    # beyond what is named, a law is wrong by a share of what it explains
    explained_jump = _jumps(of, of.residual - residual)[of.references :]
    largest = max((float(size.max(initial=0.0)) for _, size in explained_jump), default=0.0)
    windows = jump_windows(of, residual, max(step_rad, numbers.law_error * largest))
    left = change.left if named else by.start[0]
    if of.way == "repeat" and not named and (windows is None or _lasting(of, windows)):
        late = _irregular_timing(of)
        if late is not None:
            return late
    foreign = left > (numbers.foreign_misfit if of.way == "law" else numbers.misfit_ratio)
    badly = of.way != "law" and _unexplained(by, left)
    if windows is None and not (badly if named else foreign):
        return change
    known = 1 - DECISION.uncatalogued_probability
    return replace(
        change,
        groups=tuple(replace(g, probability=known * g.probability) for g in change.groups),
        probability={n: known * p for n, p in change.probability.items()},
        nameless=DECISION.uncatalogued_probability,
        windows=windows,
    )


def _jumps(of: Explained, residual: Array) -> list[tuple[Array, Array]]:
    """Times and sizes of steps of a residual (n,) between neighbouring samples, by recording.

    What acts on a shaft moves it smoothly. A residual jumps where the sensor, the clock or the horn
    does something of its own.
    """
    jumps = []
    for r, trace in enumerate(of.traces):
        t, error = trace.t[trace.used], residual[of.recording == r]
        good = np.diff(t) < 1.5 * float(np.median(np.diff(trace.t)))
        jumps.append((t[1:][good], np.abs(np.diff(error))[good]))
    return jumps


def jump_windows(of: Explained, residual: Array, step_rad: float = 0.0) -> Windows | None:
    """From the first to the last jump that no reference has, in each recording of the case.

    To the recording's end where there is but one jump, or where the residual (n,) stays far larger
    than before. None where there are none.
    """
    numbers, R = DECISION.change, of.references
    usual = [float(size.max(initial=0.0)) for _, size in _jumps(of, of.residual)[:R]]
    # at rest the residual may be nothing but a step of the sensor
    least = np.sqrt(12) * of.least_sd if of.way == "rest" else of.least_sd
    limit = numbers.repeated_jump_ratio if of.way == "repeat" else numbers.jump_ratio
    limit *= max(*usual, step_rad, least)
    windows = list[tuple[Window, ...]]()
    for r, (t, size) in enumerate(_jumps(of, residual)[R:], start=R):
        when, trace = t[size > limit], of.traces[r]
        if limit <= 0 or not when.size:
            windows.append(())
            continue
        error, at = residual[of.recording == r], trace.t[trace.used]
        before = max(rms([of.residual[~of.case]]), rms([error[at < when[0]]]))
        stays = rms([error[at > when[-1]]]) > numbers.lasting_ratio * before
        last = trace.t[-1] if when.size == 1 or stays else when[-1]
        windows.append(((float(when[0]), float(last)),))
    return tuple(windows) if any(windows) else None


def _lasting(of: Explained, windows: Windows) -> bool:
    """Whether windows cover more than half of the case, as what a link does never stops."""
    covered = sum(last - first for pieces in windows for first, last in pieces)
    return covered > 0.5 * sum(trace.duration_s for trace in of.traces[of.references :])


def _irregular_timing(of: Explained, *, lags: int = 2, least_gain: float = 1.0) -> Change | None:
    """Jitter of the link that no repeat has, or None."""
    period, links = of.traces[0].period_s, []
    if not all(trace.used.any() for trace in of.traces):  # of commands that no other has
        return None
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
    known = DECISION.change.null_known + of.references
    sure = float(expit(student(late[worst] ** 2 / null2, known) + LOG_PRIOR))
    sure, effect = min(sure, DECISION.most_certain), links[worst].effect
    if sure < DECISION.named:
        return None
    return Change((Group((effect,), sure),), {effect: sure}, of.row, link=links[worst])
