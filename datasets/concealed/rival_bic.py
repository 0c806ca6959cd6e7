"""A rival: the effect with the least BIC, as if residuals were independent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rival_case import Case, Said, entry, surest_first

from sim2real.effects import named
from sim2real.identification.effect_fit import fit_effects
from sim2real.identification.fit import Fit
from sim2real.model import FittedEffect, Model
from sim2real.servo.trace import Trace

COMMON = (
    "coulomb_friction",
    "quadratic_drag",
    "backlash",
    "compliance",
    "deadband",
    "torque_saturation",
    "command_filter",
    "sensor_offset",
)
"""Effects that the ranking by BIC tries."""
ENOUGH = 10.0
"""Difference in BIC from which on an effect is named (Kass & Raftery, JASA 90 (1995) 773)."""


def ranked_by_bic(case: Case) -> Said:
    """The effect with the least BIC, as if the residuals were independent."""
    joints, entries = dict(case.model.joints), []
    for joint, some in case.given.items():
        plain = case.plain[joint]
        every = {name: _with_effect(some, plain, name) for name in COMMON}
        fits = {name: one for name, one in every.items() if one is not None}
        gains = {name: _bic(plain) - _bic(one) for name, one in fits.items()}
        if not gains:
            continue
        best = max(gains, key=lambda name: gains[name])
        if gains[best] > ENOUGH:
            weights = np.exp(0.5 * (np.array([0.0, *gains.values()]) - gains[best]))
            found = _fitted(fits[best])
            entries.append(entry(best, joint, float(1 / weights.sum()), found))
            kp, kd, latency = (float(x) for x in fits[best].row[:3])
            joints[joint] = replace(
                joints[joint],
                kp_Nm_per_rad=kp,
                kd_Nms_per_rad=kd,
                latency_s=latency,
                effects=(FittedEffect(best, found),),
            )
    return Said(surest_first(entries), Model(joints=joints))


def _with_effect(some: list[Trace], plain: Fit, name: str) -> Fit | None:
    """None where the search ends at zero of an effect that has no derivative there, or diverges."""
    try:
        found = fit_effects(some, plain, [named(name)])
    except np.linalg.LinAlgError:
        return None
    return found if np.isfinite(_bic(found)) else None


def _bic(one: Fit) -> float:
    errors = np.concatenate(one.residuals)
    return float(errors.size * np.log(np.mean(errors**2)) + len(one.names) * np.log(errors.size))


def _fitted(one: Fit) -> dict[str, float]:
    pairs = zip(one.names[3:], one.values[3:], strict=True)
    return {name.partition(".")[2]: float(value) for name, value in pairs}
