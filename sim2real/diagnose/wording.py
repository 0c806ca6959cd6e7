"""The diagnosis of a robot in values and sentences, with what its report shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.located import remainder
from sim2real.diagnose.open_sets import rival_sets, set_probabilities
from sim2real.diagnose.references import repeat
from sim2real.diagnose.result import (
    DetectionLimit,
    Diagnosis,
    Estimate,
    JointSeries,
    Mismatch,
    NamedEffect,
    to_design,
)
from sim2real.diagnose.rival_sets import design_of, separations
from sim2real.diagnose.screening import Candidate, Screen
from sim2real.diagnose.unmodelled import measured_only
from sim2real.diagnose.verdict import Named, named_groups, rivals, split_by_size, verdict
from sim2real.effects import SET_ANEW, named, plain
from sim2real.findings import all_findings
from sim2real.identification.reading_noise import left_out
from sim2real.inference.normal import NINE_IN_TEN
from sim2real.inference.segments import Window, robust_sd, windows
from sim2real.model import FittedEffect, Model
from sim2real.output import provenance
from sim2real.recording import PER_INERTIA
from sim2real.servo.linearised import residual_torque
from sim2real.servo.parameters import BASE
from sim2real.units import three_digits

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


def diagnosis(
    case: Case, joints: Sequence[JointFindings], negligible: float, seed: int
) -> Diagnosis:
    """The diagnosis of one robot."""
    results = {joint.name: joint for joint in joints}
    groups = named_groups(results)
    # What has changed since references matters, whatever its size.
    least = -np.inf if case.references else negligible
    large, small = split_by_size(results, groups, least)
    inputs = [r.path for r in (*case.recordings, *case.references) if r.path]
    origin = provenance([*inputs, *([case.robot.path] if case.robot.path else [])], seed)
    of_links = [j.finding.link.sizes for j in joints if j.finding.link is not None]
    links = {effect: size for sizes in of_links for effect, (size, _) in sizes.items()}
    enriched_fit = {joint.signal: joint.fit(enriched=True) for joint in joints}
    enriched, plain_models = (
        {joint.name: joint.model(enriched=which) for joint in joints} for which in (True, False)
    )
    return Diagnosis(
        verdict=verdict(joints, large, small, referred=bool(case.references)),
        mismatch=tuple(_mismatch(joint) for joint in joints if joint.finding.mismatch),
        effects=tuple(_named_effect(results, entry) for entry in large),
        negligible=tuple(_named_effect(results, entry) for entry in small),
        rivals=rivals(results, groups),
        unknown={joint.name: joint.finding.unknown for joint in joints},
        baseline_fit={joint.signal: joint.fit(enriched=False) for joint in joints},
        enriched_fit=enriched_fit,
        notes=tuple(
            f"{joint.name}: {note}"
            for joint in joints
            for note in (*left_out(joint.joint.traces), *enriched[joint.name].notes)
        ),
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
        baseline=Model(joints=plain_models, arm=case.robot.arm),
        provenance=origin,
    )


def _named_effect(results: Mapping[str, JointFindings], entry: Named) -> NamedEffect:
    group, result = entry.group, results[entry.joints[0]]
    estimates = [results[joint].estimates(group.head) for joint in entry.joints]
    parameters = _combined([estimate for estimate in estimates if estimate])
    before = result.finding.tried.plain.fit.servos.theta[0]
    after = result.enriched.fit.servos.theta[0]
    return NamedEffect(
        effect=group.head,
        component=entry.component,
        probability=group.probability,
        group=group.members,
        parameters=parameters,
        heldout=result.heldout(),
        baseline_shift={name: float(after[k] - before[k]) for k, name in enumerate(BASE[:3])},
        statement=_statement(entry, parameters, result) + _of_link(entry, result),
    )


def _combined(estimates: Sequence[Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Precision-weighted means of what several joints say."""
    if len(estimates) < 2:
        return dict(*estimates)
    combined = {}
    for name in estimates[0]:
        means = np.array([entry[name].mean for entry in estimates])
        sds = np.array([entry[name].sd for entry in estimates])
        # An unbounded standard deviation keeps a weight, so that not all weights are 0.
        weight = 1 / np.clip(sds, 1e-9 * (np.abs(means) + 1e-12), 1e100) ** 2
        mean = float(np.sum(weight * means) / weight.sum())
        # Never narrower than the joints' own disagreement.
        spread = float(np.sqrt(np.average((means - mean) ** 2, weights=weight)))
        sd = float(max(1 / np.sqrt(weight.sum()), spread))
        ends = min(e[name].q05 for e in estimates), max(e[name].q95 for e in estimates)
        combined[name] = Estimate.normal(mean, sd, *ends)
    return combined


def _statement(entry: Named, parameters: Mapping[str, Estimate], result: JointFindings) -> str:
    """One sentence: the joints, the effect with the size of its parameters, and its rivals."""
    head = entry.group.head
    clause = f"there is {plain(head)}"
    if head in SET_ANEW:
        clause = _set_anew(head, parameters)
    elif all(p.name in parameters for p in named(head).parameters):
        values = {p.name: parameters[p.name].mean for p in named(head).parameters}
        per_inertia = result.joint.traces[0].load is PER_INERTIA
        clause = named(head).statement(values, per_inertia=per_inertia)
    others = ", or ".join(plain(name) for name in entry.group.members[1:])
    doubt = f" (or {others}; these recordings cannot tell)" if others else ""
    return f"{', '.join(entry.joints)}: {clause}{doubt}."


def _set_anew(name: str, parameters: Mapping[str, Estimate]) -> str:
    """A parameter that was set anew, relative to the references: "kp x 0.51, 0.50 to 0.52"."""
    x = parameters["ratio" if "ratio" in parameters else "change_s"]
    ends = x.mean, x.q05, x.q95
    if "ratio" in parameters:
        mean, low, high = map(three_digits, ends)
        return f"{name.replace('_', ' ')} x {mean}, {low} to {high}"
    mean, low, high = (f"{1e3 * end:+.1f}" for end in ends)
    return f"{name} {mean} ms, {low} to {high} ms"


def _of_link(entry: Named, result: JointFindings, *, listed: int = 3) -> str:
    """Further sentences on the link: correlated delays, bursts, times of losses."""
    link = result.finding.link
    if link is None or entry.group.head not in link.sizes:
        return ""
    if entry.group.head == "latency_jitter":
        alike = f" Successive delays have a correlation of {link.correlation:.1f}."
        return alike if link.correlation > 0.25 else ""
    text = f" They are lost in bursts of {link.burst:.1f} on average." if link.burst > 1.5 else ""
    if len(link.shares) > 1:
        text += f" {'One packet carries' if link.common else 'Each joint has packets with'}"
        text += " the set-points of all joints." if link.common else " its own set-points."
    times = [
        f"{time:.2f} s of {trace.name}"
        for trace, some in zip(result.joint.traces, link.lost_s[result.finding.place], strict=True)
        for time in some
    ]
    if not times:
        return text
    more = f" and {len(times) - listed} more" if len(times) > listed else ""
    of_joint = "" if link.common else f" of {entry.joints[0]}"
    return f"{text} Set-points{of_joint} lost at {', '.join(times[:listed])}{more}."


def _mismatch(joint: JointFindings) -> Mismatch:
    segments, noise, rmse = _segments(joint), joint.joint.noise, joint.error
    smooth, count = joint.finding.unmodelled.smooth, float(joint.finding.best.fit.count[0])
    driven = sorted(smooth.shares.items(), key=lambda entry: -entry[1])
    return Mismatch(
        signal=joint.signal,
        component=joint.name,
        rmse=rmse,
        noise=noise,
        share=max(0.0, 1 - (noise / rmse) ** 2) if rmse > 0 else 0.0,
        windows_s={t.name: w for t, w in zip(joint.joint.traces, segments, strict=True)},
        where=_where(joint, segments),
        # Shares of the innovations' energy that a smooth function of each state explains.
        dependence={x: float(1 - np.exp(-2 * max(gain, 0.0) / count)) for x, gain in driven},
        remainder="" if joint.finding.link else remainder(joint.joint.traces, joint.after, noise),
    )


def _segments(joint: JointFindings) -> list[tuple[Window, ...]]:
    """The segments of each recording in which the mismatch is largest."""
    traces, noise, without = joint.joint.traces, joint.joint.noise, joint.finding.unmodelled
    if joint.finding.unknown > DECISION.named:
        if without.windows is not None:
            return list(without.windows)
        if without.smooth.state == "jump":
            pairs = zip(without.smooth.jumps_s, traces, strict=True)
            return [((at, float(t.t[-1])),) for at, t in pairs]
    rows = measured_only(joint.before, traces)
    everywhere = np.concatenate(rows)
    spread = robust_sd(everywhere, np.zeros(everywhere.size, dtype=bool))
    sd = max(noise, min(spread, DECISION.structured_excess * noise))
    return [windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True)]


def _where(joint: JointFindings, segments: Sequence[tuple[Window, ...]]) -> str:
    """The states, or the segments, in which a mismatch occurs."""
    without, traces = joint.finding.unmodelled, joint.joint.traces
    if joint.finding.rattle is not None:
        return str(joint.finding.rattle)
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


def with_checks(found: Diagnosis, case: Case, joints: Sequence[JointFindings]) -> Diagnosis:
    """The diagnosis of one robot with all that its report shows."""
    checks = (
        f"{recording.name}: {finding.text}"
        for recording in case.recordings
        for finding in all_findings(recording, case.robot)
    )
    # Sets of a change against references are not all fitted, and no design states them.
    designed = [(joint, design_of(case.recordings, joint.name)) for joint in joints]
    return replace(
        found,
        gate=tuple(dict.fromkeys(checks)),
        warnings=case.warnings,
        evidence=tuple(series for joint in joints for series in _evidence(joint)),
        detection_limits=tuple(limit for joint in joints for limit in _limits(joint)),
        separations=tuple(
            pair
            for one, stated in designed
            if stated
            for pair in separations(one.name, stated, set_probabilities(one.joint, one.finding))
        ),
        rival_sets=tuple(
            rival_sets(joint.joint, joint.finding)
            for joint in joints
            if joint.finding.mismatch and not joint.joint.references
        ),
        next_experiment=repeat([j.joint for j in joints])
        or to_design((e.component, e.group) for e in found.effects if not case.references),
    )


def _evidence(joint: JointFindings) -> list[JointSeries]:
    kp, kd = joint.finding.tried.plain.fit.servos.theta[0, :2].tolist()
    series = []
    for trace, before, after in zip(joint.joint.traces, joint.before, joint.after, strict=False):
        baseline, enriched = (
            trace.simulated(x[: trace.t.size][trace.used]) for x in (before, after)
        )
        servo = (trace.load.inertia_kgm2, kd, kp + trace.load.gravity_Nm)
        error = np.where(trace.used, baseline - trace.measured, np.nan)
        torque, sd = residual_torque(trace.t, error, servo, joint.joint.noise)
        effects_torque, _ = residual_torque(trace.t, baseline - enriched, servo, joint.joint.noise)
        series.append(
            JointSeries(
                joint=joint.name,
                recording=trace.name,
                t=trace.t,
                command=trace.command,
                position=trace.measured,
                baseline=baseline,
                enriched=enriched,
                speed=trace.speed(),
                torque=torque,
                torque_sd=sd,
                effects_torque=effects_torque,
            )
        )
    return series


def _limits(joint: JointFindings) -> list[DetectionLimit]:
    tried, members = joint.finding.tried, joint.enriched.members
    known = members if members in tried.tried else tried.base
    return detection_limits(*joint.finding.search.seen(tried, known), joint.name)


def detection_limits(
    seen: Screen, candidates: Sequence[Candidate], component: str
) -> list[DetectionLimit]:
    """The smallest strength of each effect that could be noticed.

    The score of an effect grows with its strength; between the strengths that were simulated it is
    interpolated, both on logarithmic scales, and below them proportional.
    """
    needed = float(np.sqrt(2 * DECISION.detection_gain)) + NINE_IN_TEN
    limits = []
    for k, option in enumerate(candidates):
        mine = (seen.candidate == k) & (seen.visible > 0)
        strength = np.abs(option.starts[seen.start[mine], 0])
        levels = np.unique(strength)
        score = np.array([np.median(seen.visible[mine][strength == x]) for x in levels])
        smallest = None
        if score.max(initial=0.0) >= needed:
            order, sign = np.argsort(score), 1.0 if score[-1] >= score[0] else -1.0
            log_score, log_level = np.log([score[order], levels[order]])
            at = float(np.interp(np.log(needed), log_score, log_level))
            smallest = float(np.exp(at + sign * min(np.log(needed) - log_score[0], 0.0)))
        name = option.effect.parameters[0].name
        limits.append(DetectionLimit(option.effect.name, component, {name: smallest}))
    return limits
