"""Diagnosis of swims in a pool: which effects of the body or the camera does the twin leave out?

An effect is reported if it predicts the end of each swim better when fitted to the beginning.
Thresholds are in ``law_error.json``.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from sim.inference.coordinates import SERVOS, Coordinates, Name, Names, signals_at
from sim.inference.in_water import resimulated, robot_in_water, water_of
from sim.inference.law_error import IN_WATER, LAW_ERROR, LawError, learned, read_law_error
from sim.inference.located import located, residuals, windows_of
from sim.inference.searched import HELD_OUT, Searched, searched
from sim.inference.swim_decision import Decided, Named, Numbers, decide
from sim.inference.swim_problem import Fit, SwimProblem
from sim.inference.swims import FLUID_THREADS, Swim, SwimSimulator, signals_of_robot, swim_of
from sim.inference.unlisted import SHAPES
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array
from sim2real.body import body_effect, material_note
from sim2real.diagnose.result import (
    Diagnosis,
    Estimate,
    Experiment,
    Mismatch,
    NamedEffect,
    Rival,
    to_design,
)
from sim2real.diagnose.rival_sets import SwimRivals, SwimSet, design_of, separations
from sim2real.effects import named
from sim2real.inference.selection import Hypothesis
from sim2real.model import Model
from sim2real.output import provenance
from sim2real.progress import Progress, progress_bar
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.units import readable, readable_name


def diagnose_recorded_swims(
    recordings: Sequence[Recording],
    model: Model,
    robot: Robot,
    *,
    references: Sequence[Recording] = (),
    in_water: Path | None = None,
    device: str = "cpu",
) -> Diagnosis:
    """Diagnose swims in the twin or, with a file ``in_water``, relative to the fluid.

    The file is made where there is none; on a GPU the fluid simulates what was found once more.
    """
    swims, earlier = ([swim_of(one, robot) for one in some] for some in (recordings, references))
    law_error, again = LAW_ERROR, None
    if in_water is not None:
        water = water_of(in_water, robot, model, [*swims, *earlier], device)
        law_error = read_law_error(IN_WATER)
        if device != "cpu":
            given = robot, water.of(model), swims, water
            again = partial(resimulated, *given, device=device, threads=FLUID_THREADS)
    start, simulate = robot_in_water(robot, model, [in_water] if in_water else [])
    with progress_bar("diagnose") as progress:
        diagnosis = diagnose_swims(
            swims, start, robot, simulate, references=earlier, law_error=law_error,
            resimulate=again, progress=progress,
        )  # fmt: skip
    # what designed recordings were expected to tell, and what they showed
    rivals = diagnosis.swim_rivals
    assert rivals is not None
    found = {one.effects: one.probability for one in rivals.sets}
    told = separations(rivals.component, design_of(recordings, rivals.component), found)
    # the search draws nothing at random, so that there is no seed
    origin = provenance([*recordings, *references, in_water, robot, model], None)
    return replace(diagnosis, separations=told, provenance=origin)


def diagnose_swims(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    *,
    references: Sequence[Swim] = (),
    law_error: LawError = LAW_ERROR,
    resimulate: Callable[[Model], tuple[SwimSimulator, Model] | None] | None = None,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Find the effects of body and camera that the simulator leaves out of swims in one pool.

    In ``references`` of the same robot nothing is known to be missing. ``resimulate`` leads from
    the likely model of the first search to a simulator for a second one and the model that it is
    exact for, or None. Errors of the diagnosis are held-out errors of the speed over ground, m/s.
    """
    prior = learned(references, model, robot, simulate, law_error)
    problem = SwimProblem(Coordinates.of(robot, model), swims, simulate, prior)
    result = searched(problem, progress, referred=bool(references))
    if again := resimulate and resimulate(likely_model(result, law_error)):
        exact, simulated = again
        problem = replace(problem, simulate=exact)
        result = searched(problem, simulated=simulated, referred=bool(references))
    return diagnosis_of(result, robot, law_error)


def likely_model(result: Searched, law_error: LawError) -> Model:
    """The fitted model with the likely effects."""
    numbers = law_error.decisions
    named = decide(result.raw, numbers).named
    likely = frozenset(effect.name for effect in named if effect.probability >= numbers["likely"])
    return result.problem.coordinates.model_at(result.found[likely].fit.x)


def diagnosis_of(result: Searched, robot: Robot, law_error: LawError) -> Diagnosis:
    """The diagnosis from a search."""
    numbers = law_error.decisions
    decided = decide(result.raw, numbers)
    c, plain, chosen = result.problem.coordinates, result.plain, result.found[decided.offered]
    names, likely = list(signals_of_robot(robot)), numbers["likely"]
    before, after = (_errors(result, one.members) for one in (plain, chosen))
    baseline, enriched = (
        {n: {"train": a, "heldout": b} for n, a, b in zip(names, *both.tolist(), strict=True)}
        for both in (before, after)
    )
    mismatch, advice = _mismatch(result, names, before[1], after[1])
    unclear = decided.verdict in ("unexplained", "partly_explained")
    return Diagnosis(
        verdict=decided.verdict,
        mismatch=() if decided.verdict == "consistent" else mismatch,
        effects=tuple(
            _named(result, decided, entry, chosen, numbers["relative"]) for entry in decided.named
        ),
        rivals=tuple(Rival(name, of, p) for (name, of), p in decided.rivals[:5]),
        unknown={"body": decided.unlisted},
        baseline_fit=baseline,
        enriched_fit=enriched,
        model=c.model_at(chosen.fit.x),
        baseline=c.model_at(plain.fit.x),
        next_experiment=to_design(
            ("body", [name for name, _ in entry.group])
            for entry in decided.named
            if entry.probability >= likely
        )
        or (Experiment("body", (), advice, "none", None, None, advice) if unclear else None),
        gate=tuple(_remarks(result, decided, likely)),
        swim_rivals=_rival_sets(result, decided.sets, numbers),
    )


def _mismatch(
    result: Searched, names: Sequence[str], before: Array, after: Array
) -> tuple[tuple[Mismatch, ...], str]:
    """Signals with much of the residual, or improved, the one with most first; what to record."""
    problem, swims = result.problem, result.problem.swims
    noise = np.mean([swim.noise_sd for swim in swims], axis=0)
    unseen = problem.rows(result.held[frozenset()].fit.x[None])[0]
    ends = [one[round((1 - HELD_OUT) * len(one)) :] for one in residuals(problem, unseen)]
    share = np.sum(np.concatenate(ends) ** 2, axis=0)
    share /= max(float(share.sum()), 1e-30)
    least = min(1.5 / share.size, float(share.max()))  # 1.5 times that of an average signal
    residual = residuals(problem, result.plain.fit.rows)
    square = np.concatenate(residual) ** 2
    out, told = [], []
    for k in np.argsort(-share).tolist():
        if share[k] >= least or after[k] < 0.8 * before[k]:
            where, advice = located(swims, square[:, k], k)
            where = f"{100 * share[k]:.0f} % of the residual of all signals, {where}"
            windows_s = windows_of(swims, [one[:, k] for one in residual])
            component, _, signal = names[k].partition(".")
            errors = float(before[k]), float(noise[k])
            out.append(Mismatch(names[k], component, *errors, float(share[k]), windows_s, where))
            told.append(f"{advice}, for the {readable_name(signal)}.")
    return tuple(out), told[0]


def _errors(result: Searched, members: Names) -> Array:
    """Held-out fit's root mean square errors in the first and last part of swims, (2, 3 + J)."""
    problem, x, squares = result.problem, result.held[members].fit.x, []
    for swim in problem.swims:
        (signals,) = signals_at(problem.coordinates, swim, x[None], problem.simulate)
        cut = round(swim.t.size * (1 - HELD_OUT))
        squares.append(np.split((signals - swim.signals) ** 2, [cut]))
    parts = (np.concatenate(part) for part in zip(*squares, strict=True))
    return np.sqrt([np.nanmean(part, axis=0) for part in parts])


def _named(
    result: Searched, decided: Decided, entry: Named, chosen: Hypothesis[Fit], relative: float
) -> NamedEffect:
    """A reported effect with its estimates, which are those of all reported effects together."""
    effect, component = entry.name
    parameters = _estimates(result, decided, entry.name, relative)
    sizes = ", ".join(
        f"{readable_name(name)} {readable(name, x.mean)}" for name, x in parameters.items()
    )
    others = ", ".join(f"{name} ({of})" for name, of in entry.group[1:])
    or_else = f" These swims do not distinguish it from {others}." if others else ""
    if component == SERVOS:
        title = f"{named(effect).plain} in the servos"
    else:
        title = body_effect(effect).title + material_note(effect, component)
    c, plain = result.problem.coordinates, result.plain
    before, after = (result.held[one.members].speed for one in (plain, chosen))
    return NamedEffect(
        effect=effect,
        component=component,
        probability=entry.probability,
        group=tuple(dict.fromkeys(name for name, _ in entry.group)),
        parameters=parameters,
        heldout={"rmse_before": before, "rmse_after": after, "recoverable_removed": None},
        baseline_shift={c.columns[k].name: float(chosen.fit.x[k] - plain.fit.x[k]) for k in c.base},
        statement=f"{title[0].upper()}{title[1:]}: {sizes}.{or_else}",
    )


def _estimates(
    result: Searched, decided: Decided, name: Name, relative: float
) -> dict[str, Estimate]:
    """Estimates of an effect's parameters, sampled, with a ``relative`` error of its size."""
    all_names = {named.name for named in decided.named}
    fitted = next(h for h in result.found.values() if all_names.issubset(h.members))
    problem, c, x = result.problem, result.problem.coordinates, fitted.fit.x
    own = c.effects[name]
    covariance = problem.covariance(fitted.members, fitted.fit)[np.ix_(own, own)]
    covariance += np.diag(problem.prior.imitation[own] ** 2 + (relative * x[own]) ** 2)
    points = np.tile(x, (400, 1))
    points[:, own] = np.random.default_rng(0).multivariate_normal(x[own], covariance, len(points))
    points[0] = x
    drawn = [c.parameters(point) for point in c.clipped(points)]
    out = {}
    for full in (c.columns[k].name for k in own):
        values = np.array([parameters.get(full, 0.0) for parameters in drawn])
        ends = np.quantile(values, (0.05, 0.95)).tolist()
        of_joint = f"{full.partition('.')[0]}." if name[1] == SERVOS else ""
        shown = of_joint + full.rpartition(".")[2]
        out[shown] = Estimate(float(values[0]), float(values.std()), *ends)
    return out


def _remarks(result: Searched, decided: Decided, likely: float) -> Iterator[str]:
    """Sentences on the simulator, the references, what is unlisted, and the camera."""
    water = "water" in result.problem.coordinates.model.body
    corrected = ", corrected by simulations in the fluid" if water else ""
    yield (
        f"The swims were simulated in the reduced-order twin{corrected}; the error of the twin "
        "counts as noise (reports/pool_diagnosis)."
    )
    if not result.raw["referred"]:
        yield (
            "There are no reference swims in which nothing is missing. Drag, friction and added "
            "mass that this robot always has, and errors of the twin for its shape, cannot be "
            "distinguished from missing effects."
        )
    if decided.unlisted >= likely:
        cause = SHAPES[decided.shape.split()[0]]
        yield f"An effect is likely that the catalogue lacks: {cause}."
    surge, sway, turn = (row[1] for row in result.raw["misfit"][:3])
    sideways = max(surge, sway)
    if decided.unlisted >= likely and sideways > 3.0 and sideways > 1.5 * turn:
        yield (
            f"The residual is mainly the head's sideways motion at the tail beat ({sideways:.0f} "
            f"times the usual one), more than its turning ({turn:.0f}). A body that rolls or "
            "heaves looks like this to an overhead camera; a planar model cannot follow it."
        )
    lost = result.raw["repeated"]
    if lost > 0.005:
        yield f"{100 * lost:.0f} % of the poses equal the one before: the camera lost frames."


def _rival_sets(
    result: Searched, probability: Mapping[Names, float], numbers: Numbers
) -> SwimRivals:
    """The most probable sets, and those with an effect that no earlier one has; at most ten."""
    problem, c, prior = result.problem, result.problem.coordinates, result.problem.prior
    noises = [swim.pose_noise for swim in problem.swims]
    ranked = sorted(probability, key=lambda names: -probability[names])
    chosen = [names for names in ranked if probability[names] > 0.02][:10]
    for names in ranked:
        if len(chosen) < 10 and not frozenset().union(*chosen).issuperset(names):
            chosen.append(names)
    total = sum(probability[names] for names in chosen)

    def open_set(names: Names) -> SwimSet:
        """A set with its parameters and their precision."""
        fit, free = result.found[names].fit, np.flatnonzero(c.in_fit(names))
        covariance = problem.covariance(names, fit)[np.ix_(free, free)]
        titles = (
            effect if component in ("body", "camera", SERVOS) else f"{effect}.{component}"
            for effect, component in sorted(names)
        )
        found = {c.columns[k].name: float(fit.x[k]) for k in free}
        share = float(probability[names] / total)
        return SwimSet(tuple(titles), share, found, np.asarray(np.linalg.inv(covariance)))

    return SwimRivals(
        component="body",
        period_s=CONTROL_S,
        pose_sd=np.mean([noise.sd for noise in noises], axis=0),
        pose_lag_s=noises[0].lag_s,
        joint_sd_rad=np.mean([swim.noise_sd[3:] for swim in problem.swims], axis=0),
        shares=prior.shares,
        imitation={c.name: sd for c, sd in zip(c.columns, prior.imitation.tolist(), strict=True)},
        relative=numbers["relative"],
        temperature=numbers["temperature"],
        sets=tuple(open_set(names) for names in chosen),
    )
