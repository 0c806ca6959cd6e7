"""What recordings of a joint leave open: sets of effects, and effects too small to show."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import trusted_share
from sim2real.diagnose.investigate import Finding, is_no_finding
from sim2real.diagnose.result import DetectionLimit
from sim2real.diagnose.rival_sets import JointRivals, RivalSet
from sim2real.diagnose.screening import Candidate, Screen
from sim2real.identification.servo_problem import Hypothesis
from sim2real.inference.normal import NINE_IN_TEN

_NOTICED = float(np.sqrt(2 * DECISION.detection_gain)) + NINE_IN_TEN
"""Score of an effect from which it is noticed in nine of ten recordings."""


def rival_sets(joint: JointCase, finding: Finding) -> JointRivals:
    """The sets of effects that may be present in a joint, given its recordings.

    Three kinds of sets: the most probable ones; for every further effect that was considered, the
    most probable set that has it; and the most probable set together with one more effect of the
    largest size that the recordings would not have shown. At most eight of the first two kinds and
    six of the third.
    """
    best, plain, tried = finding.best, finding.tried.plain, finding.tried.tried
    weight = set_probabilities(joint, finding)
    ranked = sorted(weight, key=lambda names: -weight[names])
    first = [names for names in ranked if weight[names] > DECISION.report.rival_min_probability]
    first = first[:8] or ranked[:1]
    chosen: dict[tuple[str, ...], Hypothesis] = {}
    for members in finding.posterior.sets:
        chosen.setdefault(_stated_effects(joint, finding, tried[members]), tried[members])
    trust, covered = trusted_share(best, plain), {effect for names in first for effect in names}
    for hypothesis in sorted(tried.values(), key=lambda h: -h.evidence):
        names = _stated_effects(joint, finding, hypothesis)
        if trust * (best.evidence - hypothesis.evidence) > 15.0:
            break
        if len(first) < 8 and names not in first and not covered.issuperset(names):
            first.append(names)
            covered.update(names)
            chosen.setdefault(names, hypothesis)
    sets = [_fitted(names, weight.get(names, 0.0), chosen[names], plain) for names in first]
    sets += _hidden(joint, finding, set(first))[:6]
    # Laws of effects are approximations: a share is even, so that no set is certain.
    total, even = sum(one.probability for one in sets), 0.3
    sets = [
        replace(one, probability=(1 - even) * one.probability / total + even / len(sets))
        for one in sets
    ]
    return JointRivals(
        component=joint.name,
        load=joint.traces[0].load,
        period_s=finding.search.batch.period,
        noise_rad=float(np.sqrt(best.fit.error2[0] / best.fit.count[0])),
        autoregression=best.fit.autoregression[0],
        sets=tuple(sorted(sets, key=lambda one: -one.probability)),
    )


def _stated_effects(joint: JointCase, finding: Finding, servo: Hypothesis) -> tuple[str, ...]:
    """Effects of a set that a verdict would state."""
    added = servo.members - finding.tried.base
    return tuple(sorted(e for e in added if not is_no_finding(servo, e, joint)))


def _fitted(
    effects: tuple[str, ...], probability: float, hypothesis: Hypothesis, plain: Hypothesis
) -> RivalSet:
    fit, servos = hypothesis.fit, hypothesis.fit.servos
    unit = servos.unit[0]
    normal = fit.gram[0].sum(axis=0)[1:, 1:] * float(fit.count[0] / fit.error2[0])
    information = normal + np.eye(unit.size) / DECISION.prior_sd**2
    gain = float(fit.loglikelihood[0] - plain.fit.loglikelihood[0])
    theta, columns = servos.theta[0], servos.columns[0].astype(np.int32)
    information = np.asarray(information / np.outer(unit, unit))
    return RivalSet(effects, probability, gain, theta, columns, information)


def _hidden(joint: JointCase, finding: Finding, taken: set[tuple[str, ...]]) -> list[RivalSet]:
    """The best set with one more effect, of the largest size that would not have been seen."""
    best = finding.best
    posterior = dict(zip(finding.posterior.sets, finding.posterior.probability, strict=True))
    # The best set is improbable where irregular timing explains what its effects would.
    share = float(posterior.get(best.members, 0.0))
    known = _fitted(_stated_effects(joint, finding, best), share, best, finding.tried.plain)
    seen, options = finding.search.seen(finding.tried, best.members)
    found: list[RivalSet] = []
    for k, option in enumerate(options):
        names = tuple(sorted({*known.effects, option.effect.name}))
        mine = np.flatnonzero((seen.candidate == k) & (seen.visible < _NOTICED))
        if names in taken or option.effect.everywhere or not mine.size:
            continue
        start = int(mine[seen.visible[mine].argmax()])
        theta = known.theta.copy()
        theta[option.columns] = option.starts[seen.start[start]]
        spread = np.maximum(np.abs(theta[option.columns]), 1e-3 * option.unit)
        information = block_diag(known.information, np.diag(spread**-2.0))
        columns = np.concatenate([known.columns, option.columns]).astype(np.int32)
        # Evidence of the effect at the size that fits best, as far as these recordings show it.
        gain = float(seen.gain[seen.candidate == k].max())
        odds = float(np.exp(min(gain + LOG_PRIOR, 0.0)))
        found.append(RivalSet(names, share * odds, known.gain, theta, columns, information))
    return sorted(found, key=lambda one: -one.probability)


def set_probabilities(joint: JointCase, finding: Finding) -> dict[tuple[str, ...], float]:
    """Probabilities of the sets of stated effects of a joint; sets of the same names are one."""
    weight: dict[tuple[str, ...], float] = {}
    for members, p in zip(finding.posterior.sets, finding.posterior.probability, strict=True):
        names = _stated_effects(joint, finding, finding.tried.tried[members])
        weight[names] = weight.get(names, 0.0) + float(p)
    return weight


def detection_limits(
    seen: Screen, candidates: Sequence[Candidate], component: str
) -> list[DetectionLimit]:
    """The smallest strength of each effect that could be noticed.

    The score of an effect grows with its strength; between the strengths that were simulated it is
    interpolated, both on logarithmic scales, and below them proportional.
    """
    limits = []
    for k, option in enumerate(candidates):
        mine = (seen.candidate == k) & (seen.visible > 0)
        strength = np.abs(option.starts[seen.start[mine], 0])
        levels = np.unique(strength)
        score = np.array([np.median(seen.visible[mine][strength == x]) for x in levels])
        smallest = None
        if score.max(initial=0.0) >= _NOTICED:
            order, sign = np.argsort(score), 1.0 if score[-1] >= score[0] else -1.0
            log_score, log_level = np.log([score[order], levels[order]])
            at = float(np.interp(np.log(_NOTICED), log_score, log_level))
            smallest = float(np.exp(at + sign * min(np.log(_NOTICED) - log_score[0], 0.0)))
        name = option.effect.parameters[0].name
        limits.append(DetectionLimit(option.effect.name, component, {name: smallest}))
    return limits
