"""A simulator for what no effects explain whole: those that predict best, whatever they mean.

Where something without a name is left, a noise model takes the slow part of it for noise, and the
fit follows the rest. Names are safer so, predictions worse. So the model is then searched and
fitted anew by plain least squares, and chosen by how it predicts recordings that it has not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import fitted_effects
from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.missing.effect_search import search
from sim2real.diagnose.missing.investigate import ROUNDING
from sim2real.diagnose.result import Diagnosis, NamedEffect
from sim2real.identification.held_out import held_out
from sim2real.identification.servo_problem import Hypothesis, Tried
from sim2real.model import JointModel
from sim2real.recording import Recording
from sim2real.servo.batch import Batch
from sim2real.servo.trace import Trace, traces

Array = NDArray[np.float64]

BEFORE = 0.7
"""Share of the time that a diagnosis takes before it comes to this."""
_NOTE = (
    "No set of effects explains the recordings whole: this model has those that predict unseen "
    "recordings best, which may stand in for something else."
)


def predicting(
    found: Diagnosis,
    recordings: Sequence[Recording],
    seed: int,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """A diagnosis whose model predicts best; what it names, and how surely, stays.

    Args:
        found: A diagnosis. It is returned as it is where it leaves nothing unexplained, and where
            it started from a model with effects, which stay.
        recordings: The recordings that it is of.
        seed: Seed of the bootstraps of the search.
        progress: Called with the share that is done, the diagnosis included.
    """
    if found.verdict not in ("partly_explained", "unexplained") or _had_effects(found):
        progress(1.0)
        return found
    differing = {entry.signal.partition(".")[0] for entry in found.mismatch}
    names = [name for name in found.model.joints if name in differing]
    given = [traces(recordings, name) for name in names]
    batch = Batch(given, bounded=False, white=True)
    rng = np.random.default_rng(seed)
    tried, problem = search(
        batch,
        baselines(batch),
        level=DECISION.predictor.search_level,
        rng=rng,
        progress=lambda share: progress(BEFORE + 0.8 * (1 - BEFORE) * share),
    )
    joints, fit = dict(found.model.joints), dict(found.model.fit)
    for name, one, data in zip(names, tried, given, strict=True):
        signal = f"{name}.position_rad"
        best, figures = _best(one, data)
        if _error(figures) < (1 - DECISION.negligible) * _error(fit[signal]):
            joints[name] = _joint(joints[name], best)
            fit[signal] = figures
    progress(1.0)
    effects = tuple(_shifted(effect, found.model.joints, joints) for effect in found.effects)
    ended = {name for one, name in zip(tried, names, strict=True) if one.case in problem.unfinished}
    return replace(
        found,
        effects=effects,
        model=replace(found.model, joints=joints, fit=fit),
        unfinished=tuple(n for n in found.model.joints if n in ended or n in found.unfinished),
    )


def _had_effects(found: Diagnosis) -> bool:
    joints = found.baseline.joints.values() if found.baseline else ()
    return any(effect.effect != ROUNDING for joint in joints for effect in joint.effects)


def _best(
    tried: Tried, data: Sequence[Trace], *, most: int = 24
) -> tuple[Hypothesis, dict[str, float | None]]:
    """The set of effects that predicts best, with its error on fitted and unseen recordings."""
    order = sorted(tried.tried.values(), key=lambda h: -h.evidence)
    some = order[:most] + [h for h in order[most:] if len(h.members) < 2]
    unseen = held_out([data] * len(some), [h.fit.servos for h in some])
    figures: list[dict[str, float | None]] = [
        {
            "train": float(np.sqrt(h.fit.error2[0] / h.fit.count[0])),
            "heldout": None if u is None else u.rmse,
        }
        for h, u in zip(some, unseen, strict=True)
    ]
    best = min(range(len(some)), key=lambda k: _error(figures[k]))
    return some[best], figures[best]


def _error(figures: Mapping[str, float | None]) -> float:
    seen, unseen = figures["train"], figures["heldout"]
    assert seen is not None
    return (
        seen
        if unseen is None
        else (1 - DECISION.predictor.unseen_weight) * seen
        + DECISION.predictor.unseen_weight * unseen
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


def _joint(before: JointModel, best: Hypothesis) -> JointModel:
    """The joint with other gains and effects; the step of its sensor stays."""
    kp, kd, latency = (float(x) for x in best.fit.servos.theta[0, :3])
    steps = tuple(e for e in before.effects if e.effect == ROUNDING)
    return replace(
        before,
        kp_Nm_per_rad=kp,
        kd_Nms_per_rad=kd,
        latency_s=latency,
        effects=(*fitted_effects(best, None), *steps),
        notes=(*before.notes, _NOTE),
    )
