"""From findings joint by joint to what a person is told of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.missing.effect_probabilities import Group
from sim2real.diagnose.missing.smooth_function import Smooth
from sim2real.diagnose.missing.unmodelled import measured_only
from sim2real.diagnose.result import (
    Diagnosis,
    Estimate,
    Mismatch,
    NamedEffect,
    Rival,
    Verdict,
)
from sim2real.effects import named, plain
from sim2real.inference.normal import Z90
from sim2real.inference.segments import Window, robust_sd, windows
from sim2real.model import FittedEffect, Model
from sim2real.output import provenance
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import BASE
from sim2real.servo.trace import Trace

_WORDS = {
    "position": "the residual torque depends on the joint angle",
    "speed": "the residual torque depends on the joint speed, above all after reversals",
    "error": "the residual torque depends on the position error",
    "time": "the residual grows with time",
    "sensor": "the measurement error depends on the joint angle",
    "other_joint": "the residual follows the acceleration of another joint",
    "shaking": "the residual is a vibration at one frequency",
    "jump": "the residual changes at one instant and stays",
}


@dataclass(frozen=True)
class Said:
    """A group on one joint, or on several that share it."""

    group: Group
    joints: tuple[str, ...]
    component: str


def diagnosis(
    case: Case, joints: Sequence[JointFindings], negligible: float, seed: int
) -> Diagnosis:
    """What is said of one robot.

    Args:
        case: The robot.
        joints: What is known of its joints.
        negligible: Share of the held-out error below whose change an effect makes no verdict.
        seed: Of the bootstraps, to be recorded.
    """
    results = {one.name: one for one in joints}
    said = gathered(results)
    effects = [named_effect(results, one) for one in said]
    small = tuple(
        effect
        for effect, one in zip(effects, said, strict=True)
        if not case.references  # what has changed since is worth saying, whatever its size
        and all(
            results[joint].finding.changes(results[joint].unseen, effect.effect) < negligible
            for joint in one.joints
        )
    )
    large = tuple(effect for effect in effects if effect not in small)
    if any(one.finding.mismatch and one.finding.left for one in joints):
        small = ()  # beside something without a name a trifle is no finding
    inputs = [r.path for r in (*case.recordings, *case.references) if r.path]
    origin = provenance([*inputs, *([case.robot.path] if case.robot.path else [])], seed)
    return Diagnosis(
        verdict=_verdict(joints, large, small, changed=bool(case.references)),
        mismatch=tuple(mismatch(one) for one in joints if one.finding.mismatch),
        effects=large,
        negligible=small,
        rivals=rivals(results, said),
        unknown={one.name: one.finding.unknown for one in joints},
        baseline_fit={one.signal: one.fit(enriched=False) for one in joints},
        enriched_fit={one.signal: one.fit(enriched=True) for one in joints},
        unfinished=tuple(one.name for one in joints if one.finding.unfinished),
        model=_model(case, joints, origin),
        baseline=Model(joints={one.name: one.model(enriched=False) for one in joints}),
        provenance=origin,
    )


def _verdict(
    joints: Sequence[JointFindings],
    effects: Sequence[NamedEffect],
    small: Sequence[NamedEffect],
    *,
    changed: bool,
) -> Verdict:
    differing = [one.finding for one in joints if one.finding.mismatch]
    unsolved = any(f.left or f.unknown > DECISION.named for f in differing)
    if changed and not effects and not any(f.unknown > DECISION.named for f in differing):
        return "unchanged"
    if not differing or (small and not effects and not unsolved):
        return "consistent"
    if not effects:
        return "unexplained"
    if unsolved or any(one.leaves_structure for one in joints if one.finding.mismatch):
        return "partly_explained"
    return "ambiguous" if any(len(e.group) > 1 for e in effects) else "explained"


def _model(case: Case, joints: Sequence[JointFindings], origin: dict[str, object]) -> Model:
    """The enriched simulator."""
    uneven = {link.effect: link.value for one in joints if (link := one.finding.link) is not None}
    shared = tuple(
        FittedEffect(effect, {named(effect).parameters[0].name: value})
        for effect, value in uneven.items()
    )
    return Model(
        joints={one.name: one.model(enriched=True) for one in joints},
        body=case.model.body if case.model else {},
        effects=shared,
        fit={one.signal: one.fit(enriched=True) for one in joints},
        provenance=dict(origin),
    )


def gathered(results: Mapping[str, JointFindings]) -> list[Said]:
    """Groups of all joints; what is on the supply or the link of several is said once."""
    said: list[Said] = []
    shared: dict[str, list[tuple[str, Group]]] = {}
    for joint, result in results.items():
        for group in result.finding.groups:
            if group.probability < DECISION.named:
                continue
            if named(group.members[0]).component == "joint":
                said.append(Said(group, (joint,), joint))
            else:
                shared.setdefault(group.members[0], []).append((joint, group))
    for effect, where in shared.items():
        likeliest = max((group for _, group in where), key=lambda group: group.probability)
        joints = tuple(joint for joint, _ in where)
        place: str = named(effect).component if len(joints) > 1 else joints[0]
        said.append(Said(likeliest, joints, place))
    several = [effect for effect, where in shared.items() if len(where) > 1]
    mimicked = {like for effect in several for like in named(effect).mimics}
    # What something of the supply or the link, seen on several joints, looks like on one.
    said = [one for one in said if one.group.members[0] not in mimicked]
    return sorted(said, key=lambda one: -one.group.probability)


def named_effect(results: Mapping[str, JointFindings], one: Said) -> NamedEffect:
    """What was left out."""
    effect, result = one.group.members[0], results[one.joints[0]]
    found = [results[joint].estimates(effect) for joint in one.joints]
    parameters = _combined([entry for entry in found if entry])
    plain = result.finding.tried.plain.fit.servos.theta[0]
    rich = result.rich.fit.servos.theta[0]
    return NamedEffect(
        effect=effect,
        component=one.component,
        probability=one.group.probability,
        group=one.group.members,
        parameters=parameters,
        heldout=result.heldout(),
        baseline_shift={name: float(rich[k] - plain[k]) for k, name in enumerate(BASE[:3])},
        stability=one.group.stability,
        statement=statement(
            one, parameters, per_inertia=result.joint.traces[0].load is PER_INERTIA
        ),
    )


def statement(one: Said, parameters: Mapping[str, Estimate], *, per_inertia: bool = False) -> str:
    """One sentence: the joints, the effect with the size of its parameters, and its rivals.

    Args:
        one: The group of effects and its joints.
        parameters: Estimates of the likeliest effect's parameters; without them it has no size.
        per_inertia: Whether torques are per unit of inertia.
    """
    effect = named(one.group.members[0])
    values = {p.name: parameters[p.name].mean for p in effect.parameters if p.name in parameters}
    complete = len(values) == len(effect.parameters)
    clause = (
        effect.statement(values, per_inertia=per_inertia)
        if complete
        else f"there is {effect.plain}"
    )
    others = [plain(name) for name in one.group.members[1:]]
    doubt = f" (or {', or '.join(others)}; these recordings cannot tell)" if others else ""
    return f"{', '.join(one.joints)}: {clause}{doubt}."


def rivals(results: Mapping[str, JointFindings], said: Sequence[Said]) -> tuple[Rival, ...]:
    """What was considered and not named, likeliest first."""
    taken = {
        (joint, effect) for one in said for joint in one.joints for effect in one.group.members
    }
    found = []
    for joint, result in results.items():
        finding = result.finding
        effects = {e for s in finding.posterior.sets for e in s - finding.tried.base}
        for effect in effects:
            p = finding.posterior.inclusion(effect) * (1 - finding.unknown)
            if (
                (joint, effect) not in taken
                and finding.mismatch
                and p > DECISION.report.rival_min_probability
            ):
                found.append(Rival(effect, joint, p))
    return tuple(sorted(found, key=lambda r: -r.probability)[: DECISION.report.most_rivals])


def _combined(found: Sequence[Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Precision-weighted means of what several joints say."""
    if not found:
        return {}
    combined = {}
    for name in found[0]:
        means = np.array([entry[name].mean for entry in found])
        sds = np.array([entry[name].sd for entry in found])
        weight = 1 / np.maximum(sds, 1e-9 * (np.abs(means) + 1e-12)) ** 2
        mean = float(np.sum(weight * means) / weight.sum())
        # Never narrower than the joints' own disagreement.
        spread = float(np.sqrt(np.average((means - mean) ** 2, weights=weight)))
        sd = float(max(1 / np.sqrt(weight.sum()), spread)) if len(found) > 1 else float(sds[0])
        low = min(mean, max(mean - Z90 * sd, min(e[name].q05 for e in found)))
        high = max(mean, min(mean + Z90 * sd, max(e[name].q95 for e in found)))
        combined[name] = Estimate(mean, sd, low, high)
    return combined


def mismatch(one: JointFindings) -> Mismatch:
    """What is said of a joint that differs."""
    finding, traces, noise, rmse = one.finding, one.joint.traces, one.joint.noise, one.error
    when = _when(one)
    smooth, count = finding.unmodelled.smooth, float(finding.best.fit.count[0])
    driven = sorted(smooth.shares.items(), key=lambda entry: -entry[1])
    return Mismatch(
        signal=one.signal,
        component=one.name,
        rmse=rmse,
        noise=noise,
        share=max(0.0, 1 - (noise / rmse) ** 2) if rmse > 0 else 0.0,
        windows_s={t.name: w for t, w in zip(traces, when, strict=True)},
        where=_where(smooth, when, traces, intermittent=finding.unmodelled.windows is not None),
        # Shares of the innovations' energy that a smooth function of each state explains.
        dependence={x: float(1 - np.exp(-2 * max(gain, 0.0) / count)) for x, gain in driven},
    )


def _when(one: JointFindings) -> list[tuple[Window, ...]]:
    finding, traces, noise = one.finding, one.joint.traces, one.joint.noise
    without = finding.unmodelled
    if finding.unknown > DECISION.named and without.windows is not None:
        return list(without.windows)
    if finding.unknown > DECISION.named and without.smooth.state == "jump":
        instants = without.smooth.jumps_s
        return [((at, float(t.t[-1])),) for at, t in zip(instants, traces, strict=True)]
    rows = measured_only(one.before, traces)
    everywhere = np.concatenate(rows)
    spread = robust_sd(everywhere, np.zeros(everywhere.size, dtype=bool))
    sd = max(noise, min(spread, DECISION.structured_excess * noise))
    return [windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True)]


def _where(
    smooth: Smooth,
    when: Sequence[tuple[Window, ...]],
    traces: Sequence[Trace],
    *,
    intermittent: bool,
) -> str:
    best = max(smooth.shares, key=lambda state: smooth.shares[state])
    telling = smooth.shares[best] > DECISION.report.driving_gain
    words = _WORDS[best] if telling else "the residual depends on no single state"
    shaded = sum(b - a for w in when for a, b in w)
    if shaded > DECISION.report.throughout_share * sum(float(t.t[-1] - t.t[0]) for t in traces):
        return f"throughout: {words}" if telling else "throughout"
    if intermittent and any(when):
        segments = [
            f"{a:.1f} to {b:.1f} s of {t.name}"
            for t, w in zip(traces, when, strict=True)
            for a, b in w
        ]
        more = f" and {len(segments) - 3} more" if len(segments) > 3 else ""
        return f"in segments: {', '.join(segments[:3])}{more}"
    return words
