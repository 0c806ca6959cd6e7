"""What one who knows the true plant and its noise can tell from the recordings given.

The log-likelihood ratio of a hidden effect is that of the truth over that of the same plant without
the effect, its gains and latency refitted; no tool should be asked to see what this does not show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import JOINTS
from cases import Case, make_effect
from catalogue import EFFECTS, Scale
from fit import GIVEN, Fit, evaluate, expected, no_offsets, refit
from world import Hidden

RIVAL_WITHIN = 5.0
RIVAL_STARTS = (0.15, 0.6, 2.0)
# Not rivals: a rounding shows in the readings themselves.
NO_RIVAL = ("encoder_quantization",)


def consult(case: Case, scales: list[Scale], *, groups: bool) -> dict[str, Any]:
    """What the answers say under ``oracle``; rms in rad, ratios in natural logarithms."""
    said: dict[str, Any] = {"heldout_floor_rad": _heldout_floor(case)}
    if not case.hidden:
        return said
    plain, said["llr"], said["missing_rms_rad"], said["heldout_plain_rad"] = {}, {}, {}, {}
    for j in _affected(case.hidden):
        plain[j] = refit(case, j, lambda _: [], no_offsets())
        truth = evaluate(case, case.hidden, j, no_offsets())[1]
        said["llr"][JOINTS[j]] = truth - plain[j].loglik
        said["missing_rms_rad"][JOINTS[j]] = _rms_apart(case, j, plain[j])
        take = case.takes["c"]
        seen, _ = expected(case, "c", [], j, plain[j].offsets)
        said["heldout_plain_rad"][JOINTS[j]] = _rms(take.measured[:, j] - seen)
    said["llr_total"] = sum(said["llr"].values())
    if len(case.hidden) > 1:
        said["llr_of_each"] = {
            f"{one.effect}@{one.component}": _llr_without(case, one, plain) for one in case.hidden
        }
    if groups and case.kind == "single" and case.hidden[0].joint is not None:
        j = case.hidden[0].joint
        visible = said["llr_total"] >= RIVAL_WITHIN
        said["group"] = _group(case, j, scales[j], plain[j]) if visible else None
    return said


def _affected(hidden: list[Hidden]) -> list[int]:
    if any(one.joint is None for one in hidden):
        return list(range(len(JOINTS)))
    return sorted({one.joint for one in hidden if one.joint is not None})


def _llr_without(case: Case, dropped: Hidden, plain: dict[int, Fit]) -> float:
    """Of one of two effects, the other staying."""
    rest = [one for one in case.hidden if one is not dropped]
    total = 0.0
    for j in _affected([dropped]):
        starts = [no_offsets(), plain[j].offsets]
        fits = [refit(case, j, lambda _: rest, start) for start in starts]
        total += evaluate(case, case.hidden, j, no_offsets())[1] - max(f.loglik for f in fits)
    return total


def _group(case: Case, joint: int, scale: Scale, plain: Fit) -> list[str]:
    """The true effect and those that explain the recordings nearly as well, shapes nominal."""
    truth = evaluate(case, case.hidden, joint, no_offsets())[1]
    group = [case.hidden[0].effect]
    for name, effect in EFFECTS.items():
        if name in (*group[:1], *NO_RIVAL) or effect.place != "joint":
            continue
        if truth - _rival(case, joint, name, scale, plain, truth).loglik < RIVAL_WITHIN:
            group.append(name)
    return group


def _rival(case: Case, joint: int, name: str, scale: Scale, plain: Fit, truth: float) -> Fit:
    """The rival's best fit over its strength and sign, started from several strengths."""
    best = Fit(plain.offsets, -np.inf)
    for side in (0.25, 0.75):
        shape = np.array([side, 0.5, 0.5])

        def hidden(log_strength: float, shape: np.ndarray = shape) -> list[Hidden]:
            return [make_effect(name, joint, float(np.exp(log_strength)), scale, shape)]

        starts = [np.append(plain.offsets[:3], np.log(s)) for s in RIVAL_STARTS]
        likely = [evaluate(case, hidden(s[3]), joint, s)[1] for s in starts]
        fit = refit(case, joint, hidden, starts[int(np.argmax(likely))], free=4, goal=truth)
        best = max(best, fit, key=lambda one: one.loglik)
        if (
            hidden(0.0)[0].parameters
            == make_effect(name, joint, 1.0, scale, np.array([1 - side, 0.5, 0.5])).parameters
        ):
            break  # it has no sign and no first shape
    return best


def _heldout_floor(case: Case) -> dict[str, float]:
    take, floor = case.takes["c"], {}
    for j, joint in enumerate(JOINTS):
        seen, _ = expected(case, "c", case.hidden, j, no_offsets())
        floor[joint] = _rms(take.measured[:, j] - seen)
    return floor


def _rms_apart(case: Case, joint: int, plain: Fit) -> float:
    """Of the noise-free motions with and without what is hidden, over the given recordings."""
    apart = [
        expected(case, recording, case.hidden, joint, no_offsets())[0]
        - expected(case, recording, [], joint, plain.offsets)[0]
        for recording in GIVEN
    ]
    return _rms(np.concatenate(apart))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
