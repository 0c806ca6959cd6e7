"""The effects that a diagnosis considers: where their refits start, and how far they may go."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import CATALOGUE, Effect
from sim2real.servo.parameters import COLUMNS

Array = NDArray[np.float64]

RANDOM = ("latency_jitter", "packet_loss")
"""Effects that are drawn anew for each set-point: no refit can follow them."""
RIPPLE = "cogging"
"""What every gear train has a little of."""
ROUNDING = "encoder_quantization"
"""Seen in the recorded numbers themselves."""

_STRENGTHS = (0.3, 1.0, 3.0, 10.0)
_WEAKER = (30.0,)
"""Further ones of limits, which are weak where they are large."""
_SHAPES = (0.4, 1.0, 2.5)
_STARTS: dict[str, tuple[float, ...]] = {
    "asymmetric_friction.asymmetry": (-0.6, 0.6),
    "cogging.torque_Nm": (0.3,),
    "cogging.phase_rad": (0.0, 2 * np.pi / 3, -2 * np.pi / 3),
    "cogging.period_rad": tuple(1 / np.arange(0.75, 20.0, 0.3)),
}
"""Starts of parameters that are neither a strength nor a shape."""
_LEAST = 0.01
"""Smallest value of a limit, a period or a time, in typical values: at 0 they mean nothing."""
_BOUNDED_BELOW = ("limit", "time_constant", "period", "stiffness", "velocity")


@dataclass(frozen=True)
class Candidate:
    """One effect as a refit sees it, for a servo of given strength.

    Attributes:
        effect: The effect.
        columns: Columns of its K parameters, shape (K,).
        low: Their smallest values, shape (K,).
        high: Their largest values, shape (K,).
        unit: Their natural sizes, shape (K,).
        starts: Values to start from, shape (S, K).
    """

    effect: Effect
    columns: NDArray[np.int32]
    low: Array
    high: Array
    unit: Array
    starts: Array


REFITTED: tuple[Effect, ...] = tuple(
    effect for effect in CATALOGUE if effect.name not in (*RANDOM, ROUNDING)
)
"""Effects whose parameters a refit finds."""


def candidate(effect: Effect, kp: float, inertia: float) -> Candidate:
    """An effect scaled to a servo of ``kp`` N m/rad on ``inertia`` kg m2."""
    given = [p.scaled(kp, inertia) for p in effect.parameters]
    unit = np.array([p.typical or p.high / 3 for p in given])
    low = np.array([p.low for p in given])
    bounded = [any(word in p.name for word in _BOUNDED_BELOW) for p in given]
    low = np.where(bounded, np.maximum(low, _LEAST * unit), low)
    high = np.array([p.high for p in given])
    choices = [_choices(effect, k, float(unit[k]), bool(low[k] < 0)) for k in range(len(given))]
    starts = np.array(list(itertools.product(*choices)))
    return Candidate(
        effect=effect,
        columns=np.array([COLUMNS.index(f"{effect.name}.{p.name}") for p in given], dtype=np.int32),
        low=low,
        high=high,
        unit=unit,
        starts=np.unique(np.clip(starts, low, high), axis=0),
    )


def _choices(effect: Effect, k: int, unit: float, signed: bool) -> tuple[float, ...]:  # noqa: FBT001
    name = effect.parameters[k].name
    special = _STARTS.get(f"{effect.name}.{name}")
    if special is not None:
        return tuple(x * unit for x in special) if name == "torque_Nm" else special
    if k > 0:
        return tuple(x * unit for x in _SHAPES)
    if signed:
        return tuple(sign * x * unit for x in (0.3, 2.0) for sign in (-1, 1))
    weaker = _WEAKER if "limit" in name else ()
    return tuple(x * unit for x in (*_STRENGTHS, *weaker))
