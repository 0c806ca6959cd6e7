"""Diagnosis of swims in a pool: which effects of the body or the camera does the twin leave out?

The search (``searched``) fits every effect of the catalogue together with servos and force law, and
the error of the twin counts as noise. An effect is reported if it predicts the end of each swim
better when fitted to the beginning. Effects that imitate one another form a group. Where an unnamed
shape (``unlisted``) fits better than all effects, the diagnosis abstains. Thresholds are in
``law_error.json``. Where the search names nothing, without references, the mean speeds alone may
state the drag area (``resistance``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sim.calibration.swim_parameters import Candidate
from sim.inference import poses
from sim.inference.coordinates import SwimSimulator, signals_at, signals_of
from sim.inference.law_error import LAW_ERROR, LawError
from sim.inference.resistance import resistance, with_resistance
from sim.inference.searched import HELD_OUT, Searched, learned, names_of, raw, searched
from sim.inference.swim_decision import decide
from sim.inference.swim_findings import findings
from sim.inference.swim_sets import rival_sets
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, TwinSwims
from sim2real.arrays import Array
from sim2real.body import body_effect, material_note
from sim2real.diagnose.result import Diagnosis, Estimate, NamedEffect, Rival, to_design
from sim2real.inference.selection import Hypothesis
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.robot import Robot
from sim2real.units import readable, readable_name

_SAMPLES = 400
_REPEATED = 0.005
_OUT_OF_PLANE = 3.0
"""Least misfit of surge or sway at the beat frequency that suggests motion out of the plane."""
SHAPES = {
    "wave": "an oscillating flow in the pool's frame, e.g. waves",
    "gust": "a disturbance of the head for a few seconds, e.g. the wake of another swimmer",
    "bend": "poses that follow a joint, e.g. a marker that is not on the head",
    "mount": "a heading that drifts, e.g. a camera that turns",
    "change": "a change of the robot during the swim",
}
"""Possible causes of each unnamed shape."""


def diagnose_swims(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    *,
    references: Sequence[Swim] = (),
    law_error: LawError = LAW_ERROR,
    resimulate: Callable[[Model], tuple[SwimSimulator, Model] | None] = lambda result: None,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Find the effects of body and camera that the simulator leaves out.

    Args:
        swims: Pool recordings of one robot in one pool.
        model: The servos.
        robot: The robot.
        simulate: The twin (``sim.inference.followed.by_followed_twin``).
        references: Swims of the same robot in which nothing is known to be missing.
        law_error: The twin's error and the thresholds.
        resimulate: Function from the likely model of the first search to a simulator for a second
            one and the model that it is exact for, or None (``in_water.resimulation``).
        progress: Called with the share that is done.

    Returns:
        The diagnosis; its errors are held-out errors of the speed over ground, in m/s.
    """
    prior = learned(references, model, robot, simulate, law_error)
    result = searched(swims, model, robot, simulate, prior, progress)
    resimulated = resimulate(likely_model(result, law_error, referred=bool(references)))
    if resimulated is not None:
        result = searched(swims, model, robot, resimulated[0], prior, simulated=resimulated[1])
    diagnosis = diagnosis_of(result, robot, law_error, referred=bool(references))
    if references or any(e.probability >= law_error.decisions["likely"] for e in diagnosis.effects):
        return diagnosis
    lacking = resistance(
        swims, model, robot, lambda models, swim: signals_of(models, swim, simulate)
    )
    return with_resistance(diagnosis, lacking, law_error.decisions)


def likely_model(result: Searched, law_error: LawError, *, referred: bool) -> Model:
    """The fitted model with the likely effects, for another simulation in the fluid.

    Args:
        result: The result of the search.
        law_error: The twin's error and the thresholds.
        referred: Whether there were reference swims.
    """
    decided = decide(raw(result, referred=referred), law_error.decisions)
    likely = {
        effect.name
        for effect in decided.named
        if effect.probability >= law_error.decisions["likely"]
    }
    fit = next(
        hypothesis.fit for hypothesis in result.found if set(names_of(hypothesis.members)) == likely
    )
    return result.problem.coordinates.model_at(fit.x)


def diagnosis_of(
    result: Searched, robot: Robot, law_error: LawError, *, referred: bool
) -> Diagnosis:
    """The diagnosis from the result of a search: probabilities, verdict and statements.

    Args:
        result: The result of the search.
        robot: The robot.
        law_error: The twin's error and the thresholds.
        referred: Whether there were reference swims.
    """
    decided = decide(raw(result, referred=referred), law_error.decisions)
    problem, c = result.problem, result.problem.coordinates
    chosen = next(h for h in result.found if frozenset(names_of(h.members)) == decided.offered)
    fitted = next(
        h for h in result.found
        if frozenset(names_of(h.members)) >= {entry.name for entry in decided.named}
    )  # fmt: skip
    pair = (result.plain, chosen)
    held_out = [result.held[entry.members] for entry in pair]
    errors = [_errors(problem, entry.fit) for entry in held_out]
    before, after = (entry.speed for entry in held_out)
    named = []
    for entry in decided.named:
        effect = next(e for e in c.effects if (e.name, e.component) == entry.name)
        parameters = _estimates(result, fitted, effect, law_error.decisions["relative"])
        sizes = ", ".join(
            f"{readable_name(name)} {readable(name, x.mean)}" for name, x in parameters.items()
        )
        described = body_effect(effect.name)
        where = material_note(effect.name, effect.component)
        others = ", ".join(f"{name} ({of})" for name, of in entry.group[1:])
        or_else = f" These swims do not distinguish it from {others}." if others else ""
        title = f"{described.title[0].upper()}{described.title[1:]}"
        named.append(
            NamedEffect(
                effect=effect.name,
                component=effect.component,
                probability=entry.probability,
                group=tuple(dict.fromkeys(name for name, _ in entry.group)),
                parameters=parameters,
                heldout={
                    "rmse_before": before, "rmse_after": after, "recoverable_removed": None,
                },
                baseline_shift={
                    c.columns[k].name: float(chosen.fit.x[k] - result.plain.fit.x[k])
                    for k in c.base
                },
                statement=f"{title}{where}: {sizes}.{or_else}",
            )
        )  # fmt: skip
    rivals = [Rival(name, of, p) for (name, of), p in decided.rivals[:5]]
    corrected = "" if "water" not in c.model.body else ", corrected by simulations in the fluid"
    gate = [
        f"The swims were simulated in the reduced-order twin{corrected}; the error of the twin "
        "counts as noise (reports/pool_diagnosis)."
    ]
    if not referred:
        gate.append(
            "There are no reference swims in which nothing is missing. Drag, friction and added "
            "mass that this robot always has, and errors of the twin for its shape, cannot be "
            "distinguished from missing effects."
        )
    likely = law_error.decisions["likely"]
    if decided.unlisted >= likely:
        gate.append(
            f"An effect is likely that the catalogue lacks: {SHAPES[decided.shape.split()[0]]}."
        )
    sideways, turn = float(result.misfit[:2, 1].max()), float(result.misfit[2, 1])
    if decided.unlisted >= likely and sideways > _OUT_OF_PLANE and sideways > 1.5 * turn:
        gate.append(
            f"The residual is mainly the head's sideways motion at the tail beat ({sideways:.0f} "
            f"times the usual one), more than its turning ({turn:.0f}). A body that rolls or "
            "heaves looks like this to an overhead camera; a planar model cannot follow it."
        )
    repeated = poses.repeated(problem.swims)
    if repeated > _REPEATED:
        gate.append(
            f"{100 * repeated:.0f} % of the poses equal the one before: the camera lost frames."
        )
    train, held = (np.stack([part[k] for part in errors]) for k in (0, 1))
    noise = np.mean([np.broadcast_to(s.noise, s.signals.shape[1]) for s in problem.swims], axis=0)
    plain_model, model = (c.model_at(entry.fit.x) for entry in pair)
    diagnosis = findings(
        robot, decided.verdict, named, rivals, train, held, noise, gate[0], model, plain_model
    )
    return replace(
        diagnosis,
        gate=tuple(gate),
        unknown={"body": decided.unlisted},
        next_experiment=to_design(
            ("body", [name for name, _ in entry.group])
            for entry in decided.named
            if entry.probability >= likely
        ),
        swim_rivals=rival_sets(result, decided.sets, law_error.decisions),
    )


def _errors(problem: TwinSwims, fit: Fit) -> tuple[Array, Array]:
    """Root mean square errors of each signal in the first and the last part of the swims."""
    parts: tuple[list[Array], list[Array]] = ([], [])
    for swim in problem.swims:
        (signals,) = signals_at(problem.coordinates, swim, fit.x[None], problem.simulate)
        cut = round(swim.t.size * (1 - HELD_OUT))
        error = signals - swim.signals
        parts[0].append(error[:cut])
        parts[1].append(error[cut:])
    train, held = (np.sqrt(np.nanmean(np.concatenate(p) ** 2, axis=0)) for p in parts)
    return train, held


def _estimates(
    result: Searched, chosen: Hypothesis[Fit], effect: Candidate, relative: float
) -> dict[str, Estimate]:
    """Estimates of an effect's parameters, by sampling: they are nonlinear in the coordinates.

    ``relative`` is the relative standard deviation of an effect's size due to the twin's error.
    """
    problem, c = result.problem, result.problem.coordinates
    columns = c.of_effect(effect)
    covariance = problem.covariance(chosen.members, chosen.fit.near)[np.ix_(columns, columns)]
    covariance = covariance + np.diag(np.square(problem.prior.imitation[columns]))
    covariance = covariance + np.diag(np.square(relative * chosen.fit.x[columns]))
    rng = np.random.default_rng(0)
    samples = np.tile(chosen.fit.x, (_SAMPLES, 1))
    samples[:, columns] = rng.multivariate_normal(chosen.fit.x[columns], covariance, _SAMPLES)
    samples = c.clipped(samples)
    samples[0] = chosen.fit.x
    parameters = [c.parameters(x) for x in samples]
    out = {}
    for p in effect.free:
        values = np.array([by_name.get(p.name, 0.0) for by_name in parameters])
        low, high = np.quantile(values, (0.05, 0.95))
        mean, sd = float(values[0]), float(values.std())
        out[p.name.rpartition(".")[2]] = Estimate(mean, sd, float(low), float(high))
    return out
