"""From recordings of any number of robots to what each joint is missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.link_effect import LinkData, links
from sim2real.diagnose.link.lost_packets import Uneven
from sim2real.diagnose.missing.baseline import baselines, plain_again
from sim2real.diagnose.missing.effect_probabilities import EffectPosterior, Group, posteriors
from sim2real.diagnose.missing.effect_search import search
from sim2real.diagnose.missing.nuisances import size_in_noise
from sim2real.diagnose.missing.servo_search import ServoSearch
from sim2real.diagnose.missing.unmodelled import Unmodelled, beyond_noise, unmodelled
from sim2real.effects import CATALOGUE, named
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Hypothesis, Set, Tried, joined, residual_angles
from sim2real.servo.batch import Batch
from sim2real.servo.linearised import Residual
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

ROUNDING = next(e.name for e in CATALOGUE if not e.fitted and e.component == "joint")
"""The effect that is read off the recorded numbers themselves."""


_DRY = "coulomb_friction"
_PRESLIDING = [
    COLUMNS.index(f"presliding_friction.{x}") for x in ("torque_Nm", "stiffness_Nm_per_rad")
]
_LIMIT = COLUMNS.index("torque_saturation.limit_Nm")
_INERTIA = COLUMNS.index("unmodelled_inertia.inertia_kgm2")


@dataclass(frozen=True)
class Finding:
    """What one joint is missing.

    Attributes:
        tried: Every set of effects that was tried.
        search: What may be asked of it further.
        posterior: Their probabilities.
        best: The likeliest set.
        mismatch: Whether something is missing at all.
        left: Whether the likeliest set leaves something.
        groups: What is missing, likeliest first.
        unmodelled: What could be missing without a name.
        unknown: Probability that what is missing is not in the catalogue.
        excess: Energy of the best set's residual beyond noise, in variances of the noise.
        noise: Standard deviation of the sensor's noise, rad.
        step_rad: Step of an angle sensor that is coarser than stated, or None.
        link: What is uneven on the link, or None.
        place: Of the joint among those of the link.
    """

    tried: Tried
    search: ServoSearch
    posterior: EffectPosterior
    best: Hypothesis
    mismatch: bool
    left: bool
    groups: tuple[Group, ...]
    unmodelled: Unmodelled
    unknown: float
    excess: float
    noise: float
    step_rad: float | None
    link: Uneven | None = None
    place: int = 0

    @property
    def unfinished(self) -> bool:
        """Whether the search was ended by its budget."""
        return self.tried.case in self.search.unfinished

    @property
    def said(self) -> Set:
        """Effects of its groups."""
        return frozenset(effect for group in self.groups for effect in group.members)

    @property
    def uneven(self) -> float:
        """Share by which an uneven link raises the error of the joint."""
        assert self.link is not None
        return float(1 - np.exp(-self.link.shares[self.place] / self.best.fit.count[0]))

    def changes(self, unseen: Mapping[Set, Unseen], effect: str) -> float:
        """Share by which an effect lowers the held-out error beside the others; or infinity.

        Infinity where that cannot be told: of rounding, and where nothing is held out. Of an
        uneven link, which nobody can foretell, it is the share by which it raises the error; none
        where set-points come no later than the controller's next turn would take them anyway.
        """
        if self.link is not None and self.link.effect == effect:
            waits = effect == "latency_jitter" and self.link.value < DECISION.controller_wait_s
            return 0.0 if waits else self.uneven
        best = self.best.members
        rich = unseen.get(best)
        without = unseen.get(best - {effect}, unseen.get(self.tried.base))
        if effect not in best or rich is None or without is None:
            return float("inf")
        return 1 - rich.rmse / without.rmse


def investigate(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    *,
    rng: np.random.Generator,
    known: Sequence[Tried] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Finding]:
    """Find what each joint is missing.

    Args:
        batch: The recordings, joint by joint.
        joints: The joints of the batch.
        robots: Which of them share a supply and a link.
        rng: For bootstraps.
        known: What a first look at each joint said, where there was one.
        progress: Called with the share that is done.
    """
    findings = _pass(batch, joints, robots, rng, lambda share: progress(0.7 * share), known)
    # Where structure stays, it is no sensor's noise: the noise model must then be free.
    again = [j for j, finding in enumerate(findings) if finding.excess > DECISION.structured_excess]
    if again:
        some = [joints[j] for j in again]
        free = Batch(
            [one.traces for one in some],
            batch.device,
            batch.threads,
            bounded=False,
            period=batch.period,
        )
        groups = [[again.index(j) for j in robot if j in again] for robot in robots]
        groups = [group for group in groups if group]
        seen = [findings[j].tried for j in again]
        second = _pass(free, some, groups, rng, lambda share: progress(0.7 + 0.3 * share), seen)
        for j, finding in zip(again, second, strict=True):
            mismatch = finding.mismatch or findings[j].mismatch
            findings[j] = replace(_placed(finding, j), mismatch=mismatch)
    findings = _with_links(batch, joints, robots, findings)
    progress(1.0)
    return findings


def _placed(finding: Finding, joint: int) -> Finding:
    """A finding of another batch, its fits those of this joint of the whole one."""
    tried = replace(placed(finding.tried, joint), case=finding.tried.case)
    return replace(finding, tried=tried, best=tried.tried[finding.best.members])


def placed(tried: Tried, joint: int) -> Tried:
    """What was tried in another batch, as of this joint of the whole one."""
    at = np.array([joint], dtype=np.int32)
    moved = {
        members: replace(h, fit=replace(h.fit, servos=replace(h.fit.servos, joint=at)))
        for members, h in tried.tried.items()
    }
    return replace(tried, case=joint, tried=moved)


def _with_links(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    findings: Sequence[Finding],
) -> list[Finding]:
    """Findings that also say what is uneven on the link.

    Set-points that come unevenly can pass for a weak effect. So the link is looked at twice: with
    what was found on its joints and without.
    """
    plain, best = [f.tried.plain for f in findings], [f.best for f in findings]
    richer = [robot for robot in robots if any(best[j] is not plain[j] for j in robot)]
    both = links(
        [link_data(batch, joints, robot, plain) for robot in robots]
        + [link_data(batch, joints, robot, best) for robot in richer]
    )
    with_effects = {robot[0]: link for robot, link in zip(richer, both[len(robots) :], strict=True)}
    explained = list(findings)
    for robot, alone in zip(robots, both, strict=False):
        beside = with_effects.get(robot[0], alone)
        if not _on_all(alone, beside, [findings[j] for j in robot]):
            continue
        for k, j in enumerate(robot):
            finding = findings[j]
            own = finding.best.evidence - finding.tried.plain.evidence
            instead = alone.shares[k] > beside.shares[k] + own
            link = alone if instead and alone.gain > 0 else beside
            if link.gain > 0:
                explained[j] = _uneven(finding, link, k, instead=instead)
    return explained


def _uneven(finding: Finding, link: Uneven, k: int, *, instead: bool) -> Finding:
    """The finding with an uneven link, beside or ``instead`` of the joint's own effects."""
    rest = () if instead else finding.groups
    return replace(
        finding,
        mismatch=True,
        best=finding.tried.plain if instead else finding.best,
        groups=(*rest, Group((link.effect,), DECISION.most_certain, 1.0)),
        link=link,
        place=k,
    )


def _on_all(alone: Uneven, beside: Uneven, findings: Sequence[Finding]) -> bool:
    """Whether a link is uneven on more than the joints whose own effects could pass for it."""
    if max(alone.gain, beside.gain) <= 0:
        return False
    showing = [share > 0 for share in beside.shares]
    free = [shows for shows, f in zip(showing, findings, strict=True) if not f.mismatch]
    if free and not any(free):
        return False
    return len(showing) < 2 or sum(showing) > 1


def link_data(
    batch: Batch,
    joints: Sequence[JointCase],
    robot: Sequence[int],
    fits: Sequence[Hypothesis],
    noticed: float = DECISION.decisive_gain,
) -> LinkData:
    """What fits leave of a robot's joints, for ``links``."""
    residuals = residual_angles(batch, joined([fits[j].fit for j in robot]))
    left = tuple(
        tuple(
            link_residual(t, t.used, residual[r, : t.t.size], fits[j].fit.servos.theta[0])
            for r, t in enumerate(joints[j].traces)
        )
        for j, residual in zip(robot, residuals, strict=True)
    )
    return LinkData(left, batch.lags, batch.least_gain, noticed)


def link_residual(trace: Trace, used: NDArray[np.bool_], residual: Array, row: Array) -> Residual:
    """Residual (T,) of a servo with parameters ``row`` (P,), as the analysis of the link has it."""
    kp, kd, latency = (float(x) for x in row[:3])
    load = trace.load
    return Residual(
        trace.t, trace.command, used, residual, kp, kd, latency, load.inertia_kgm2, load.gravity_Nm
    )


def _pass(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    rng: np.random.Generator,
    progress: Callable[[float], None],
    known: Sequence[Tried] | None,
) -> list[Finding]:
    bases = [joint.base for joint in joints]
    if known is None:
        plain = baselines(batch, [joint.given for joint in joints])
    else:
        plain = plain_again(batch, known, bases)
    progress(0.1)
    found, problem = search(
        batch,
        plain,
        level=DECISION.false_alarms / max(len(robot) for robot in robots),
        rng=rng,
        noise=[joint.noise for joint in joints],
        bases=bases,
        best=None if known is None else [one.best for one in known],
        known=[bool(joint.before) for joint in joints],
        progress=lambda share: progress(0.1 + 0.8 * share),
    )
    probable = posteriors(found, robots, rng)
    best = [one.tried[p.sets[0]] for one, p in zip(found, probable, strict=True)]
    data = [joint.traces for joint in joints]
    left = unmodelled(batch, data, robots, joined([one.plain.fit for one in found]))
    _, after = beyond_noise(batch, data, joined([h.fit for h in best]))
    progress(1.0)
    return [
        _finding(one, problem, probable[j], left[j], after[j], joints[j])
        for j, one in enumerate(found)
    ]


def _finding(
    tried: Tried,
    problem: ServoSearch,
    after: EffectPosterior,
    without: Unmodelled,
    excess_after: float,
    joint: JointCase,
) -> Finding:
    best = tried.tried[after.sets[0]]
    groups = tuple(
        _as_seen(best, group, joint)
        for group in after.groups(tried.base)
        if not _no_finding(best, group.members[0], joint)
    )
    if joint.step_rad is not None:
        groups = (*groups, Group((ROUNDING,), DECISION.most_certain, 1.0))
    structured = without.excess > DECISION.structured_excess
    return Finding(
        tried,
        problem,
        after,
        best,
        structured or problem.remains(tried, tried.base),
        excess_after > DECISION.structured_excess,
        groups,
        without,
        0.0,
        excess_after,
        joint.noise,
        joint.step_rad,
    )


def _as_seen(best: Hypothesis, group: Group, joint: JointCase) -> Group:
    """The group, with plain dry friction where a shaft yields by less than the sensor's noise."""
    torque, stiffness = best.fit.servos.theta[0, _PRESLIDING]
    yields = group.members[0] == "presliding_friction" and torque > joint.noise * stiffness
    if yields or group.members[0] != "presliding_friction" or _DRY in group.members:
        return group
    return replace(group, members=(*group.members, _DRY))


def _no_finding(best: Hypothesis, effect: str, joint: JointCase) -> bool:
    """Whether an effect is what every servo has a little of, or what its data sheet says anyway."""
    if named(effect).everywhere:
        return size_in_noise(best, effect, joint.noise) < DECISION.nuisance_finding_size
    theta = best.fit.servos.theta[0]
    if effect == "unmodelled_inertia":
        small = DECISION.inertia_tolerance * joint.traces[0].load.inertia_kgm2
        return bool(abs(theta[_INERTIA]) < small)
    stated = effect == "torque_saturation" and joint.stall_Nm is not None
    return stated and theta[_LIMIT] > DECISION.data_sheet_share * (joint.stall_Nm or 0.0)
