"""From recordings of any number of robots to what each joint is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.link_effect import IrregularTiming, LinkData, links
from sim2real.diagnose.missing.baseline import plain_again
from sim2real.diagnose.missing.effect_probabilities import EffectPosterior, Group, posteriors
from sim2real.diagnose.missing.effect_search import search, search_again
from sim2real.diagnose.missing.nuisances import size_in_noise, states_load, with_rotors
from sim2real.diagnose.missing.servo_search import ServoSearch
from sim2real.diagnose.missing.unmodelled import Unmodelled, beyond_noise, excess, unmodelled
from sim2real.effects import CATALOGUE, named
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import (
    FLAT_COLUMNS,
    SATURATION,
    Fits,
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


@dataclass(frozen=True)
class Finding:
    """What one joint is missing.

    Attributes:
        tried: Every set of effects that was tried.
        search: What may be asked of it further.
        posterior: Their probabilities.
        best: The likeliest set.
        mismatch: Whether something is missing at all.
        unexplained: Whether the likeliest set leaves something.
        groups: What is missing, likeliest first.
        unmodelled: What could be missing without a name.
        unknown: Probability that what is missing is not in the catalogue.
        excess: Energy of the best set's residual beyond noise, in variances of the noise.
        noise: Standard deviation of the sensor's noise, rad.
        link: Irregular timing of the link, or None.
        place: Of the joint among those of the link.
    """

    tried: Tried
    search: ServoSearch
    posterior: EffectPosterior
    best: Hypothesis
    mismatch: bool
    unexplained: bool
    groups: tuple[Group, ...]
    unmodelled: Unmodelled
    unknown: float
    excess: float
    noise: float
    link: IrregularTiming | None = None
    place: int = 0

    @property
    def unfinished(self) -> bool:
        """Whether the search was ended by its budget."""
        return self.tried.case in self.search.unfinished

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
        """Share by which an effect, added to the others, lowers the held-out error; or infinity.

        Infinity where that cannot be measured: of rounding, and where nothing is held out. Of
        irregular timing of the link, which cannot be predicted, it is the share by which it raises
        the error; none where set-points come no later than the controller's next turn would take
        them anyway.
        """
        if self.link is not None and self.link.effect == effect:
            waits = effect == "latency_jitter" and self.link.value < DECISION.controller_wait_s
            return 0.0 if waits else self.irregularity
        best = self.best.members
        enriched = unseen.get(best)
        without = unseen.get(best - {effect}, unseen.get(self.tried.base))
        if effect not in best or enriched is None or without is None:
            return float("inf")
        return 1 - enriched.rmse / without.rmse


def investigate(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    known: Sequence[Tried],
    *,
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> list[Finding]:
    """Find what each joint is missing.

    Args:
        batch: The recordings, joint by joint.
        joints: The joints of the batch.
        robots: Which of them share a supply and a link.
        known: What was tried on each joint before: the plain servo, and what a first look tried.
        rng: For bootstraps.
        progress: Called with the share that is done.
    """
    findings = _pass(batch, joints, robots, known, rng, lambda share: progress(0.7 * share))
    # Where structure stays, it is no sensor's noise: the noise model must then be free.
    again = [j for j, finding in enumerate(findings) if finding.excess > DECISION.structured_excess]
    if again:
        free = Batch(
            [joints[j].traces for j in again],
            batch.device,
            batch.threads,
            bounded=False,
            period=batch.period,
        )
        groups = [[again.index(j) for j in robot if j in again] for robot in robots]
        second = _pass(
            free,
            [joints[j] for j in again],
            [group for group in groups if group],
            [findings[j].tried for j in again],
            rng,
            lambda share: progress(0.7 + 0.3 * share),
        )
        for j, finding in zip(again, second, strict=True):
            tried = replace(placed(finding.tried, j), case=finding.tried.case)
            findings[j] = replace(
                finding,
                tried=tried,
                best=tried.tried[finding.best.members],
                mismatch=finding.mismatch or findings[j].mismatch,
            )
    findings = _with_links(batch, joints, robots, findings)
    progress(1.0)
    return findings


def placed(tried: Tried, joint: int) -> Tried:
    """What was tried in another batch, as of this joint of the whole one."""
    moved = {
        members: replace(h, fit=h.fit.of_joints([joint])) for members, h in tried.tried.items()
    }
    return replace(tried, case=joint, tried=moved)


def _pass(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    known: Sequence[Tried],
    rng: np.random.Generator,
    progress: Progress,
) -> list[Finding]:
    """The findings with the noise model of a batch."""
    bases = [joint.base for joint in joints]
    plain = plain_again(batch, known, bases)
    progress(0.1)
    ledgers, problem = search(
        batch,
        plain,
        level=DECISION.false_alarms / max(len(robot) for robot in robots),
        rng=rng,
        noise=[joint.noise for joint in joints],
        bases=bases,
        best=[ledger.best for ledger in known],
        needed=not all(joint.references for joint in joints),
        stated=[joint.stated for joint in joints],
        effort=max(joint.effort for joint in joints),
        progress=lambda share: progress(0.1 + 0.8 * share),
    )
    data = [joint.traces for joint in joints]
    _, excesses = beyond_noise(batch, data, joined([ledger.best.fit for ledger in ledgers]))
    structured = np.flatnonzero(np.array(excesses) > DECISION.structured_excess)
    search_again(problem, [ledgers[j] for j in structured])
    ledgers = with_rotors(problem, ledgers, joints)
    probable = posteriors(ledgers, robots, rng)
    best = [ledger.tried[p.sets[0]] for ledger, p in zip(ledgers, probable, strict=True)]
    without = unmodelled(batch, data, robots, joined([ledger.plain.fit for ledger in ledgers]))
    _, excesses = beyond_noise(batch, data, joined([h.fit for h in best]))
    progress(1.0)
    findings = []
    for j, (joint, tried) in enumerate(zip(joints, ledgers, strict=True)):
        groups = [
            _as_seen(best[j], group, joint)
            for group in probable[j].groups(tried.base)
            if not is_no_finding(best[j], group.members[0], joint)
        ]
        if joint.step_rad is not None:
            groups.append(Group((ROUNDING,), DECISION.most_certain, 1.0))
        plain_structured = without[j].excess > DECISION.structured_excess
        findings.append(
            Finding(
                tried=tried,
                search=problem,
                posterior=probable[j],
                best=best[j],
                mismatch=plain_structured or problem.remains(tried, tried.base),
                unexplained=excesses[j] > DECISION.structured_excess,
                groups=tuple(groups),
                unmodelled=without[j],
                unknown=0.0,
                excess=excesses[j],
                noise=joint.noise,
            )
        )
    return findings


def _as_seen(best: Hypothesis, group: Group, joint: JointCase) -> Group:
    """The group, with plain dry friction where a shaft yields by less than the sensor's noise."""
    torque, stiffness = best.fit.servos.theta[0, _PRESLIDING]
    if group.members[0] != "presliding_friction" or _DRY in group.members:
        return group
    yields = torque > joint.noise * stiffness
    return group if yields else replace(group, members=(*group.members, _DRY))


def is_no_finding(best: Hypothesis, effect: str, joint: JointCase) -> bool:
    """Whether an effect is what every servo has a little of, or what its data sheet says anyway."""
    if named(effect).everywhere:
        return size_in_noise(best, effect, joint.noise) < DECISION.nuisance_finding_size
    if effect == UNMODELLED_INERTIA:
        return states_load(best, joint)
    limit = best.fit.servos.theta[0, FLAT_COLUMNS[0]]
    stated = effect == SATURATION and joint.stall_Nm is not None
    return bool(stated and limit > DECISION.data_sheet_share * (joint.stall_Nm or 0.0))


def _with_links(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    findings: Sequence[Finding],
    *,
    longest_jitter_s: float = np.inf,
) -> list[Finding]:
    """Findings with the irregular timing of their link.

    Irregular set-points can pass for a weak effect. So the link is examined twice: with
    what was found on its joints and without. Where not all joints show it, set-points may wait for
    the turn of one joint's own, slow controller.
    """
    plain, best = [f.tried.plain for f in findings], [f.best for f in findings]
    with_found = [robot for robot in robots if any(best[j] is not plain[j] for j in robot)]
    both = links(
        [link_data(batch, joints, robot, [plain[j].fit for j in robot]) for robot in robots]
        + [link_data(batch, joints, robot, [best[j].fit for j in robot]) for robot in with_found]
    )
    with_effects = {
        robot[0]: link for robot, link in zip(with_found, both[len(robots) :], strict=True)
    }
    explained, alone = list(findings), list[int]()
    for robot, plain_link in zip(robots, both, strict=False):
        best_link = with_effects.get(robot[0], plain_link)
        if not _on_all(plain_link, best_link, [findings[j] for j in robot]):
            shown = [j for j, share in zip(robot, best_link.shares, strict=True) if share > 0]
            alone += [j for j in shown if len(robot) > 1 and findings[j].mismatch]
            continue
        for k, j in enumerate(robot):
            finding = findings[j]
            own = finding.best.evidence - finding.tried.plain.evidence
            # Irregular timing instead of the joint's own effects, or together with them.
            instead = plain_link.shares[k] > best_link.shares[k] + own
            link = plain_link if instead and plain_link.gain > 0 else best_link
            short = link.effect == "latency_jitter" and link.value < longest_jitter_s
            if link.gain > 0 and (short or np.isinf(longest_jitter_s)):
                group = Group((link.effect,), DECISION.most_certain, 1.0)
                remaining = excess(link.unexplained[k], joints[j].traces, batch, _noise(finding))
                remaining = min(remaining, finding.excess)
                unexplained = remaining > DECISION.structured_excess
                groups = () if instead else finding.groups
                lacks_rows = any(joints[i].lacks_rows for i in robot)  # and so looks irregular
                explained[j] = replace(
                    finding,
                    mismatch=not lacks_rows or unexplained or bool(groups),
                    unexplained=unexplained,
                    excess=remaining,
                    best=finding.tried.plain if instead else finding.best,
                    groups=groups if lacks_rows else (*groups, group),
                    link=None if lacks_rows else link,
                    place=k,
                )
    if not alone:
        return explained
    apart, wait_s = [[j] for j in alone], DECISION.controller_wait_s
    return _with_links(batch, joints, apart, explained, longest_jitter_s=wait_s)


def _noise(finding: Finding) -> float:
    """Standard deviation of the innovations of the likeliest set's residual, rad."""
    fit = finding.best.fit
    return float(np.sqrt(fit.error2[0] / fit.count[0]))


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


def link_data(
    batch: Batch, joints: Sequence[JointCase], robot: Sequence[int], fits: Sequence[Fits]
) -> LinkData:
    """Residuals of single fits on a robot's joints, for ``links``."""
    residuals = residual_angles(batch, joined(fits))
    left = tuple(
        tuple(
            Residual(t, residual[r, : t.t.size], *fit.servos.theta[0, :3].tolist())
            for r, t in enumerate(joints[j].traces)
        )
        for j, fit, residual in zip(robot, fits, residuals, strict=True)
    )
    return LinkData(left, batch.lags, batch.least_gain, DECISION.decisive_gain)
