"""Which sets of effects swims leave open, from a search."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from sim.inference.coordinates import in_fit
from sim.inference.searched import Searched, names_of
from sim.inference.swim_decision import Name, Names
from sim.inference.twin_search import Fit
from sim.robot.swimmer import CONTROL_S
from sim2real.body import body_effect
from sim2real.diagnose.swim_rivals import SwimRivals, SwimSet
from sim2real.inference.selection import Hypothesis


def rival_sets(
    result: Searched,
    probability: Mapping[Names, float],
    numbers: Mapping[str, float],
    *,
    most: int = 10,
) -> SwimRivals:
    """The sets of effects that may be present, given the swims.

    They are the most probable ones and, for every further effect, the most probable set that has
    it.

    Args:
        result: The result of the search.
        probability: Probabilities of the sets that it tried.
        numbers: ``decisions`` of ``law_error.json``.
        most: Largest number of sets.
    """
    problem = result.problem
    fits = {frozenset(names_of(h.members)): h for h in result.found}
    chosen = list(_representatives(probability, most))
    total = sum(probability[names] for names in chosen)
    noise_models = [s.pose_noise for s in problem.swims if s.pose_noise is not None]
    joint_sd = [np.broadcast_to(s.noise, s.signals.shape[1])[3:] for s in problem.swims]
    columns = problem.coordinates.columns
    return SwimRivals(
        component="body",
        period_s=CONTROL_S,
        pose_sd=np.mean([n.sd for n in noise_models], axis=0) if noise_models else np.zeros(3),
        pose_lag_s=noise_models[0].lag_s if noise_models else 0.0,
        joint_sd_rad=np.mean(joint_sd, axis=0),
        shares=problem.prior.shares,
        imitation={
            c.name: float(sd) for c, sd in zip(columns, problem.prior.imitation, strict=True)
        },
        relative=numbers["relative"],
        temperature=numbers["temperature"],
        sets=tuple(_set(result, fits[names], probability[names] / total) for names in chosen),
    )


def _representatives(
    probability: Mapping[Names, float], most: int, *, least: float = 0.02
) -> Iterator[Names]:
    """Sets that are probable, then those that have an effect that no earlier one has."""
    ranked = sorted(probability, key=lambda names: -probability[names])
    first = [names for names in ranked if probability[names] > least][:most]
    yield from first
    covered, left = {name for names in first for name in names}, most - len(first)
    for names in ranked:
        if left > 0 and names not in first and not covered.issuperset(names):
            covered.update(names)
            left -= 1
            yield names


def _set(result: Searched, hypothesis: Hypothesis[Fit], probability: float) -> SwimSet:
    problem, columns = result.problem, result.problem.coordinates.columns
    free = np.flatnonzero(in_fit(columns, hypothesis.members))
    covariance = problem.covariance(hypothesis.members, hypothesis.fit.near)[np.ix_(free, free)]
    return SwimSet(
        effects=tuple(_stated(name) for name in names_of(hypothesis.members)),
        probability=float(probability),
        coordinates={columns[k].name: float(hypothesis.fit.x[k]) for k in free},
        information=np.asarray(np.linalg.inv(covariance)),
    )


def _stated(name: Name) -> str:
    """The effect, with its material."""
    effect, component = name
    return f"{effect}.{component}" if body_effect(effect).by_material else effect
