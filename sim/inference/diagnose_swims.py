"""Which physics of the body or the camera do swims in a pool show that the twin leaves out?

The search is that of ``sim2real.inference.selection`` on swims as ``twin_search`` has them: every
effect of the catalogue beside servos and law, in which the twin's error is a part of the noise.
What is named has to predict the end of each swim better when fitted to its beginning; what others
can imitate is a group; and where a shape without a name (``unlisted``) does better than all, the
diagnosis abstains. Thresholds are in ``law_error.json``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.calibration.swim_parameters import Candidate
from sim.inference import poses
from sim.inference.coordinates import Swum, swum
from sim.inference.law_error import LAW_ERROR, LawError
from sim.inference.next_swim import next_swim
from sim.inference.searched import HELD_OUT, Searched, learned, names_of, raw, searched
from sim.inference.swim_decision import Decided, decide
from sim.inference.swim_findings import findings
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, TwinSwims
from sim2real.body import body_effect
from sim2real.diagnose.result import Diagnosis, Estimate, Experiment, NamedEffect, Rival
from sim2real.inference.selection import Hypothesis
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.units import readable, readable_name

Array = NDArray[np.float64]

_DRAWN = 400
_REPEATED = 0.005
_ROLLS = 3.0
"""Surge or sway at the beat, in squares of what the twin usually leaves, that no plane explains."""
SHAPES = {
    "wave": "a flow to and fro in the pool's frame, as of waves",
    "gust": "a head that is shaken for a while, as by another swimmer's wake",
    "bend": "poses that follow a joint, as of a marker that is not on the head",
    "mount": "a heading that drifts, as of a camera that turns",
    "change": "a robot that becomes another one on its way",
}
"""What shapes without a name would look like; guesses."""


def diagnose_swims(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: Swum,
    *,
    references: Sequence[Swim] = (),
    known: LawError = LAW_ERROR,
    again: Callable[[Model], tuple[Swum, Model] | None] = lambda found: None,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find what the body's simulator leaves out.

    Args:
        swims: Pool recordings of one robot in one pool.
        model: The servos.
        robot: The robot.
        simulate: The twin (``sim.twin.followed.by_followed_twin``).
        references: Swims of the same robot in which nothing is thought to be missing.
        known: The twin's error and the thresholds.
        again: From what was found to a simulator that is right beside it, and with what it is, to
            search with once more (``in_water.swims_again``).
        progress: Called with the share that is done.

    Returns:
        The diagnosis; its errors are those of the speed over ground, in m/s, on what was held out.
    """
    before = learned(references, model, robot, simulate, known)
    found = searched(swims, model, robot, simulate, before, progress)
    beside = again(likely_model(found, known, referred=bool(references)))
    if beside is not None:
        found = searched(swims, model, robot, beside[0], before, begun=beside[1])
    return diagnosis_of(found, robot, known, referred=bool(references))


def likely_model(found: Searched, known: LawError, *, referred: bool) -> Model:
    """The model with what is likely, whether it is offered or not: the fluid swims again with it.

    Args:
        found: The search.
        known: The twin's error and the thresholds.
        referred: Whether swims in which nothing is missing were known.
    """
    said = decide(raw(found, referred=referred), known.decisions)
    likely = {one.name for one in said.named if one.probability >= known.decisions["likely"]}
    fit = next(h.fit for h in found.found if set(names_of(h.members)) == likely)
    return found.problem.coordinates.model_at(fit.x)


def diagnosis_of(found: Searched, robot: Robot, known: LawError, *, referred: bool) -> Diagnosis:
    """What a search in the twin found, decided and put into words.

    Args:
        found: The search.
        robot: The robot.
        known: The twin's error and the thresholds.
        referred: Whether swims in which nothing is missing were known.
    """
    said = decide(raw(found, referred=referred), known.decisions)
    problem, c = found.problem, found.problem.coordinates
    chosen = next(h for h in found.found if frozenset(names_of(h.members)) == said.offered)
    fitted = next(
        h for h in found.found
        if frozenset(names_of(h.members)) >= {one.name for one in said.named}
    )  # fmt: skip
    both = (found.plain, chosen)
    ahead = [found.held[one.members] for one in both]
    errors = [_errors(problem, one.fit) for one in ahead]
    before, after = (one.speed for one in ahead)
    named = []
    for one in said.named:
        effect = next(e for e in c.effects if (e.name, e.component) == one.name)
        parameters = _estimates(found, fitted, effect, known.decisions["relative"])
        sizes = ", ".join(
            f"{readable_name(name)} {readable(name, x.mean)}" for name, x in parameters.items()
        )
        known_as = body_effect(effect.name)
        where = f" ({effect.component})" if known_as.by_material else ""
        others = ", ".join(f"{name} ({of})" for name, of in one.group[1:])
        or_else = f" These swims do not distinguish it from {others}." if others else ""
        title = f"{known_as.title[0].upper()}{known_as.title[1:]}"
        named.append(
            NamedEffect(
                effect=effect.name,
                component=effect.component,
                probability=one.probability,
                group=tuple(dict.fromkeys(name for name, _ in one.group)),
                parameters=parameters,
                heldout={
                    "rmse_before": before, "rmse_after": after, "recoverable_removed": None,
                },
                baseline_shift={
                    c.columns[k].name: float(chosen.fit.x[k] - found.plain.fit.x[k])
                    for k in c.base
                },
                stability=1.0,
                statement=f"{title}{where}: {sizes}.{or_else}",
            )
        )  # fmt: skip
    rivals = [Rival(name, of, p) for (name, of), p in said.rivals[:5]]
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
    likely = known.decisions["likely"]
    if said.unlisted >= likely:
        gate.append(
            f"An effect is likely that the catalogue lacks: {SHAPES[said.shape.split()[0]]}."
        )
    moved, turn = float(found.misfit[:2, 1].max()), float(found.misfit[2, 1])
    if said.unlisted >= likely and moved > _ROLLS and moved > 1.5 * turn:
        gate.append(
            f"The residual is mainly the head's sideways motion at the tail beat ({moved:.0f} "
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
    plain_model, model = (c.model_at(one.fit.x) for one in both)
    made = findings(
        robot, said.verdict, named, rivals, train, held, noise, gate[0], model, plain_model
    )
    return replace(
        made,
        gate=tuple(gate),
        unknown={"body": said.unlisted},
        next_experiment=_experiment(found, fitted, said, likely),
    )


def _experiment(
    found: Searched, fitted: Hypothesis[Fit], said: Decided, likely: float
) -> Experiment | None:
    """What to record next, where the first group that is likely has several members."""
    for one in said.named:
        if one.probability >= likely and len(one.group) > 1:
            rest = frozenset(names_of(fitted.members)) - {one.name}
            instead = rest | {one.group[1]}
            for other in found.found:
                if frozenset(names_of(other.members)) == instead:
                    names = (one.name[0], one.group[1][0])
                    return next_swim(found.problem, fitted.fit, other.fit, names)
    return None


def _errors(problem: TwinSwims, fit: Fit) -> tuple[Array, Array]:
    """Errors of each signal in the first part of the swims and the last."""
    parts: tuple[list[Array], list[Array]] = ([], [])
    for swim in problem.swims:
        (said,) = swum(problem.coordinates, swim, fit.x[None], problem.simulate)
        cut = round(swim.t.size * (1 - HELD_OUT))
        error = said - swim.signals
        parts[0].append(error[:cut])
        parts[1].append(error[cut:])
    train, held = (np.sqrt(np.nanmean(np.concatenate(p) ** 2, axis=0)) for p in parts)
    return train, held


def _estimates(
    found: Searched, chosen: Hypothesis[Fit], effect: Candidate, relative: float
) -> dict[str, Estimate]:
    """What the fit says of an effect, by draws: its parameters bend with its coordinates.

    ``relative``: what the twin is wrong of an effect's size, of that size (one sd).
    """
    problem, c = found.problem, found.problem.coordinates
    own = c.of_effect(effect)
    spread = problem.covariance(chosen.members, chosen.fit.near)[np.ix_(own, own)]
    spread = spread + np.diag(np.square(problem.prior.imitation[own]))
    spread = spread + np.diag(np.square(relative * chosen.fit.x[own]))
    rng = np.random.default_rng(0)
    drawn = np.tile(chosen.fit.x, (_DRAWN, 1))
    drawn[:, own] = rng.multivariate_normal(chosen.fit.x[own], spread, _DRAWN)
    drawn = c.clipped(drawn)
    drawn[0] = chosen.fit.x
    told = [c.parameters(x) for x in drawn]
    out = {}
    for p in effect.free:
        values = np.array([one.get(p.name, 0.0) for one in told])
        low, high = np.quantile(values, (0.05, 0.95))
        mean, sd = float(values[0]), float(values.std())
        out[p.name.rpartition(".")[2]] = Estimate(mean, sd, float(low), float(high))
    return out
