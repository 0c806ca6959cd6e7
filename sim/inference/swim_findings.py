"""A diagnosis of swims as a ``Diagnosis``, the result of every diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.swims import SIGNALS
from sim2real.arrays import Array
from sim2real.diagnose.result import Diagnosis, Mismatch, NamedEffect, Rival, Verdict
from sim2real.model import Model
from sim2real.robot import Robot

_IMPROVED = 0.8
"""Ratio of errors after and before, below which a signal shows the mismatch."""


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
    """The diagnosis with these results.

    Args:
        robot: The robot.
        verdict: The verdict.
        named: Reported effects.
        rivals: Other effects that were considered, likeliest first.
        train: Root mean square error of each signal in the fitted part, before and after, shape
            (2, 3 + J).
        held: Likewise in the held-out part.
        noise: Standard deviation of each signal's noise, shape (3 + J,).
        gate: A remark for the reader.
        model: The enriched model.
        baseline: The plain model.
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
        if named and held[1, k] < _IMPROVED * held[0, k]
    )
    return Diagnosis(
        verdict=verdict,
        mismatch=mismatch,
        effects=tuple(named),
        rivals=tuple(rivals),
        unknown={},
        baseline_fit=figures(0),
        enriched_fit=figures(1),
        detection_limits=(),
        next_experiment=None,
        gate=(gate,),
        model=model,
        baseline=baseline,
    )
