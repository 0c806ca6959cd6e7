"""From the findings on each joint to the diagnosis of the robot and its sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.link.link_effect import IrregularTiming
from sim2real.diagnose.missing.effect_probabilities import Group
from sim2real.diagnose.missing.unmodelled import measured_only
from sim2real.diagnose.result import Diagnosis, Estimate, Mismatch, NamedEffect, Rival, Verdict
from sim2real.effects import named, plain
from sim2real.inference.normal import Z90
from sim2real.inference.segments import Window, robust_sd, windows
from sim2real.model import FittedEffect, Model
from sim2real.output import provenance
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import BASE

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
class _Named:
    """A named group on one joint, or on several that share it."""

    group: Group
    joints: tuple[str, ...]
    component: str


def diagnosis(
    case: Case, joints: Sequence[JointFindings], negligible: float, seed: int
) -> Diagnosis:
    """The diagnosis of one robot.

    Args:
        case: The robot.
        joints: What is known of its joints.
        negligible: Share of the held-out error below whose change an effect makes no verdict.
        seed: Of the bootstraps, to be recorded.
    """
    results = {joint.name: joint for joint in joints}
    named_groups = _named_groups(results)
    large: list[NamedEffect] = []
    small: list[NamedEffect] = []
    for entry in named_groups:
        changes = (
            results[name].finding.changes(results[name].unseen, entry.group.members[0])
            for name in entry.joints
        )
        # What has changed since references is worth saying, whatever its size.
        is_small = not case.references and all(change < negligible for change in changes)
        (small if is_small else large).append(_named_effect(results, entry))
    if any(joint.finding.mismatch and joint.finding.unexplained for joint in joints):
        small = []  # negligible next to a mismatch without a name
    inputs = [r.path for r in (*case.recordings, *case.references) if r.path]
    origin = provenance([*inputs, *([case.robot.path] if case.robot.path else [])], seed)
    irregular = [joint.finding.link for joint in joints if joint.finding.link is not None]
    links = {link.effect: link.value for link in irregular}
    enriched_fit = {joint.signal: joint.fit(enriched=True) for joint in joints}
    enriched = {joint.name: joint.model(enriched=True) for joint in joints}
    return Diagnosis(
        verdict=_verdict(joints, large, small, changed=bool(case.references)),
        mismatch=tuple(_mismatch(joint) for joint in joints if joint.finding.mismatch),
        effects=tuple(large),
        negligible=tuple(small),
        rivals=_rivals(results, named_groups),
        unknown={joint.name: joint.finding.unknown for joint in joints},
        baseline_fit={joint.signal: joint.fit(enriched=False) for joint in joints},
        enriched_fit=enriched_fit,
        notes=tuple(f"{name}: {note}" for name, one in enriched.items() for note in one.notes),
        unfinished=tuple(joint.name for joint in joints if joint.finding.unfinished),
        model=Model(
            joints=enriched,
            body=case.model.body if case.model else {},
            effects=tuple(
                FittedEffect(effect, {named(effect).parameters[0].name: value})
                for effect, value in links.items()
            ),
            fit=enriched_fit,
            provenance=dict(origin),
            arm=case.robot.arm,
        ),
        baseline=Model(
            joints={joint.name: joint.model(enriched=False) for joint in joints}, arm=case.robot.arm
        ),
        provenance=origin,
    )


def _named_groups(results: Mapping[str, JointFindings]) -> list[_Named]:
    """Groups of all joints; an effect on the supply or the link of several joints counts once."""
    groups: list[_Named] = []
    shared: dict[str, list[tuple[str, Group]]] = {}
    for joint, result in results.items():
        for group in result.finding.groups:
            if group.probability < DECISION.named:
                continue
            if named(group.members[0]).component == "joint":
                groups.append(_Named(group, (joint,), joint))
            else:
                shared.setdefault(group.members[0], []).append((joint, group))
    mimicked: set[str] = set()
    for effect, where in shared.items():
        likeliest = max((group for _, group in where), key=lambda group: group.probability)
        joints = tuple(joint for joint, _ in where)
        links = (results[joint].finding.link for joint in joints)
        own = any(link is not None and len(link.shares) == 1 for link in links)
        place: str = joints[0] if own or len(results) == 1 else named(effect).component
        groups.append(_Named(likeliest, joints, place))
        if len(joints) > 1:
            mimicked.update(named(effect).mimics)
    # What something of the supply or the link, seen on several joints, looks like on one.
    groups = [entry for entry in groups if entry.group.members[0] not in mimicked]
    return sorted(groups, key=lambda entry: -entry.group.probability)


def _named_effect(results: Mapping[str, JointFindings], entry: _Named) -> NamedEffect:
    """What was left out."""
    group, result = entry.group, results[entry.joints[0]]
    estimates = [results[joint].estimates(group.members[0]) for joint in entry.joints]
    parameters = _combined([estimate for estimate in estimates if estimate])
    plain = result.finding.tried.plain.fit.servos.theta[0]
    enriched = result.enriched.fit.servos.theta[0]
    link = result.finding.link
    of_link = link is not None and link.effect == group.members[0]
    per_inertia = result.joint.traces[0].load is PER_INERTIA
    return NamedEffect(
        effect=group.members[0],
        component=entry.component,
        probability=group.probability,
        group=group.members,
        parameters=parameters,
        heldout=result.heldout() | (result.heldout_of_link() if of_link else {}),
        baseline_shift={name: float(enriched[k] - plain[k]) for k, name in enumerate(BASE[:3])},
        stability=group.stability,
        statement=_statement(entry, parameters, per_inertia=per_inertia) + _of_link(results, entry),
    )


def _combined(estimates: Sequence[Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Precision-weighted means of what several joints say."""
    combined = {}
    for name in estimates[0] if estimates else ():
        means = np.array([entry[name].mean for entry in estimates])
        sds = np.array([entry[name].sd for entry in estimates])
        # An unbounded standard deviation keeps a weight, so that not all weights are 0.
        weight = 1 / np.clip(sds, 1e-9 * (np.abs(means) + 1e-12), 1e100) ** 2
        mean = float(np.sum(weight * means) / weight.sum())
        # Never narrower than the joints' own disagreement.
        spread = float(np.sqrt(np.average((means - mean) ** 2, weights=weight)))
        several = len(estimates) > 1
        sd = float(max(1 / np.sqrt(weight.sum()), spread)) if several else float(sds[0])
        low = min(mean, max(mean - Z90 * sd, min(e[name].q05 for e in estimates)))
        high = max(mean, min(mean + Z90 * sd, max(e[name].q95 for e in estimates)))
        combined[name] = Estimate(mean, sd, low, high)
    return combined


def _statement(entry: _Named, parameters: Mapping[str, Estimate], *, per_inertia: bool) -> str:
    """One sentence: the joints, the effect with the size of its parameters, and its rivals.

    Without estimates of all parameters the effect has no size; torques may be per unit of inertia.
    """
    effect = named(entry.group.members[0])
    values = {p.name: parameters[p.name].mean for p in effect.parameters if p.name in parameters}
    if len(values) == len(effect.parameters):
        clause = effect.statement(values, per_inertia=per_inertia)
    else:
        clause = f"there is {effect.plain}"
    others = ", or ".join(plain(name) for name in entry.group.members[1:])
    doubt = f" (or {others}; these recordings cannot tell)" if others else ""
    return f"{', '.join(entry.joints)}: {clause}{doubt}."


def _of_link(results: Mapping[str, JointFindings], entry: _Named, *, listed: int = 3) -> str:
    """Further sentences on the link: delays, bursts, times of losses, and its held-out score."""
    finding = results[entry.joints[0]].finding
    link = finding.link
    if link is None or entry.group.members[0] != link.effect:
        return ""
    if link.effect == "latency_jitter":
        alike = f" Successive delays have a correlation of {link.correlation:.1f}."
        return (alike if link.correlation > 0.25 else "") + _score(link)
    bursts = f" They are lost in bursts of {link.burst:.1f} on average." if link.burst > 1.5 else ""
    packets = ""
    if len(link.shares) > 1:
        packets = f" {'One packet carries' if link.common else 'Each joint has packets with'}"
        packets += " the set-points of all joints." if link.common else " its own set-points."
    traces = results[entry.joints[0]].joint.traces
    times = [
        f"{time:.2f} s of {trace.name}"
        for trace, some in zip(traces, link.lost_s[finding.place], strict=True)
        for time in some
    ]
    if not times:
        return bursts + packets + _score(link)
    more = f" and {len(times) - listed} more" if len(times) > listed else ""
    of_joint = "" if link.common else f" of {entry.joints[0]}"
    where = f" Set-points{of_joint} lost at {', '.join(times[:listed])}{more}."
    return bursts + packets + where + _score(link)


def _score(link: IrregularTiming) -> str:
    """A sentence on the likelihood of held-out recordings; empty where none was held out."""
    score = link.score
    if score is None:
        return ""
    below = score.expected - score.loglikelihood
    side = "below" if below > 0 else "above"
    judgement = "only noise is left" if score.at_noise() else "more than noise is left"
    return (
        f" The log-likelihood of held-out recordings is {abs(below):.0f} nats {side} what this link"
        f" expects (standard deviation {score.sd:.0f}): {judgement}; it is"
        f" {score.loglikelihood - score.without:+.0f} nats relative to regular timing."
    )


def _verdict(
    joints: Sequence[JointFindings],
    effects: Sequence[NamedEffect],
    small: Sequence[NamedEffect],
    *,
    changed: bool,
) -> Verdict:
    differing = [joint.finding for joint in joints if joint.finding.mismatch]
    uncatalogued = any(f.unknown > DECISION.named for f in differing)
    unsolved = uncatalogued or any(f.unexplained for f in differing)
    if changed and not effects and not uncatalogued:
        return "unchanged"
    if not differing or (small and not effects and not unsolved):
        return "consistent"
    if not effects:
        return "unexplained"
    if unsolved or any(joint.leaves_structure for joint in joints if joint.finding.mismatch):
        return "partly_explained"
    return "ambiguous" if any(len(e.group) > 1 for e in effects) else "explained"


def _mismatch(joint: JointFindings) -> Mismatch:
    """The mismatch of one joint."""
    finding, traces, noise, rmse = joint.finding, joint.joint.traces, joint.joint.noise, joint.error
    segments = _segments(joint)
    smooth, count = finding.unmodelled.smooth, float(finding.best.fit.count[0])
    driven = sorted(smooth.shares.items(), key=lambda entry: -entry[1])
    return Mismatch(
        signal=joint.signal,
        component=joint.name,
        rmse=rmse,
        noise=noise,
        share=max(0.0, 1 - (noise / rmse) ** 2) if rmse > 0 else 0.0,
        windows_s={t.name: w for t, w in zip(traces, segments, strict=True)},
        where=_where(joint, segments),
        # Shares of the innovations' energy that a smooth function of each state explains.
        dependence={x: float(1 - np.exp(-2 * max(gain, 0.0) / count)) for x, gain in driven},
    )


def _segments(joint: JointFindings) -> list[tuple[Window, ...]]:
    """The segments of each recording in which the mismatch is largest."""
    finding, traces, noise = joint.finding, joint.joint.traces, joint.joint.noise
    without = finding.unmodelled
    if finding.unknown > DECISION.named and without.windows is not None:
        return list(without.windows)
    if finding.unknown > DECISION.named and without.smooth.state == "jump":
        instants = without.smooth.jumps_s
        return [((at, float(t.t[-1])),) for at, t in zip(instants, traces, strict=True)]
    rows = measured_only(joint.before, traces)
    everywhere = np.concatenate(rows)
    spread = robust_sd(everywhere, np.zeros(everywhere.size, dtype=bool))
    sd = max(noise, min(spread, DECISION.structured_excess * noise))
    return [windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True)]


def _where(joint: JointFindings, segments: Sequence[tuple[Window, ...]]) -> str:
    """The states, or the segments, in which a mismatch occurs."""
    without, traces = joint.finding.unmodelled, joint.joint.traces
    state, gain = max(without.smooth.shares.items(), key=lambda entry: entry[1])
    driven = gain > DECISION.report.driving_gain
    words = _WORDS[state] if driven else "the residual depends on no single state"
    seconds = sum(b - a for of_trace in segments for a, b in of_trace)
    if seconds > DECISION.report.throughout_share * sum(t.duration_s for t in traces):
        return f"throughout: {words}" if driven else "throughout"
    if without.windows is None or not any(segments):
        return words
    listed = [
        f"{a:.1f} to {b:.1f} s of {t.name}"
        for t, of_trace in zip(traces, segments, strict=True)
        for a, b in of_trace
    ]
    more = f" and {len(listed) - 3} more" if len(listed) > 3 else ""
    return f"in segments: {', '.join(listed[:3])}{more}"


def _rivals(results: Mapping[str, JointFindings], groups: Sequence[_Named]) -> tuple[Rival, ...]:
    """What was considered and not named, likeliest first."""
    taken = {
        (joint, effect)
        for entry in groups
        for joint in entry.joints
        for effect in entry.group.members
    }
    rivals = []
    for joint, result in results.items():
        finding = result.finding
        effects = {e for s in finding.posterior.sets for e in s - finding.tried.base}
        for effect in effects if finding.mismatch else ():
            p = finding.posterior.inclusion(effect) * (1 - finding.unknown)
            if (joint, effect) not in taken and p > DECISION.report.rival_min_probability:
                rivals.append(Rival(effect, joint, p))
    return tuple(sorted(rivals, key=lambda r: -r.probability)[: DECISION.report.most_rivals])
