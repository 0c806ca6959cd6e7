"""A diagnosis of swims in the form that every diagnosis has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.inference.search import Tried
from sim.inference.swims import SIGNALS
from sim2real.body import body_effect
from sim2real.diagnose.result import (
    Diagnosis,
    Estimate,
    Mismatch,
    NamedEffect,
    Rival,
    Verdict,
)
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

_Z90 = 1.645
_FALLEN = 0.8
"""A signal whose error falls below this share of what it was shows the mismatch."""


def findings(
    robot: Robot,
    verdict: Verdict,
    named: Sequence[NamedEffect],
    rivals: Sequence[Rival],
    train: Array,
    held: Array,
    noise: Array,
    gate: str,
    model: Model,
    baseline: Model,
) -> Diagnosis:
    """What a search found.

    Args:
        robot: The robot.
        verdict: In a word.
        named: Effects.
        rivals: What else was considered, likeliest first.
        train: Root mean square error of each signal on what was fitted, before and after, shape
            (2, 3 + J).
        held: Likewise on what was held out.
        noise: What no model could explain of each signal, shape (3 + J,).
        gate: What a reader should know.
        model: The model with what was named.
        baseline: The model without.
    """
    signals = [f"body.{name.replace(' ', '_')}" for name in SIGNALS]
    signals += [f"{joint.name}.position_rad" for joint in robot.joints]

    def figures(e: int) -> dict[str, dict[str, float | None]]:
        return {
            name: {"train": float(train[e, k]), "heldout": float(held[e, k])}
            for k, name in enumerate(signals)
        }

    mismatch = tuple(
        Mismatch(
            signal=signals[k],
            component="body",
            rmse=float(held[0, k]),
            noise=float(noise[k]),
            share=float(1 - (held[1, k] / held[0, k]) ** 2),
            windows_s={},
            where="",
        )
        for k in range(len(SIGNALS))
        if named and held[1, k] < _FALLEN * held[0, k]
    )
    return Diagnosis(
        verdict=verdict,
        mismatch=mismatch,
        effects=tuple(named),
        rivals=tuple(rivals),
        unknown={},
        hypothesis={},
        baseline_fit=figures(0),
        enriched_fit=figures(1),
        ladders={},
        detection_limits=(),
        next_experiment=None,
        gate=(gate,),
        model=model,
        baseline=baseline,
    )


class Fitted(Protocol):
    """What a fit of swims says."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """What was fitted."""

    @property
    def best(self) -> Array:
        """Its values, shape (F,)."""

    @property
    def sd(self) -> Array:
        """Their standard deviations, shape (F,)."""


def named_effect(
    one: Tried[Any],
    base: Fitted,
    now: Fitted,
    probability: float,
    errors: tuple[float, float],
    *,
    usual: Mapping[str, float] = {},
    against: str = "",
) -> NamedEffect:
    """An effect as a diagnosis states it.

    Args:
        one: The effect.
        base: The fit before.
        now: The fit with all that is named.
        probability: That it is there.
        errors: Error of the speed on what was held out, before and after.
        usual: What parameters are where nothing is missing; 0 where it is not said.
        against: What a material's effect is compared with.
    """
    names = [p.name for p in now.free]
    parameters, told = {}, []
    for p in one.effect.free:
        k = names.index(p.name)
        mean, sd = float(now.best[k]) - usual.get(p.name, 0.0), float(now.sd[k])
        short = p.name.rpartition(".")[2]
        parameters[short] = Estimate(mean, sd, mean - _Z90 * sd, mean + _Z90 * sd)
        told.append(f"{short} {mean:.3g}")
    known = body_effect(one.effect.name)
    where = f" ({one.effect.component}{against})" if known.by_material else ""
    others = ", ".join(f"{x.effect.name} ({x.effect.component})" for x in one.alike)
    or_else = f" Or, as likely: {others}." if others else ""
    return NamedEffect(
        effect=one.effect.name,
        component=one.effect.component,
        probability=min(probability, 0.99),
        group=tuple(dict.fromkeys([one.effect.name, *(x.effect.name for x in one.alike)])),
        parameters=parameters,
        heldout={"rmse_before": errors[0], "rmse_after": errors[1], "recoverable_removed": None},
        baseline_shift={
            p.name: float(now.best[names.index(p.name)] - base.best[k])
            for k, p in enumerate(base.free)
            if p.name in names
        },
        stability=1.0,
        statement=f"{known.title[0].upper()}{known.title[1:]}{where}: {', '.join(told)}.{or_else}",
    )


def verdict_of(kept: Sequence[Tried[Any]]) -> Verdict:
    """In a word."""
    if not kept:
        return "consistent"
    return "ambiguous" if any(one.alike for one in kept) else "explained"


__all__ = ["findings", "named_effect", "verdict_of"]
