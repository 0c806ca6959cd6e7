"""The diagnosis of a robot in values and sentences, with what its report shows.

What is named, what is listed and the verdict follow from the probabilities of its joints.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.located import remainder
from sim2real.diagnose.open_sets import detection_limits, rival_sets, set_probabilities
from sim2real.diagnose.references import repeat
from sim2real.diagnose.result import (
    DetectionLimit,
    Diagnosis,
    Estimate,
    JointSeries,
    Mismatch,
    NamedEffect,
    Rival,
    Verdict,
    to_design,
)
from sim2real.diagnose.rival_sets import Separation, design_of, separations
from sim2real.diagnose.unmodelled import measured_only
from sim2real.effects import SET_ANEW, named, plain
from sim2real.findings import all_findings
from sim2real.identification.reading_noise import left_out
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


@dataclass(frozen=True)
class Named:
    """A named group on one joint, or on several that share it."""

    group: Group
    joints: tuple[str, ...]
    component: str


def diagnosis(
    case: Case, joints: Sequence[JointFindings], negligible: float, seed: int
) -> Diagnosis:
    """The diagnosis of one robot."""
    results = {joint.name: joint for joint in joints}
    groups = _named_groups(results)
    # What has changed since references matters, whatever its size.
    large, small = _by_size(results, groups, -np.inf if case.references else negligible)
    inputs = [r.path for r in (*case.recordings, *case.references) if r.path]
    origin = provenance([*inputs, *([case.robot.path] if case.robot.path else [])], seed)
    of_links = [j.finding.link.sizes for j in joints if j.finding.link is not None]
    links = {effect: size for sizes in of_links for effect, (size, _) in sizes.items()}
    baseline_fit, enriched_fit = (
        {joint.signal: joint.fit(enriched=which) for joint in joints} for which in (False, True)
    )
    plain_models, enriched = (
        {joint.name: joint.model(enriched=which) for joint in joints} for which in (False, True)
    )
    checks = (
        f"{recording.name}: {finding.text}"
        for recording in case.recordings
        for finding in all_findings(recording, case.robot)
    )
    limits, separated = list[DetectionLimit](), list[Separation]()
    for joint in joints:
        tried, members = joint.finding.tried, joint.enriched.members
        known = members if members in tried.tried else tried.base
        limits += detection_limits(*joint.finding.search.seen(tried, known), joint.name)
        # Sets of a change against references are not all fitted, and no design states them.
        if stated := design_of(case.recordings, joint.name):
            probability = set_probabilities(joint.joint, joint.finding)
            separated += separations(joint.name, stated, probability)
    return Diagnosis(
        verdict=_verdict(joints, large, small, bool(case.references)),
        mismatch=tuple(_mismatch(joint) for joint in joints if joint.finding.mismatch),
        effects=tuple(_named_effect(results, entry) for entry in large),
        negligible=tuple(_named_effect(results, entry) for entry in small),
        rivals=_rivals(results, groups),
        unknown={joint.name: joint.finding.unknown for joint in joints},
        baseline_fit=baseline_fit,
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
        gate=tuple(dict.fromkeys(checks)),
        warnings=case.warnings,
        evidence=tuple(series for joint in joints for series in _evidence(joint)),
        detection_limits=tuple(limits),
        separations=tuple(separated),
        rival_sets=tuple(
            rival_sets(joint.joint, joint.finding)
            for joint in joints
            if joint.finding.mismatch and not joint.joint.references
        ),
        next_experiment=repeat([joint.joint for joint in joints])
        or to_design((e.component, e.group.members) for e in large if not case.references),
        provenance=origin,
    )


def _named_groups(results: Mapping[str, JointFindings]) -> list[Named]:
    """Groups of all joints; an effect on the supply or the link of several joints counts once."""
    groups: list[Named] = []
    shared: dict[str, list[tuple[str, Group]]] = {}
    for joint, result in results.items():
        for group in result.finding.groups:
            if group.probability < DECISION.named:
                continue
            if group.head in SET_ANEW or named(group.head).component == "joint":
                groups.append(Named(group, (joint,), joint))
            else:
                shared.setdefault(group.head, []).append((joint, group))
    mimicked: set[str] = set()
    for effect, where in shared.items():
        most_probable = max((group for _, group in where), key=lambda group: group.probability)
        joints = tuple(joint for joint, _ in where)
        links = (results[joint].finding.link for joint in joints)
        own = any(link is not None and len(link.shares) == 1 for link in links)
        place: str = joints[0] if own or len(results) == 1 else named(effect).component
        groups.append(Named(most_probable, joints, place))
        mimicked.update(named(effect).mimics if len(joints) > 1 else ())
    # What something of the supply or the link, seen on several joints, looks like on one.
    groups = [entry for entry in groups if entry.group.head not in mimicked]
    return sorted(groups, key=lambda entry: -entry.group.probability)


def _by_size(
    results: Mapping[str, JointFindings], groups: Sequence[Named], negligible: float
) -> tuple[list[Named], list[Named]]:
    """The groups that matter, and those that change the held-out error by less than a share."""
    changes = [
        max(results[n].finding.changes(results[n].unseen, entry.group.head) for n in entry.joints)
        for entry in groups
    ]
    pairs = list(zip(groups, changes, strict=True))
    large, small = [x for x, c in pairs if c >= negligible], [x for x, c in pairs if c < negligible]
    # The latter are not listed next to a mismatch without a name.
    nameless = any(x.finding.mismatch and x.finding.unexplained for x in results.values())
    return large, [] if nameless else small


def _verdict(
    joints: Sequence[JointFindings], large: Sequence[Named], small: Sequence[Named], referred: bool
) -> Verdict:
    """The verdict on a robot; ``referred``: whether it is compared with references."""
    differing = [joint for joint in joints if joint.finding.mismatch]
    uncatalogued = any(joint.finding.unknown > DECISION.named for joint in differing)
    unsolved = uncatalogued or any(joint.finding.unexplained for joint in differing)
    if referred and not large and not uncatalogued:
        return "unchanged"
    if not differing or (small and not large and not unsolved):
        return "consistent"
    if not large:
        return "unexplained"
    if unsolved or any(joint.leaves_structure for joint in differing):
        return "partly_explained"
    return "ambiguous" if any(len(e.group.members) > 1 for e in large) else "explained"


def _rivals(results: Mapping[str, JointFindings], groups: Sequence[Named]) -> tuple[Rival, ...]:
    """What was considered and not named, most probable first."""
    taken = {(joint, e) for entry in groups for joint in entry.joints for e in entry.group.members}
    found = []
    for joint, result in results.items():
        finding = result.finding
        effects = {e for s in finding.posterior.sets for e in s - finding.tried.base}
        for effect in effects if finding.mismatch else ():
            p = finding.posterior.inclusion(effect) * (1 - finding.unknown)
            if (joint, effect) not in taken and p > DECISION.report.rival_min_probability:
                found.append(Rival(effect, joint, p))
    return tuple(sorted(found, key=lambda r: -r.probability)[: int(DECISION.report.most_rivals)])


def _named_effect(results: Mapping[str, JointFindings], entry: Named) -> NamedEffect:
    """A named group with its statement: joints, effect, size of its parameters, its rivals."""
    head, members, result = entry.group.head, entry.group.members, results[entry.joints[0]]
    estimates = [results[joint].estimates(head) for joint in entry.joints]
    parameters = _combined([estimate for estimate in estimates if estimate])
    before = result.finding.tried.plain.fit.servos.theta[0]
    after = result.enriched.fit.servos.theta[0]
    clause = f"there is {plain(head)}"
    if "ratio" in parameters and head in SET_ANEW:  # relative to the references
        x = parameters["ratio"]
        mean, low, high = map(three_digits, (x.mean, x.q05, x.q95))
        clause = f"{head.replace('_', ' ')} x {mean}, {low} to {high}"
    elif head in SET_ANEW:
        x = parameters["change_s"]
        mean, low, high = (f"{1e3 * end:+.1f}" for end in (x.mean, x.q05, x.q95))
        clause = f"{head} {mean} ms, {low} to {high} ms"
    elif all(p.name in parameters for p in named(head).parameters):
        values = {p.name: parameters[p.name].mean for p in named(head).parameters}
        per_inertia = result.joint.traces[0].load is PER_INERTIA
        clause = named(head).statement(values, per_inertia=per_inertia)
    others = ", or ".join(plain(name) for name in members[1:])
    doubt = f" (or {others}; these recordings cannot tell)" if others else ""
    return NamedEffect(
        effect=head,
        component=entry.component,
        probability=entry.group.probability,
        group=members,
        parameters=parameters,
        heldout=result.heldout(),
        baseline_shift={name: float(after[k] - before[k]) for k, name in enumerate(BASE[:3])},
        statement=f"{', '.join(entry.joints)}: {clause}{doubt}.{_of_link(entry, result)}",
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


def _of_link(entry: Named, result: JointFindings) -> str:
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
    of_joint = "" if link.common else f" of {entry.joints[0]}"
    return f"{text} Set-points{of_joint} lost at {_first_three(times)}." if times else text


def _first_three(listed: Sequence[str]) -> str:
    more = f" and {len(listed) - 3} more" if len(listed) > 3 else ""
    return f"{', '.join(listed[:3])}{more}"


def _mismatch(joint: JointFindings) -> Mismatch:
    """Where a joint differs from the plain servo, and the segments in which most."""
    traces, noise, plain_fit = joint.joint.traces, joint.joint.noise, joint.fit(enriched=False)
    rmse = plain_fit["train"] if plain_fit["heldout"] is None else plain_fit["heldout"]
    assert rmse is not None
    without, nameless = joint.finding.unmodelled, joint.finding.unknown > DECISION.named
    if nameless and without.windows is not None:
        segments: list[tuple[Window, ...]] = list(without.windows)
    elif nameless and without.smooth.state == "jump":
        pairs = zip(without.smooth.jumps_s, traces, strict=True)
        segments = [((at, float(t.t[-1])),) for at, t in pairs]
    else:
        rows = measured_only(joint.before, traces)
        everywhere = np.concatenate(rows)
        spread = robust_sd(everywhere, np.zeros(everywhere.size, dtype=bool))
        sd = max(noise, min(spread, DECISION.structured_excess * noise))
        segments = [windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True)]
    count = float(joint.finding.best.fit.count[0])
    driven = sorted(without.smooth.shares.items(), key=lambda entry: -entry[1])
    return Mismatch(
        signal=joint.signal,
        component=joint.name,
        rmse=rmse,
        noise=noise,
        share=max(0.0, 1 - (noise / rmse) ** 2) if rmse > 0 else 0.0,
        windows_s={t.name: w for t, w in zip(traces, segments, strict=True)},
        where=_where(joint, segments, *driven[0]),
        # Shares of the innovations' energy that a smooth function of each state explains.
        dependence={x: float(1 - np.exp(-2 * max(gain, 0.0) / count)) for x, gain in driven},
        remainder="" if joint.finding.link else remainder(traces, joint.after, noise),
    )


def _where(
    joint: JointFindings, segments: Sequence[tuple[Window, ...]], state: str, gain: float
) -> str:
    """The segments in which a mismatch occurs, or the state that drives it most, by its gain."""
    traces = joint.joint.traces
    if joint.finding.rattle is not None:
        return str(joint.finding.rattle)
    driven = gain > DECISION.report.driving_gain
    words = _WORDS[state] if driven else "the residual depends on no single state"
    seconds = sum(b - a for of_trace in segments for a, b in of_trace)
    if seconds > DECISION.report.throughout_share * sum(t.duration_s for t in traces):
        return f"throughout: {words}" if driven else "throughout"
    if joint.finding.unmodelled.windows is None or not any(segments):
        return words
    listed = [
        f"{a:.1f} to {b:.1f} s of {t.name}"
        for t, of_trace in zip(traces, segments, strict=True)
        for a, b in of_trace
    ]
    return f"in segments: {_first_three(listed)}"


def _evidence(joint: JointFindings) -> Iterator[JointSeries]:
    """What figures show of a joint, by recording."""
    kp, kd = joint.finding.tried.plain.fit.servos.theta[0, :2].tolist()
    for trace, before, after in zip(joint.joint.traces, joint.before, joint.after, strict=False):
        baseline, enriched = (
            trace.simulated(x[: trace.t.size][trace.used]) for x in (before, after)
        )
        servo = (trace.load.inertia_kgm2, kd, kp + trace.load.gravity_Nm)
        error = np.where(trace.used, baseline - trace.measured, np.nan)
        torque, sd = residual_torque(trace.t, error, servo, joint.joint.noise)
        effects_torque, _ = residual_torque(trace.t, baseline - enriched, servo, joint.joint.noise)
        yield JointSeries(
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
