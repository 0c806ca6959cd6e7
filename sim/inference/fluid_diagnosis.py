"""What do swims show that the fluid leaves out? ``diagnose_swims``, in the fluid.

Two things make it possible. An emulator (``emulator``) stands for the fluid, so that every
effect of the catalogue is tried in a second. And the water is that of a swim in which nothing is
missing: what cells of a centimetre get wrong of drag and of the water that goes along was found
there (``fluid_calibration``), with its covariance, and is the prior here. A surface that is
rougher now than it was then is the same parameter with a wider prior.

An effect is named for the evidence that it adds, from ``ENOUGH`` on. What the twin named and what
moves the robot far from where it would be, a skin or a tether, the batch swims with from the start;
its evidence is against a second batch that swims without.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.inference.calibrate import Free, servo_parameters
from sim.inference.diagnose_swims import MOST, candidates
from sim.inference.emulator import ROLLOUTS, Batch, Emulator, rollouts
from sim.inference.fluid_calibration import water_parameters
from sim.inference.fluid_fit import SHARE, Fitted, Prior, fit, rmse
from sim.inference.swim_findings import findings
from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.body import body_effect
from sim2real.diagnose.result import Diagnosis, Estimate, NamedEffect, Rival, Verdict
from sim2real.errors import InputError
from sim2real.model import Model, read_model
from sim2real.robot import Robot

Array = NDArray[np.float64]

ENOUGH = 5.0
"""Logarithm of the Bayes factor from which an effect is named: very strong evidence (Kass and
Raftery, J. Am. Stat. Assoc. 90 (1995) 773)."""
_ALIKE = 1.0
"""Difference in it below which two effects cannot be told apart."""
_Z90 = 1.645
_NOT_IN_THE_FLUID = ("wall_effect",)


@dataclass(frozen=True)
class Effect:
    """An effect that may be missing.

    Attributes:
        name: Its identifier.
        component: The material it belongs to, or ``body`` or ``camera``.
        free: Its parameters.
    """

    name: str
    component: str
    free: tuple[Free, ...]


@dataclass(frozen=True)
class Tried:
    """An effect with the evidence that it adds, and the fit with it."""

    effect: Effect
    gain: float
    fit: Fitted
    rivals: tuple[Tried, ...] = ()


@dataclass(frozen=True)
class Batches:
    """Rollouts of one swim: about the model that the search begins with, and without effects.

    Attributes:
        near: About the model with what is claimed.
        plain: About the model without; the same where nothing is claimed.
    """

    near: Batch
    plain: Batch


def effects_of(robot: Robot) -> list[Effect]:
    """What may be missing and the fluid can show."""
    return [Effect(*one) for one in candidates(robot) if one[0] not in _NOT_IN_THE_FLUID]


def moves(effect: Effect) -> bool:
    """Whether a batch must swim with it: the camera's effects are applied to what was swum."""
    return effect.component != "camera"


def swim_batches(
    swim: Swim,
    model: Model,
    robot: Robot,
    fluid: Simulator,
    water: Sequence[Free],
    claimed: Sequence[Effect],
    *,
    count: int = ROLLOUTS,
    seed: int = 0,
) -> Batches:
    """The rollouts that a diagnosis rests on.

    Args:
        swim: The recording.
        model: Servos, calibrated water, and what is claimed at the sizes that the twin found.
        robot: The robot.
        fluid: The fluid.
        water: Its calibrated parameters.
        claimed: What the twin named and the batch swims with.
        count: Rollouts of a batch.
        seed: Of the designs.
    """
    base = [*servo_parameters(model, robot, gains=True), *water]
    body = [p for one in effects_of(robot) if one.component != "camera" for p in one.free]
    known = {p.name for p in base}
    free = [*base, *(p for p in body if p.name not in known)]
    near = rollouts(fluid, swim, model, free, count=count, seed=seed)
    if not claimed:
        return Batches(near, near)
    plain = _without(model, claimed)
    return Batches(near, rollouts(fluid, swim, plain, base, count=(2 * count) // 3, seed=seed))


def diagnose_in_fluid(
    batches: Sequence[Batches],
    model: Model,
    robot: Robot,
    fluid: Simulator,
    water: Sequence[Free],
    prior: Prior,
    claimed: Sequence[Effect],
    *,
    share: float = SHARE,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find what the fluid leaves out of swims.

    Args:
        batches: Of ``swim_batches``, one for each swim.
        model: As there.
        robot: The robot.
        fluid: The fluid; it swims what is found once more, and these are the errors that are told.
        water: Its calibrated parameters.
        prior: Of these, from a swim in which nothing is missing.
        claimed: As there.
        share: Error of the fluid as a share of a signal's size.
        progress: Called with the share that is done.

    Returns:
        The diagnosis; its errors are those of the speed over ground, in m/s, on what was held out.

    Raises:
        InputError: If the fluid stops the robot.
    """
    swims = [one.near.swim for one in batches]
    near, plain = (Emulator([getattr(b, one) for b in batches]) for one in ("near", "plain"))
    servos = servo_parameters(model, robot, gains=True)

    def tried(with_: Sequence[Effect], like: Fitted | None, by: Simulator) -> Fitted:
        free, belief = _believed(servos, water, prior, with_)
        begin = _without(model, [one for one in claimed if one not in with_])
        weights = like.weights if like else None
        return fit(swims, begin, free, by, prior=belief, share=share, weights=weights)

    base = now = tried((), None, plain)
    kept: list[Tried] = []
    held: list[Effect] = []
    by, varied = plain, set(batches[0].plain.names)
    if claimed:
        stands, gains, found = _standing(claimed, lambda with_: tried(with_, base, near))
        if stands and found.evidence - base.evidence >= ENOUGH:
            now, held, by, varied = found, stands, near, set(batches[0].near.names)
            kept = [Tried(one, gain, now) for one, gain in zip(stands, gains, strict=True)]
    ranked: list[Tried] = []
    every = effects_of(robot)
    while len(kept) < MOST:
        ranked = []
        for k, effect in enumerate(every):
            progress((len(kept) + k / len(every)) / MOST * 0.95)
            swum = not moves(effect) or all(p.name in varied for p in effect.free)
            if effect not in held and swum:
                found = tried([*held, effect], base, by)
                ranked.append(Tried(effect, found.evidence - now.evidence, found))
        ranked.sort(key=lambda one: -one.gain)
        if ranked[0].gain < ENOUGH:
            break
        best = replace(ranked[0], rivals=tuple(ranked[1:]))
        kept, held, now = [*kept, best], [*held, best.effect], best.fit
    errors = [rmse(swim, simulated(swim, [base.model, now.model], fluid)) ** 2 for swim in swims]
    if not np.isfinite(errors).all():
        raise InputError(swims[0].name, "fluid", "the robot is stopped", "finer cells")
    progress(1.0)
    usual = {p.name: float(m) for p, m in zip(water, prior.mean, strict=True)}
    noise = np.mean([np.broadcast_to(one.noise, one.signals.shape[1]) for one in swims], axis=0)
    return _diagnosis(robot, base, now, kept, ranked, np.sqrt(np.mean(errors, 0)), noise, usual)


def _standing(
    claimed: Sequence[Effect], tried: Callable[[Sequence[Effect]], Fitted]
) -> tuple[list[Effect], list[float], Fitted]:
    """Claims without which the others explain less, what each adds to them, and their fit."""
    stands, found = list(claimed), tried(claimed)
    while stands:
        others = [tried([other for other in stands if other is not one]) for one in stands]
        gains = [found.evidence - fitted.evidence for fitted in others]
        weakest = int(np.argmin(gains))
        if gains[weakest] >= ENOUGH:
            return stands, gains, found
        found = others[weakest]
        del stands[weakest]
    return [], [], found


def _believed(
    servos: Sequence[Free], water: Sequence[Free], prior: Prior, effects: Sequence[Effect]
) -> tuple[list[Free], Prior]:
    """What is fitted with some effects, and its prior; one of the water's gets a wider prior."""
    free = [*servos, *water]
    names = [p.name for p in free]
    more = [p for one in effects for p in one.free if p.name not in names]
    free += more
    own = Prior.of(free)
    mean, covariance = own.mean.copy(), own.covariance.copy()
    rows = slice(len(servos), len(servos) + len(water))
    mean[rows], covariance[rows, rows] = prior.mean, prior.covariance
    for one in effects:
        for p in one.free:
            if p.name in names:
                k = names.index(p.name)
                covariance[k, k] += p.prior_sd**2
    return free, Prior(mean, covariance)


def _without(model: Model, effects: Sequence[Effect]) -> Model:
    """The model with some effects off."""
    return with_values(model, {one.free[0].name: 0.0 for one in effects})


def _diagnosis(
    robot: Robot,
    base: Fitted,
    now: Fitted,
    kept: Sequence[Tried],
    ranked: Sequence[Tried],
    errors: Array,
    noise: Array,
    usual: dict[str, float],
) -> Diagnosis:
    train, held = errors
    before, after = (float(np.hypot(*held[e, :2])) for e in (0, 1))
    named = [_named(one, base, now, usual, (before, after)) for one in kept]
    chosen = [one.effect for one in kept]
    rest = [one for one in ranked if one.effect not in chosen]
    odds = np.exp([min(one.gain, ENOUGH) - ENOUGH for one in rest])
    rivals = [
        Rival(one.effect.name, one.effect.component, float(p / (1 + odds.sum())))
        for one, p in zip(rest[:5], odds[:5], strict=False)
    ]
    alike = any(_alike(one) for one in kept)
    verdict: Verdict = "consistent" if not named else "ambiguous" if alike else "explained"
    gate = (
        "In the fluid: its water is that of a swim in which nothing is missing, and its own "
        "error is taken as a share of what moves."
    )
    return findings(robot, verdict, named, rivals, train, held, noise, gate, now.model, base.model)


def _alike(one: Tried) -> list[Tried]:
    """Effects that the swims cannot tell from this one."""
    return [other for other in one.rivals if one.gain - other.gain < _ALIKE]


def _named(
    one: Tried, base: Fitted, now: Fitted, usual: dict[str, float], errors: tuple[float, float]
) -> NamedEffect:
    names = [p.name for p in now.free]
    parameters, told = {}, []
    for p in one.effect.free:
        k = names.index(p.name)
        mean, sd = float(now.best[k]) - usual.get(p.name, 0.0), float(now.sd[k])
        short = p.name.rpartition(".")[2]
        parameters[short] = Estimate(mean, sd, mean - _Z90 * sd, mean + _Z90 * sd)
        told.append(f"{short} {mean:.3g}")
    alike = _alike(one)
    rest = [other.gain - one.gain for other in one.rivals] or [-np.inf]
    others = [f"{other.effect.name} ({other.effect.component})" for other in alike]
    or_else = f" Or, as likely: {', '.join(others)}." if others else ""
    listed = [p.name for p in base.free]
    title = body_effect(one.effect.name).title
    where = ""
    if body_effect(one.effect.name).by_material:
        where = f" ({one.effect.component}, against the swim without)"
    return NamedEffect(
        effect=one.effect.name,
        component=one.effect.component,
        probability=min(1 / (1 + float(np.exp([*rest, -one.gain]).sum())), 0.99),
        group=tuple(dict.fromkeys([one.effect.name, *(other.effect.name for other in alike)])),
        parameters=parameters,
        heldout={
            "rmse_before": errors[0], "rmse_after": errors[1], "recoverable_removed": None,
        },
        baseline_shift={
            name: float(now.best[names.index(name)] - base.best[k])
            for k, name in enumerate(listed)
        },
        stability=1.0,
        statement=f"{title[0].upper()}{title[1:]}{where}: {', '.join(told)}.{or_else}",
    )  # fmt: skip


def read_water(path: Path, robot: Robot, cell_m: float) -> tuple[list[Free], Prior]:
    """The water's parameters and what ``sim2real calibrate --fluid`` found of them.

    Raises:
        InputError: If the file is no model of such a calibration, in cells of this size.
    """
    known = read_model(path).body.get("posterior", {})
    water = water_parameters(robot, cell_m)
    names = list(known.get("names", ()))
    for p in water:
        if p.name not in names:
            expected = f"{p.name}, as calibrate --fluid finds it"
            raise InputError(path, "body.posterior", ", ".join(names) or "none", expected)
    if abs(known["cell_m"] - cell_m) > 1e-9:
        expected = f"{cell_m:g} m, of this diagnosis"
        raise InputError(path, "body.posterior.cell_m", f"{known['cell_m']:g} m", expected)
    rows = [names.index(p.name) for p in water]
    covariance = np.array(known["covariance"], dtype=np.float64)[np.ix_(rows, rows)]
    return water, Prior(np.array(known["mean"], dtype=np.float64)[rows], covariance)


__all__ = [
    "ENOUGH", "Batches", "Effect", "diagnose_in_fluid", "effects_of", "moves", "read_water",
    "swim_batches",
]  # fmt: skip
