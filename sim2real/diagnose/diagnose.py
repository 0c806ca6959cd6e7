"""From recordings to a diagnosis: is something missing, where, what, and what to do next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.alike import Progress, sampled_alike
from sim2real.diagnose.case import Case, Joint, bases, gate, prepared, rows, servo
from sim2real.diagnose.extras import Extras, extras
from sim2real.diagnose.heldout import Unseen, held_out
from sim2real.diagnose.investigate import Finding, investigate
from sim2real.diagnose.naming import NAMED, gathered, named_effects, rivals
from sim2real.diagnose.predicting import predicting, until_then
from sim2real.diagnose.references import against_references, with_known_servos
from sim2real.diagnose.result import Diagnosis, Ladder, Mismatch, NamedEffect, Verdict
from sim2real.diagnose.search import Hypothesis, joined
from sim2real.diagnose.unknown import WANDER_SHARE, residual_angles
from sim2real.diagnose.where import mismatch
from sim2real.effects import named
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.output import provenance
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.batch import Batch
from sim2real.servo.problem import minimise
from sim2real.servo.trace import Trace

__all__ = ["Case", "diagnose", "diagnose_all"]

Array = NDArray[np.float64]

_DONE = 0.85
"""Share of the removable error from which what was named explains the mismatch."""


def diagnose(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    model: Model | None = None,
    references: Sequence[Recording] = (),
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find the physics that a fitted servo leaves out.

    Args:
        recordings: Recordings of the servos.
        robot: The robot that was recorded.
        model: A model to start from; its effects stay part of the plain servo.
        references: Recordings of the robot from before: then only what has changed since is named.
        seed: Seed of the bootstraps.
        progress: Called with the share that is done.

    Returns:
        The diagnosis, with the enriched model and what a report shows.

    Raises:
        InputError: If the recordings and the robot do not agree, or no joint moves.
    """
    case = Case(recordings, robot, model, references)
    (found,) = diagnose_all([case], seed=seed, thorough=True, progress=until_then(progress))
    return predicting(found, recordings, seed, progress)


def diagnose_all(
    cases: Sequence[Case],
    *,
    seed: int = 0,
    device: str = "cpu",
    thorough: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Diagnosis]:
    """Diagnose any number of robots together, all their simulations in a few launches.

    Args:
        cases: The robots.
        seed: Seed of the bootstraps.
        device: Warp device.
        thorough: Whether to work out decoys, the black box, detection limits, the next experiment
            and what the figures show as well.
        progress: Called with the share that is done.
    """
    found: dict[int, Diagnosis] = {}
    for group, step in sampled_alike([case.recordings for case in cases], progress):
        some = _together([cases[k] for k in group], seed, device, step, thorough=thorough)
        found |= dict(zip(group, some, strict=True))
    return [found[k] for k in range(len(cases))]


def _together(
    cases: Sequence[Case], seed: int, device: str, progress: Progress, *, thorough: bool
) -> list[Diagnosis]:
    """Diagnose robots that were sampled alike."""
    rng = np.random.default_rng(seed)
    cases = with_known_servos(cases, rng, device)
    ready = [prepared(case) for case in cases]
    everyone = [joint for joints in ready for joint in joints]
    ends = np.cumsum([len(joints) for joints in ready])
    robots = [list(range(e - len(js), e)) for e, js in zip(ends, ready, strict=True)]
    data = [joint.traces for joint in everyone]
    batch = Batch(data, device)
    findings = investigate(
        batch,
        data,
        robots,
        rng=rng,
        steps=[joint.step_rad for joint in everyone],
        models=rows(cases, ready),
        bases=bases(cases, ready),
        progress=lambda share: progress(0.8 * share),
    )
    findings = against_references(batch, cases, ready, robots, findings)
    rich = [_enriched(finding) for finding in findings]
    plain = [finding.book.plain for finding in findings]
    before, after = (
        residual_angles(batch, joined([h.fit for h in some])) for some in (plain, rich)
    )
    ordinary = minimise(batch, joined([h.fit for h in plain]).servos, iterations=10, white=True)
    unseen_plain = held_out(data, [h.fit.servos for h in plain], device=device)
    progress(0.85)
    unseen_rich = held_out(data, [h.fit.servos for h in rich], white=False, device=device)
    progress(0.9)
    results = []
    for case, joints, robot in zip(cases, ready, robots, strict=True):
        part = _Part(
            joints,
            [findings[j] for j in robot],
            [rich[j] for j in robot],
            [before[j] for j in robot],
            [after[j] for j in robot],
            [ordinary.servos.theta[j] for j in robot],
            [unseen_plain[j] for j in robot],
            [unseen_rich[j] for j in robot],
        )
        results.append(_diagnosis(case, part, seed, rng, thorough=thorough))
    progress(1.0)
    return results


@dataclass(frozen=True)
class _Part:
    """What is known of the joints of one robot, one entry a joint."""

    joints: list[Joint]
    findings: list[Finding]
    rich: list[Hypothesis]
    before: list[Array]
    after: list[Array]
    least_squares: list[Array]
    unseen_plain: list[Unseen | None]
    unseen_rich: list[Unseen | None]


def _enriched(finding: Finding) -> Hypothesis:
    """The servo with what is named on the joint, or the plain one."""
    book = finding.book
    heads = {g.members[0] for g in finding.groups if g.probability >= NAMED}
    wanted = book.base | (heads & finding.best.effects)
    return book.tried.get(wanted, finding.best if heads else book.plain)


def _diagnosis(
    case: Case, part: _Part, seed: int, rng: np.random.Generator, *, thorough: bool
) -> Diagnosis:
    names = [joint.name for joint in part.joints]
    by_joint = dict(zip(names, part.findings, strict=True))
    rich = dict(zip(names, part.rich, strict=True))
    said = gathered(by_joint)
    figures = {name: _heldout(part, k) for k, name in enumerate(names)}
    effects = named_effects(by_joint, said, rich, figures)
    differing = tuple(
        mismatch(f, names[k], part.joints[k].traces, part.before[k], _errors(part, k))
        for k, f in enumerate(part.findings)
        if f.mismatch
    )
    inputs = [r.path for r in (*case.recordings, *case.references) if r.path]
    origin = provenance([*inputs, *([case.robot.path] if case.robot.path else [])], seed)
    fits = [_fit(part, k, enriched=e) for e in (False, True) for k in range(len(names))]
    signals = [f"{name}.position_rad" for name in names]
    result = Diagnosis(
        verdict=_verdict(by_joint, effects, differing),
        mismatch=differing,
        effects=effects,
        rivals=rivals(by_joint, said),
        unknown={name: f.unknown for name, f in by_joint.items()},
        hypothesis={},
        false_discovery_rate=0.0,
        baseline_fit=dict(zip(signals, fits[: len(names)], strict=True)),
        enriched_fit=dict(zip(signals, fits[len(names) :], strict=True)),
        ladders={},
        detection_limits=(),
        next_experiment=None,
        gate=gate(case) if thorough else (),
        model=_model(case, part, origin),
        baseline=_baseline(part),
        provenance=origin,
    )
    if not thorough:
        return result
    more: Extras = extras(
        case.robot,
        names,
        [joint.traces for joint in part.joints],
        [joint.noise for joint in part.joints],
        part.findings,
        part.rich,
        (part.before, part.after),
        part.unseen_plain,
        rng,
    )
    ladders = {
        signal: Ladder(
            baseline=figures[name]["rmse_before"] or 0.0,
            enriched=figures[name]["rmse_after"] or 0.0,
            best_decoy=more.best_decoy.get(name),
            black_box=more.black_box.get(name),
            noise=part.joints[k].noise,
        )
        for k, (name, signal) in enumerate(zip(names, signals, strict=True))
        if figures[name]["rmse_before"] is not None
    }
    return replace(
        result,
        hypothesis=more.hypothesis,
        false_discovery_rate=more.false_discovery_rate,
        ladders=ladders,
        detection_limits=more.detection_limits,
        next_experiment=more.next_experiment,
        evidence=more.evidence,
    )


def _rms(residual: Array, given: Sequence[Trace]) -> float:
    kept = [r[: t.t.size][t.used] for r, t in zip(residual, given, strict=False)]
    return float(np.sqrt(np.mean(np.concatenate(kept) ** 2)))


def _errors(part: _Part, k: int) -> tuple[float, float]:
    unseen = part.unseen_plain[k]
    rmse = _rms(part.before[k], part.joints[k].traces) if unseen is None else unseen.rmse
    return rmse, part.joints[k].noise


def _fit(part: _Part, k: int, *, enriched: bool) -> dict[str, float | None]:
    unseen = (part.unseen_rich if enriched and _richer(part, k) else part.unseen_plain)[k]
    residual = (part.after if enriched else part.before)[k]
    train = _rms(residual, part.joints[k].traces)
    return {"train": train, "heldout": None if unseen is None else unseen.rmse}


def _richer(part: _Part, k: int) -> bool:
    return part.rich[k].effects != part.findings[k].book.base


def _heldout(part: _Part, k: int) -> dict[str, float | None]:
    plain = part.unseen_plain[k]
    rich = part.unseen_rich[k] if _richer(part, k) else plain
    if plain is None or rich is None:
        return {"rmse_before": None, "rmse_after": None, "recoverable_removed": None}
    # A sensor may wander slowly; no model removes that.
    noise = min(part.joints[k].noise * np.sqrt(1 + WANDER_SHARE**2), plain.rmse)
    removable = plain.rmse - noise
    removed = (plain.rmse - rich.rmse) / removable if removable > 0 else 0.0
    return {
        "rmse_before": plain.rmse,
        "rmse_after": rich.rmse,
        "recoverable_removed": float(np.clip(removed, -1.0, 1.0)),
    }


def _verdict(
    findings: Mapping[str, Finding],
    effects: Sequence[NamedEffect],
    differing: Sequence[Mismatch],
) -> Verdict:
    if not differing:
        return "consistent"
    if not effects:
        return "unexplained"
    if any(f.mismatch and (f.left or f.unknown > NAMED) for f in findings.values()):
        return "partly_explained"
    return "ambiguous" if any(len(e.group) > 1 for e in effects) else "explained"


def _model(case: Case, part: _Part, origin: Mapping[str, object]) -> Model:
    """The enriched simulator."""
    joints = {
        joint.name: servo(joint, part.rich[k].fit.servos.theta[0], part.rich[k])
        if _richer(part, k)
        else _plain(part, k)
        for k, joint in enumerate(part.joints)
    }
    fit = {
        f"{j.name}.position_rad": _fit(part, k, enriched=True) for k, j in enumerate(part.joints)
    }
    body = case.model.body if case.model else {}
    uneven = {f.link.effect: f.link.value for f in part.findings if f.link is not None}
    shared = tuple(
        FittedEffect(effect, {named(effect).parameters[0].name: value})
        for effect, value in uneven.items()
    )
    return Model(joints=joints, body=body, effects=shared, fit=fit, provenance=dict(origin))


def _baseline(part: _Part) -> Model:
    """The simulator before anything was added."""
    return Model(joints={joint.name: _plain(part, k) for k, joint in enumerate(part.joints)})


def _plain(part: _Part, k: int) -> JointModel:
    """The plain servo, by least squares where something is missing: so it predicts best."""
    plain = part.findings[k].book.plain
    theta = part.least_squares[k] if part.findings[k].mismatch else plain.fit.servos.theta[0]
    return servo(part.joints[k], theta, plain)
