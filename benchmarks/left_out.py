"""Fits to films that are scored on films left out: the law, and each effect of the catalogue."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from filmed import Film, by_beat, by_regression, errors

import sim2real as s2r
from sim.calibration.swim_parameters import candidates, law_parameters
from sim.calibration.twin_fit import Calibrated, calibrate
from sim.inference.swims import Simulator, Swim, simulated
from sim.twin.prescribed import by_film, follower
from sim.twin.twin import Coefficients
from sim2real.arrays import Array
from sim2real.inference.parameters import Parameter
from sim2real.model import Model

HIDDEN = ("skin_elasticity", "skin_damping", "skin_viscoelasticity", "skin_coupling")
"""Torques on the joints: a tail that is moved as filmed does not feel them."""
LAW = ("linear_drag", "form_drag", "added_mass")
"""What the twin's law has already, under another name."""
ENOUGH = 8.0
"""Gain in log-likelihood from which an effect is named in a film."""
_SEEN = 0.01  # ``calibrate`` holds out the last samples; here whole clips are held out
_BLOCK_S = 2.0


@dataclass(frozen=True)
class Pool:
    """What swims where: the plain twin and how it is run."""

    model: Model
    simulator: Simulator


@dataclass(frozen=True)
class Tried:
    """An effect fitted with the law: gain in log-likelihood on its own clips, and the fit."""

    effect: str
    free: tuple[Parameter, ...]
    gain: float
    fit: Calibrated


def pool(robot: s2r.Robot) -> Pool:
    """The twin of a robot whose joints are prescribed."""
    servos = {joint.name: follower() for joint in robot.joints}
    return Pool(Model(joints=servos, body={}), by_film(robot))


def by_model(place: Pool, model: Model, held: Film) -> Array:
    """The twin's prediction, shape (T, 3 + J)."""
    return np.asarray(simulated(held.swim, [model], place.simulator)[0])


def fit_law(place: Pool, train: Sequence[Film]) -> Calibrated:
    """The twin's own law, fitted to clips."""
    swims = [one.swim for one in train]
    return calibrate(swims, place.model, law_parameters(), place.simulator, held_out=_SEEN)


def catalogue(robot: s2r.Robot) -> list[tuple[str, tuple[Parameter, ...]]]:
    """Effects that a film with prescribed joints could show, with their parameters."""
    return [
        (name if where in ("body", "camera") else f"{name} ({where})", free)
        for name, where, free in candidates(robot)
        if name not in HIDDEN + LAW
    ]


def try_all(
    place: Pool,
    train: Sequence[Film],
    law: Calibrated,
    effects: Sequence[tuple[str, tuple[Parameter, ...]]],
) -> list[Tried]:
    """Each effect, fitted with the law from where the law alone ended; most gain first."""
    swims = [one.swim for one in train]
    warm = [replace(p, nominal=float(v)) for p, v in zip(law.free, law.best, strict=True)]
    out = []
    for name, free in effects:
        fit = calibrate(
            swims, place.model, [*warm, *free], place.simulator, held_out=_SEEN, evaluations=10
        )
        out.append(Tried(name, free, gain(law, fit, len(free), swims), fit))
    return sorted(out, key=lambda one: -one.gain)


def gain(before: Calibrated, after: Calibrated, parameters: int, swims: Sequence[Swim]) -> float:
    """Log-likelihood gained, a block of two seconds counting once, less what chance would bring.

    Chance: half the parameters times the logarithm of the blocks' number (Schwarz, Ann. Stat. 6
    (1978) 461). The joints' angles are prescribed and say nothing.
    """
    fallen = float(np.log(before.train[1, :3] / after.train[1, :3]).sum())
    return float(blocks(swims) * fallen - 0.5 * parameters * np.log(3 * blocks(swims)))


def blocks(swims: Sequence[Swim]) -> float:
    """How many independent samples clips count for."""
    return float(sum(swim.t[-1] for swim in swims) / _BLOCK_S)


def probabilities(tried: Sequence[Tried]) -> Array:
    """That each effect is missing, one at most; that none is begins ``ENOUGH`` ahead."""
    odds = np.exp(np.clip([one.gain - ENOUGH for one in tried], -50, 50))
    return np.asarray(odds / (1 + odds.sum()))


def leave_out(
    place: Pool,
    films: Sequence[Film],
    effects: Sequence[tuple[str, tuple[Parameter, ...]]],
    kept: int,
    progress: Callable[[], object] = lambda: None,
) -> dict[str, Any]:
    """Fit on ``kept`` clips, score on the others, all ways.

    Returns:
        ``errors`` by predictor, one row a clip, means over the splits that held it out, shape
        (clips, 4); ``tracks`` likewise of the last split; ``splits``, what was fitted in each.
    """
    books = replace(place.model, body={"twin": vars(Coefficients())})
    found: dict[str, list[list[Array]]] = {}
    tracks: dict[str, dict[str, Array]] = {}
    splits = []
    for chosen in itertools.combinations(range(len(films)), kept):
        train = [films[k] for k in chosen]
        law = fit_law(place, train)
        tried = try_all(place, train, law, effects)
        splits.append(_split(law, tried) | {"train": [one.swim.name for one in train]})
        models = {"textbook": books, "uncalibrated": place.model, "calibrated": law.model}
        if tried:
            models["likeliest effect"] = tried[0].fit.model
            named = tried[0].gain >= ENOUGH
            models["diagnosed"] = tried[0].fit.model if named else law.model
        for k in sorted(set(range(len(films))) - set(chosen)):
            held = films[k]
            said = {"by the beat": by_beat(train, held), "regression": by_regression(train, held)}
            said |= {name: by_model(place, model, held)[:, :3] for name, model in models.items()}
            tracks[held.swim.name] = said
            said = said | {
                f"with {one.effect}": by_model(place, one.fit.model, held) for one in tried
            }
            for name, predicted in said.items():
                found.setdefault(name, [[] for _ in films])[k].append(errors(predicted, held))
        progress()
    by_clip = {name: np.array([np.mean(one, axis=0) for one in v]) for name, v in found.items()}
    return {"errors": by_clip, "tracks": tracks, "splits": splits}


def _split(law: Calibrated, tried: Sequence[Tried]) -> dict[str, Any]:
    edge = [
        p.name.partition(".")[2]
        for p, best in zip(law.free, law.best, strict=True)
        if min(best - p.low, p.high - best) < 0.02 * p.typical
    ]
    return {
        "law": {p.name.partition(".")[2]: v for p, v in zip(law.free, law.best, strict=True)},
        "at_bound": edge,
        "effects": [
            {
                "effect": one.effect,
                "gain": one.gain,
                "probability": probability,
                "parameters": values(one),
            }
            for one, probability in zip(tried, probabilities(tried), strict=True)
        ],
    }


def values(one: Tried) -> dict[str, float]:
    """What was fitted of an effect, by parameter."""
    best = {p.name: float(v) for p, v in zip(one.fit.free, one.fit.best, strict=True)}
    return {p.name.rpartition(".")[2]: best[p.name] for p in one.free}
