"""Which ranges to train a policy with next: those of the realities, where they matter to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rl.forecast.causes import shares_of
from rl.forecast.realities import DEVIATIONS
from rl.forecast.statistics import quantiles
from sim2real.arrays import Array


@dataclass(frozen=True)
class TrainingRange:
    """A parameter to randomize in the next training.

    Attributes:
        parameter: Its name in ``ranges.json``; latencies are those of single joints.
        share: Share of the variance between realities that it explains, 0 to 1.
        drawn: Its 5 % and 95 % quantile in the realities.
        trained: The same in the training of the policy; None if the policy does not state it.
        advice: ``widen``, ``narrow``, ``move`` or ``keep`` the range of the training, so that it
            becomes that of the realities; ``draw`` from that if the training's is not known.
    """

    parameter: str
    share: float
    drawn: tuple[float, float]
    trained: tuple[float, float] | None
    advice: str


def training_ranges(
    names: Sequence[str],
    parameters: Array,
    values: Array,
    weights: Array,
    trained: Mapping[str, Sequence[float]] | None,
    *,
    least: float = 0.01,
) -> list[TrainingRange]:
    """Ranges of the next training, those of the parameters that matter most first.

    Args:
        names: Names of the P parameters; errors of the simulator itself cannot be randomized.
        parameters: Their values in each draw, shape (N, P).
        values: The figure that policies are ranked by, shape (N, T).
        weights: Of the draws, shape (N,), with sum 1.
        trained: By name the quantiles of the training; an effect that it lacks was 0.
        least: Least share of the variance.
    """
    shares = shares_of(parameters, values, weights, names)
    out = []
    for name, column in zip(names, parameters.T, strict=True):
        if name in DEVIATIONS or shares[name] < least:
            continue
        low, high = map(float, quantiles(column[:, None], weights, np.array([0.05, 0.95])))
        before = None
        if trained is not None:
            ends = trained.get(name, (0.0, 0.0))
            before = float(ends[0]), float(ends[1])
        shown = f"body.{name}" if name.startswith("twin.") else name
        advice = _advice((low, high), before)
        out.append(TrainingRange(shown, shares[name], (low, high), before, advice))
    return sorted(out, key=lambda one: -one.share)


def _advice(
    drawn: tuple[float, float], trained: tuple[float, float] | None, slack: float = 0.25
) -> str:
    """What to do with a training's range; ends agree within a share ``slack`` of the width."""
    if trained is None:
        return "draw"
    room = slack * (drawn[1] - drawn[0])
    less = trained[0] > drawn[0] + room or trained[1] < drawn[1] - room
    more = trained[0] < drawn[0] - room or trained[1] > drawn[1] + room
    return {(True, True): "move", (True, False): "widen", (False, True): "narrow"}.get(
        (less, more), "keep"
    )
