"""A simulator for what no effects explain whole: those that predict best, whatever they mean.

Where something without a name is left, a noise model takes the slow part of it for noise, and the
fit follows the rest. Names are safer so, predictions worse. So the model is then searched and
fitted anew by plain least squares, and chosen by how it predicts recordings that it has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import fitted_effects
from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.missing.effect_search import search
from sim2real.diagnose.missing.investigate import ROUNDING
from sim2real.diagnose.result import Diagnosis, NamedEffect
from sim2real.identification.held_out import held_out
from sim2real.identification.servo_problem import Hypothesis, Tried
from sim2real.model import JointModel
from sim2real.progress import Progress
from sim2real.recording import Recording
from sim2real.servo.batch import Batch
from sim2real.servo.trace import Trace, traces

BEFORE = 0.7
"""Share of the time that a diagnosis takes before it comes to this."""
_NOTE = (
    "No set of effects explains the recordings whole: this model has those that predict unseen "
    "recordings best, which may stand in for something else."
)


def predicting(
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    seed: int,
    progress: Progress = lambda share: None,
    effort: float = 1.0,
) -> Diagnosis:
    """A diagnosis whose model predicts best; what it names, and how surely, stays.

    Args:
        diagnosis: Returned as it is where it leaves nothing unexplained, and where it started from
            a model with effects, which stay.
        recordings: The recordings that it is of.
        seed: Seed of the bootstraps of the search.
        progress: Called with the share that is done, the diagnosis included.
        effort: Multiple of the search's simulation budget.
    """
    plain = diagnosis.baseline.joints.values() if diagnosis.baseline else ()
    had_effects = any(e.effect != ROUNDING for joint in plain for e in joint.effects)
    if diagnosis.verdict not in ("partly_explained", "unexplained") or had_effects:
        progress(1.0)
        return diagnosis
    differing = {entry.signal.partition(".")[0] for entry in diagnosis.mismatch}
    names = [name for name in diagnosis.model.joints if name in differing]
    data = [traces(recordings, name) for name in names]
    batch = Batch(data, bounded=False, white=True)
    ledgers, problem = search(
        batch,
        baselines(batch),
        level=DECISION.predictor.search_level,
        rng=np.random.default_rng(seed),
        effort=effort,
        progress=lambda share: progress(BEFORE + 0.8 * (1 - BEFORE) * share),
    )
    joints, fit, unfinished = (
        dict(diagnosis.model.joints),
        dict(diagnosis.model.fit),
        {*diagnosis.unfinished},
    )
    for name, tried, of_joint in zip(names, ledgers, data, strict=True):
        signal = f"{name}.position_rad"
        best, errors = _best(tried, of_joint)
        if _weighted(errors) < (1 - DECISION.negligible) * _weighted(fit[signal]):
            joints[name] = _with_servo(joints[name], best)
            fit[signal] = errors
        if tried.case in problem.unfinished:
            unfinished.add(name)
    progress(1.0)
    return replace(
        diagnosis,
        effects=tuple(
            _shifted(effect, diagnosis.model.joints, joints) for effect in diagnosis.effects
        ),
        model=replace(diagnosis.model, joints=joints, fit=fit),
        unfinished=tuple(name for name in joints if name in unfinished),
    )


def _best(
    tried: Tried, data: Sequence[Trace], *, most: int = 24
) -> tuple[Hypothesis, Mapping[str, float | None]]:
    """The set of effects that predicts best, with its error on fitted and unseen recordings."""
    order = sorted(tried.tried.values(), key=lambda h: -h.evidence)
    some = order[:most] + [h for h in order[most:] if len(h.members) < 2]
    unseen = held_out([data] * len(some), [h.fit.servos for h in some])
    errors = [
        {
            "train": float(np.sqrt(h.fit.error2[0] / h.fit.count[0])),
            "heldout": None if u is None else u.rmse,
        }
        for h, u in zip(some, unseen, strict=True)
    ]
    return min(zip(some, errors, strict=True), key=lambda pair: _weighted(pair[1]))


def _weighted(errors: Mapping[str, float | None]) -> float:
    """Error on fitted recordings, and on unseen ones where there are any."""
    seen, unseen = errors["train"], errors["heldout"]
    assert seen is not None
    weight = DECISION.predictor.unseen_weight
    return seen if unseen is None else (1 - weight) * seen + weight * unseen


def _with_servo(joint: JointModel, best: Hypothesis) -> JointModel:
    """The joint with other gains and effects; the step of its sensor stays.

    They were fitted without a rotor, so the joint keeps none.
    """
    kp, kd, latency = (float(x) for x in best.fit.servos.theta[0, :3])
    steps = tuple(e for e in joint.effects if e.effect == ROUNDING)
    return replace(
        joint,
        kp_Nm_per_rad=kp,
        kd_Nms_per_rad=kd,
        latency_s=latency,
        motor={name: x for name, x in joint.motor.items() if name != "rotor_inertia_kgm2"},
        effects=(*fitted_effects(best, None), *steps),
        notes=(*joint.notes, _NOTE),
    )


def _shifted(
    effect: NamedEffect, before: Mapping[str, JointModel], after: Mapping[str, JointModel]
) -> NamedEffect:
    """The effect, its shift of the plain servo that to the new model."""
    if effect.component not in before:
        return effect
    old, new = before[effect.component], after[effect.component]
    shift = effect.baseline_shift
    moved = {name: x + getattr(new, name) - getattr(old, name) for name, x in shift.items()}
    return replace(effect, baseline_shift=moved)
