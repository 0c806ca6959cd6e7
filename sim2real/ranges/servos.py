"""Ranges of a servo's gains and effects, from its posterior or from its model's intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim2real.inference.parameters import unit_of
from sim2real.model import JointModel
from sim2real.posterior.servo import ServoPosterior
from sim2real.ranges.entry import Range, uniform

LOW, HIGH = 0.05, 0.95
"""Quantiles between which a parameter is randomized."""
_GAINS = ("kp_Nm_per_rad", "kd_Nms_per_rad")
_PER_INERTIA = {"kp_Nm_per_rad": "1/s²", "kd_Nms_per_rad": "1/s"}


def from_posterior(joint: str, found: ServoPosterior, recordings: str) -> list[Range]:
    """Everything sampled but the latency, which has a range of its own.

    Args:
        joint: The joint's name.
        found: Its posterior.
        recordings: Names of the recordings, for the source.
    """
    low, high = found.quantiles(LOW, HIGH)
    source = f"{recordings}: 5 % and 95 % quantiles of the posterior"
    return [
        uniform(f"{joint}.{prior.name}", low[k], high[k], prior.unit, source)
        for k, prior in enumerate(found.priors.each)
        if prior.name != "latency_s"
    ]


def from_model(joint: str, model: JointModel, known: Sequence[str] = ()) -> list[Range]:
    """What the model says by itself: its 90 % intervals, or its values where it has none.

    Args:
        joint: The joint's name.
        model: The joint.
        known: Parameters that have a range already.
    """
    values = {name: getattr(model, name) for name in _GAINS}
    for effect in model.effects:
        values |= {f"{effect.effect}.{name}": x for name, x in effect.parameters.items()}
    out = []
    for name, value in values.items():
        if f"{joint}.{name}" in known:
            continue
        low, high = model.interval.get(name, (value, value))
        source = "the model: its 90 % interval"
        if name not in model.interval:
            source = "the model: its value; it gives no interval"
        elif not (math.isfinite(low) and math.isfinite(high)):
            source = "the model: its 90 % interval, an open end taken at the value"
            low, high = (end if math.isfinite(end) else value for end in (low, high))
        unit = _PER_INERTIA.get(name) if model.per_inertia else None
        out.append(uniform(f"{joint}.{name}", low, high, unit or unit_of(name), source))
    return out
