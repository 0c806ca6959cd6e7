"""Drag that the robot file leaves out, from how fast swims are and how far their heads yaw.

A search through the catalogue fits a whole force law, which can hide a missing resistance by giving
up its thrust. This estimate keeps the simulator as it is, and asks of two robust figures of each
swim, the mean speed forward and the size of the yaw rate, how large an area at which place makes
them right. The logarithms of the figures have a normal error, with a part common to all swims of a
robot and a part of each swim, which is at least as large as the best area leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from sim.inference.swims import Swim, with_values
from sim2real.arrays import Array
from sim2real.diagnose.result import Diagnosis, Estimate, NamedEffect
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.units import readable

AREA, PLACE = "appendage_drag.area_m2", "appendage_drag.x_m"
COMMON_SD, SWIM_SD = 0.2, 0.13
"""Relative standard deviations of a simulator's speed and yaw, chosen: between robots, where thrust
and drag are off together, and between swims of one (``reports/twin``: 3 to 13 %)."""
_LEAST_M_S, _LEAST_RAD_S = 0.01, 0.02
"""Least figures, as their logarithms are compared: a robot that stands still has none."""


@dataclass(frozen=True)
class Resistance:
    """Drag area of what the robot file leaves out.

    Attributes:
        area: Estimate of the drag area in m2.
        place: Estimate of its distance behind the robot's front in m.
        log_odds: Evidence of an area of any size against none.
        left_out: Errors of the mean speed of each swim in m/s, without the area and with that
            estimated from the other swims, shape (2, S); NaN with a single swim.
    """

    area: Estimate
    place: Estimate
    log_odds: float
    left_out: Array


def grid_of(robot: Robot, *, areas: int = 14, places: int = 4) -> Array:
    """Areas and places to simulate, shape (G, 2); the first has no area.

    Areas are evenly spaced in their logarithm, from a fiftieth to twice the side area of the robot,
    places on the first link.
    """
    side = sum(link.length_m * link.height_m for link in robot.links)
    at = robot.links[0].length_m * (np.arange(places) + 0.5) / places
    size = np.geomspace(0.02 * side, 2 * side, areas)
    pairs = np.stack(np.meshgrid(size, at, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.concatenate([[[0.0, at[0]]], pairs])


def figures(signals: Array) -> Array:
    """Mean speed forward in m/s and size of the yaw rate in rad/s of signals (..., T, 3 + J)."""
    yaw = signals[..., 2] - np.nanmean(signals[..., 2], axis=-1, keepdims=True)
    return np.stack(
        [np.nanmean(signals[..., 0], axis=-1), np.sqrt(np.nanmean(yaw**2, axis=-1))], axis=-1
    )


def resistance(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    signals: Callable[[Sequence[Model], Swim], Array],
) -> Resistance:
    """Estimate the area from swims of one robot.

    Args:
        swims: The recordings.
        model: Servos and body.
        robot: The robot.
        signals: Function from models (E) and a swim to simulated signals (E, T, 3 + J).
    """
    grid = grid_of(robot)
    models = [with_values(model, {AREA: area, PLACE: place}) for area, place in grid]
    predicted = np.stack([figures(signals(models, swim)) for swim in swims], axis=1)
    return from_figures(np.array([figures(swim.signals) for swim in swims]), predicted, grid)


def from_figures(measured: Array, predicted: Array, grid: Array) -> Resistance:
    """Estimate the area from figures that were simulated before.

    Args:
        measured: Figures of S swims, shape (S, 2).
        predicted: The simulated ones for each area and place, shape (G, S, 2).
        grid: Areas and places, shape (G, 2); the first has no area.
    """
    weight, log_odds = _weights(measured, predicted)
    area, place = (_estimate(values, weight) for values in grid[1:].T)
    left_out = np.full((2, len(measured)), np.nan)
    for k in range(len(measured)) if len(measured) > 1 else ():
        others = np.arange(len(measured)) != k
        best = 1 + int(np.argmax(_weights(measured[others], predicted[:, others])[0]))
        left_out[:, k] = np.abs(predicted[[0, best], k, 0] - measured[k, 0])
    return Resistance(area, place, log_odds, left_out)


def _weights(measured: Array, predicted: Array) -> tuple[Array, float]:
    """Posterior of each area and place, shape (G - 1,), and the evidence of any against none."""
    least = np.array([_LEAST_M_S, _LEAST_RAD_S])
    off = np.log(np.maximum(predicted, least) / np.maximum(measured, least))
    off = np.where(np.isfinite(off), off, np.log(1 / least[0]))
    best = int(np.argmin((off**2).sum(axis=(1, 2))))
    deviation = off[best] - off[best].mean(axis=0)
    own = np.maximum(SWIM_SD, np.sqrt((deviation**2).mean(axis=0)))
    log_likelihood = np.array([_log_likelihood(one, own) for one in off])
    some = log_likelihood[1:]
    weight = np.exp(some - logsumexp(some))
    odds = float(logsumexp(some) - np.log(some.size) - log_likelihood[0])
    return weight, odds


def _log_likelihood(off: Array, own: Array) -> float:
    """Of deviations (S, 2), independent between the figures and with a common part in each."""
    total = 0.0
    for column, sd in zip(off.T, own, strict=True):
        covariance = sd**2 * np.eye(column.size) + COMMON_SD**2
        total -= 0.5 * float(column @ np.linalg.solve(covariance, column))
        total -= 0.5 * float(np.linalg.slogdet(covariance)[1])
    return total


def _estimate(values: Array, weight: Array) -> Estimate:
    """Mean, standard deviation and 90 % interval on a grid, interpolated between its points."""
    sizes = np.unique(values)
    mass = np.array([weight[values == size].sum() for size in sizes])
    mean = float(mass @ sizes)
    sd = float(np.sqrt(mass @ (sizes - mean) ** 2))
    if sizes.size == 1:
        return Estimate(mean, sd, mean, mean)
    edges = np.concatenate([sizes[:1], (sizes[1:] + sizes[:-1]) / 2, sizes[-1:]])
    low, high = np.interp((0.05, 0.95), np.concatenate([[0.0], np.cumsum(mass)]), edges)
    return Estimate(mean, sd, float(low), float(high))


def with_resistance(
    diagnosis: Diagnosis, found: Resistance, decisions: Mapping[str, float]
) -> Diagnosis:
    """The diagnosis with the area as an effect, where its search named no likely one.

    Args:
        diagnosis: The result of the search.
        found: The estimate.
        decisions: ``decisions`` of ``law_error.json``.
    """
    effect = named(found, decisions)
    likely = decisions["likely"]
    if effect.probability < likely or any(e.probability >= likely for e in diagnosis.effects):
        return diagnosis
    rivals = tuple(rival for rival in diagnosis.rivals if rival.effect != effect.effect)
    effects = (effect, *diagnosis.effects)
    return replace(diagnosis, verdict="partly_explained", effects=effects, rivals=rivals)


def named(found: Resistance, decisions: Mapping[str, float]) -> NamedEffect:
    """The area as an effect of a diagnosis."""
    most = decisions["most_certain"]
    odds = np.clip(found.log_odds - decisions["resistance"], -40, np.log(most / (1 - most)))
    before, after = (float(np.sqrt(np.mean(errors**2))) for errors in found.left_out)
    area = found.area
    low, mean, high = (readable(AREA, value) for value in (area.q05, area.mean, area.q95))
    return NamedEffect(
        effect=AREA.partition(".")[0],
        component="body",
        probability=float(1 / (1 + np.exp(-odds))),
        group=(AREA.partition(".")[0],),
        parameters={"area_m2": area, "x_m": found.place},
        heldout={
            "rmse_before": before if np.isfinite(before) else None,
            "rmse_after": after if np.isfinite(after) else None,
            "recoverable_removed": None,
        },
        baseline_shift={},
        statement=(
            f"The robot has a drag area that the robot file leaves out: {mean} (90 %: {low} "
            f"to {high}), about {readable(PLACE, found.place.mean)} behind the front. The estimate "
            "is from mean speeds and yaw rates alone, and keeps the simulator as it is."
        ),
    )
