"""A diagnosis of swims in the form that every diagnosis has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.inference.swims import SIGNALS
from sim2real.diagnose.result import (
    Diagnosis,
    Mismatch,
    NamedEffect,
    Rival,
    Verdict,
)
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

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
        baseline_fit=figures(0),
        enriched_fit=figures(1),
        ladders={},
        detection_limits=(),
        next_experiment=None,
        gate=(gate,),
        model=model,
        baseline=baseline,
    )


__all__ = ["findings"]
