"""From recordings of a robot to what each of its joints is missing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sim2real.diagnose.case import (
    UNMODELLED_INERTIA,
    JointCase,
    batch_of,
    with_own_latency,
    with_slow_errors,
)
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.effect_probabilities import EffectPosterior, Group, posteriors
from sim2real.diagnose.effect_search import (
    search,
    search_again,
    size_in_noise,
    states_load,
    with_rotors,
)
from sim2real.diagnose.link_effect import IrregularTiming, link_of
from sim2real.diagnose.located import Rattle, rattles
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.servo_search import ServoSearch
from sim2real.diagnose.unmodelled import Unmodelled, beyond_noise, excess, unmodelled
from sim2real.effects import CATALOGUE, named
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import (
    FLAT_COLUMNS,
    SATURATION,
    Hypothesis,
    Set,
    Tried,
    joined,
    residual_angles,
)
from sim2real.progress import Progress
from sim2real.servo.batch import Batch
from sim2real.servo.linearised import Residual
from sim2real.servo.parameters import COLUMNS

ROUNDING = next(e.name for e in CATALOGUE if not e.fitted and e.component == "joint")
"""The effect that is read off the recorded numbers themselves."""
_DRY = "coulomb_friction"
_PRESLIDING = [
    COLUMNS.index(f"presliding_friction.{x}") for x in ("torque_Nm", "stiffness_Nm_per_rad")
]
_TIMED = [0, 1, 2, COLUMNS.index("clock_drift.s_per_s")]


@dataclass(frozen=True)
class Finding:
    """What one joint is missing."""

    tried: Tried  # every set of effects that was tried
    search: ServoSearch  # what may be asked of it further
    posterior: EffectPosterior  # their probabilities
    best: Hypothesis  # the most probable set
    mismatch: bool  # whether something is missing at all
    unexplained: bool  # whether the most probable set leaves something
    groups: tuple[Group, ...]  # what is missing, most probable first
    unmodelled: Unmodelled  # what could be missing without a name
    excess: float  # energy of the best set's residual beyond noise, in variances of the noise
    noise: float  # standard deviation of the sensor's noise, rad
    unknown: float = 0.0  # probability that what is missing is not in the catalogue
    rattle: Rattle | None = None  # what rattles in it, if gears are not among the effects
    link: IrregularTiming | None = None  # irregular timing of the link, or None
    place: int = 0  # of the joint among those of the link
    # parameters of what has changed since references, by change and name
    sizes: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)

    @property
    def unfinished(self) -> bool:
        """Whether the search was ended by its budget."""
        return self.tried.case in self.search.unfinished

    @property
    def structured(self) -> bool:
        """Whether the most probable set leaves more than noise and slow drift."""
        return self.excess > DECISION.structured_excess

    @property
    def effects(self) -> Set:
        """Effects of its groups."""
        return frozenset(effect for group in self.groups for effect in group.members)

    @property
    def irregularity(self) -> float:
        """Share by which irregular timing of the link raises the error of the joint."""
        assert self.link is not None
        return float(1 - np.exp(-self.link.shares[self.place] / self.best.fit.count[0]))

    def changes(self, unseen: Mapping[Set, Unseen], effect: str) -> float:
        """Share by which an effect, added to the others, lowers the held-out error.

        Infinite where that cannot be measured: of rounding, and where nothing is held out. Of
        irregular timing of the link it is the share by which it raises the error; none where
        set-points come no later than the controller's next turn would take them anyway.
        """
        if self.link is not None and effect in self.link.sizes:
            size, _ = self.link.sizes[effect]
            waits = effect == "latency_jitter" and size < DECISION.controller_wait_s
            return 0.0 if waits else self.irregularity
        best = self.best.members
        enriched = unseen.get(best)
        without = unseen.get(best - {effect}, unseen.get(self.tried.base))
        if effect not in best or enriched is None or without is None:
            return float("inf")
        return 1 - enriched.error / without.error


def investigate(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    *,
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> tuple[list[JointCase], list[Finding]]:
    """The joints of a robot as they were aligned, and what each is missing, from a first look."""
    joints = list(joints)
    findings = _findings(batch, joints, known, rng, lambda share: progress(0.6 * share))
    # Where structure stays, it is no sensor's noise: the noise model must then be free.
    again = [j for j, f in enumerate(findings) if batch.white or f.structured]
    if again:
        for j in again:
            joints[j] = with_own_latency(batch, joints[j], findings[j].best)
            joints[j] = with_slow_errors(joints[j], findings[j].best)
        some, before = [joints[j] for j in again], [findings[j].tried for j in again]
        free = batch_of(some, period=batch.period, bounded=False)
        for j, finding in zip(again, _findings(free, some, before, rng, again=True), strict=True):
            own = replace(placed(finding.tried, j), case=finding.tried.case)
            mismatch = finding.mismatch or findings[j].mismatch
            best = own.tried[finding.best.members]
            findings[j] = replace(finding, tried=own, best=best, mismatch=mismatch)
    batch = batch_of(joints, period=batch.period)
    findings, alone = _with_link(batch, joints, range(len(joints)), findings)
    for j in alone:  # where not all joints show it, one's own controller may be slow
        findings, _ = _with_link(batch, joints, [j], findings, DECISION.controller_wait_s)
    progress(1.0)
    return joints, findings


def placed(tried: Tried, joint: int) -> Tried:
    """What was tried in another batch, as of this joint of the full one."""
    moved = {s: replace(h, fit=h.fit.of_joints([joint])) for s, h in tried.tried.items()}
    return replace(tried, case=joint, tried=moved)


def _findings(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
    *,
    again: bool = False,
) -> list[Finding]:
    """The findings with the noise model of a batch, from what was tried before (``search``)."""
    level = DECISION.false_alarms / len(joints)
    cases, problem = search(batch, joints, known, level, rng, again=again, progress=progress)
    data = [joint.traces for joint in joints]
    _, excesses = beyond_noise(batch, data, joined([tried.best.fit for tried in cases]))
    structured = [
        tried
        for tried, joint, left in zip(cases, joints, excesses, strict=True)
        # Where readings come at irregular times the search goes on with free noise anyway.
        if left > DECISION.structured_excess
        and (batch.least_gain == 0 or joint.traces[0].spread is None)
    ]
    # A noise model that has taken up structure hides effects from the linear look.
    search_again(problem, structured)
    cases = with_rotors(problem, cases)
    probable = posteriors(cases, rng)
    best = [tried.tried[p.sets[0]] for tried, p in zip(cases, probable, strict=True)]
    fewer = [
        (tried, h.members - {effect}, h.fit.servos.theta[0])
        for tried, h in zip(cases, best, strict=True)
        for effect in h.members - tried.base
        if h.members - {effect} not in tried.tried
    ]
    problem.try_all(fewer, free=True)
    without = unmodelled(batch, data, joined([tried.plain.fit for tried in cases]))
    left, excesses = beyond_noise(batch, data, joined([h.fit for h in best]))
    rattling = rattles(data, left)
    return [
        Finding(
            tried=tried,
            search=problem,
            posterior=probable[j],
            best=best[j],
            mismatch=without[j].excess > DECISION.structured_excess
            or problem.remains(tried, tried.base),
            unexplained=excesses[j] > DECISION.structured_excess,
            groups=_groups(probable[j].groups(tried.base), best[j], joint),
            unmodelled=without[j],
            excess=excesses[j],
            noise=joint.noise,
            rattle=None if "backlash" in best[j].members else rattling[j],
        )
        for j, (joint, tried) in enumerate(zip(joints, cases, strict=True))
    ]


def _groups(groups: Sequence[Group], best: Hypothesis, joint: JointCase) -> tuple[Group, ...]:
    """The groups that are findings."""
    torque, stiffness = best.fit.servos.theta[0, _PRESLIDING]
    found = []
    for group in groups:
        if is_no_finding(best, group.head, joint):
            continue
        dry = group.head == "presliding_friction" and _DRY not in group.members
        if dry and torque <= joint.noise * stiffness:
            group = replace(group, members=(*group.members, _DRY))
        found.append(group)
    if joint.step_rad is not None:
        found.append(Group((ROUNDING,), DECISION.most_certain))
    return tuple(found)


def is_no_finding(best: Hypothesis, effect: str, joint: JointCase) -> bool:
    """Whether an effect is what every servo has a little of, or what its data sheet says anyway."""
    if named(effect).everywhere:
        return size_in_noise(best, effect, joint.noise) < DECISION.nuisance_finding_size
    if effect == UNMODELLED_INERTIA:
        return states_load(best, joint)
    limit = best.fit.servos.theta[0, FLAT_COLUMNS[0]]
    stated = effect == SATURATION and joint.stall_Nm is not None
    return bool(stated and limit > DECISION.data_sheet_share * (joint.stall_Nm or 0.0))


def _with_link(
    batch: Batch,
    joints: Sequence[JointCase],
    some: Sequence[int],
    findings: Sequence[Finding],
    longest_jitter_s: float = np.inf,
) -> tuple[list[Finding], list[int]]:
    """Findings with the link of some joints, and the joints that show it alone."""
    plain, best = [f.tried.plain for f in findings], [f.best for f in findings]
    least_gain = min(findings[j].search.batch.least_gain for j in some)
    link_with = partial(_link, batch, joints, some, least_gain)
    plain_link = best_link = link_with(plain)
    if any(best[j] is not plain[j] for j in some):
        best_link = link_with(best)
    explained = list(findings)
    if not _on_all(plain_link, best_link, [findings[j] for j in some]):
        shown = [j for j, share in zip(some, best_link.shares, strict=True) if share > 0]
        return explained, [j for j in shown if len(some) > 1 and findings[j].mismatch]
    lacks_rows = any(joints[i].lacks_rows for i in some)  # and so looks irregular
    # A second effect of the link may stand in for errors of one servo, plain or not.
    sure = plain_link.sizes.keys() & best_link.sizes.keys()
    for k, j in enumerate(some):
        finding, tried = findings[j], findings[j].tried
        # With all of a joint's effects, without one of them, or instead of them.
        options = [(best[j], best_link), (plain[j], plain_link)]
        most = max(link.shares[k] for _, link in options)
        for effect in best[j].members - tried.base:
            fewer = tried.tried.get(best[j].members - {effect}, plain[j])
            if fewer is not plain[j] and best[j].evidence - fewer.evidence <= most:
                servos = [fewer if i == j else servo for i, servo in enumerate(best)]
                options.append((fewer, link_with(servos, both=False)))
        servo, link = max(options, key=lambda option: option[0].evidence + option[1].shares[k])
        if link.gain <= 0:
            servo, link = options[0]
        elif len(sure) > 1 and link is not plain_link and link is not best_link:
            link = link_with([servo if i == j else other for i, other in enumerate(best)])
        sizes = {e: size for e, size in link.sizes.items() if e == link.effect or e in sure}
        link = replace(link, sizes=sizes)
        if link.gain <= 0 or link.sizes.get("latency_jitter", (np.inf,))[0] > longest_jitter_s:
            continue
        noise = float(np.sqrt(best[j].fit.error2[0] / best[j].fit.count[0]))
        remaining = excess(link.unexplained[k], joints[j].traces, batch, noise)
        remaining = min(remaining, finding.excess)
        unexplained = remaining > DECISION.structured_excess
        kept = servo.members | {ROUNDING}
        groups = [g for g in finding.groups if not kept.isdisjoint(g.members)]
        mismatch = not lacks_rows or unexplained or bool(groups)
        groups += [Group((e,), DECISION.most_certain) for e in link.sizes if not lacks_rows]
        explained[j] = replace(
            finding,
            mismatch=mismatch,
            unexplained=unexplained,
            excess=remaining,
            best=servo,
            groups=tuple(groups),
            link=None if lacks_rows else link,
            place=k,
        )
    return explained, []


def _on_all(
    plain_link: IrregularTiming, best_link: IrregularTiming, findings: Sequence[Finding]
) -> bool:
    """Whether timing is irregular on more than the joints whose own effects could imitate that.

    Or on few of them while the others do not contradict it, as a joint that hardly moves shows
    neither losses nor delays: rates that are common to all then explain as much as rates of each.
    """
    if max(plain_link.gain, best_link.gain) <= 0:
        return False
    contradiction = sum(best_link.shares) - best_link.gain
    if best_link.gain > 0 and contradiction < DECISION.link.max_contradiction:
        return True
    showing = [share > 0 for share in best_link.shares]
    free = [shows for shows, f in zip(showing, findings, strict=True) if not f.mismatch]
    if free and not any(free):
        return False
    return len(showing) < 2 or sum(showing) > 1


def _link(
    batch: Batch,
    joints: Sequence[JointCase],
    some: Sequence[int],
    least_gain: float,
    servos: Sequence[Hypothesis],
    *,
    both: bool = True,
) -> IrregularTiming:
    """What irregular timing explains of some joints; ``servos`` are those of all joints."""
    fits = [servos[j].fit.of_joints([j]) for j in some]
    left = []
    for j, fit, of_joint in zip(some, fits, residual_angles(batch, joined(fits)), strict=True):
        row = fit.servos.theta[0, _TIMED].tolist()
        pairs = zip(joints[j].traces, of_joint, strict=False)
        left.append([Residual(t, residual[: t.t.size], *row) for t, residual in pairs])
    return link_of(left, batch.lags, least_gain, DECISION.decisive_gain, both=both)
