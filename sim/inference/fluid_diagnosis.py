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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.inference.emulator import ROLLOUTS, Batch, Emulator, rollouts
from sim.inference.fluid_fit import SHARE, Fitted, fit, rmse
from sim.inference.parameters import candidates, servo_parameters, water_parameters
from sim.inference.search import MOST, Effect, EffectSearch, Tried
from sim.inference.swim_findings import findings, named_effect, verdict_of
from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.diagnose.result import Diagnosis, Rival
from sim2real.errors import InputError
from sim2real.inference.parameters import Gaussian, Parameter
from sim2real.inference.selection import Hypothesis, Members, prune
from sim2real.model import Model, read_model
from sim2real.robot import Robot

Array = NDArray[np.float64]

ENOUGH = 5.0
"""Logarithm of the Bayes factor from which an effect is named: very strong evidence (Kass and
Raftery, J. Am. Stat. Assoc. 90 (1995) 773)."""
_NOT_IN_THE_FLUID = ("wall_effect",)


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
    water: Sequence[Parameter],
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
    water: Sequence[Parameter],
    prior: Gaussian,
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
    kept: list[Tried[Fitted]] = []
    by, varied = plain, set(batches[0].plain.names)
    if claimed:

        def refit(members: Members) -> Hypothesis[Fitted]:
            found = tried([one for one in claimed if one in members], base, near)
            return Hypothesis(members, found, found.evidence - ENOUGH * len(members))

        found, adds = prune(refit, frozenset(claimed))
        if adds and found.fit.evidence - base.evidence >= ENOUGH:
            now, by, varied = found.fit, near, set(batches[0].near.names)
            kept = [Tried(one, adds[one] + ENOUGH, now) for one in claimed if one in adds]
    stands = [one.effect for one in kept]
    every = effects_of(robot)
    swum = [one for one in every if not moves(one) or all(p.name in varied for p in one.free)]
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        progress(min(done / (MOST * len(every)), 1.0) * 0.95)

    search = EffectSearch(
        [*stands, *(one for one in swum if one not in stands)],
        lambda some: tried(some, base, by),
        lambda before, after, _: after.evidence - before.evidence,
        ENOUGH,
        tell,
    )
    more, last = search.run(now, stands, MOST - len(stands))
    kept += more
    now = kept[-1].fit if kept else now
    errors = [rmse(swim, simulated(swim, [base.model, now.model], fluid)) ** 2 for swim in swims]
    if not np.isfinite(errors).all():
        raise InputError(swims[0].name, "fluid", "the robot is stopped", "finer cells")
    progress(1.0)
    usual = {p.name: float(m) for p, m in zip(water, prior.mean, strict=True)}
    noise = np.mean([np.broadcast_to(one.noise, one.signals.shape[1]) for one in swims], axis=0)
    return _diagnosis(robot, base, now, kept, last, np.sqrt(np.mean(errors, 0)), noise, usual)


def _believed(
    servos: Sequence[Parameter],
    water: Sequence[Parameter],
    prior: Gaussian,
    effects: Sequence[Effect],
) -> tuple[list[Parameter], Gaussian]:
    """What is fitted with some effects, and its prior; one of the water's gets a wider prior."""
    free = [*servos, *water]
    names = [p.name for p in free]
    more = [p for one in effects for p in one.free if p.name not in names]
    free += more
    own = Gaussian.of(free)
    mean, covariance = own.mean.copy(), own.covariance.copy()
    rows = slice(len(servos), len(servos) + len(water))
    mean[rows], covariance[rows, rows] = prior.mean, prior.covariance
    for one in effects:
        for p in one.free:
            if p.name in names:
                k = names.index(p.name)
                covariance[k, k] += p.prior_sd**2
    return free, Gaussian(mean, covariance)


def _without(model: Model, effects: Sequence[Effect]) -> Model:
    """The model with some effects off."""
    return with_values(model, {one.free[0].name: 0.0 for one in effects})


def _diagnosis(
    robot: Robot,
    base: Fitted,
    now: Fitted,
    kept: Sequence[Tried[Fitted]],
    last: Sequence[Tried[Fitted]],
    errors: Array,
    noise: Array,
    usual: dict[str, float],
) -> Diagnosis:
    train, held = errors
    before, after = (float(np.hypot(*held[e, :2])) for e in (0, 1))
    against = ", against the swim without"
    named = [
        named_effect(
            one, base, now, _probability(one), (before, after), usual=usual, against=against
        )
        for one in kept
    ]
    odds = np.exp([min(one.gain, ENOUGH) - ENOUGH for one in last])
    rivals = [
        Rival(one.effect.name, one.effect.component, float(p / (1 + odds.sum())))
        for one, p in zip(last[:5], odds[:5], strict=False)
    ]
    gate = (
        "In the fluid: its water is that of a swim in which nothing is missing, and its own "
        "error is taken as a share of what moves."
    )
    verdict = verdict_of(kept)
    return findings(robot, verdict, named, rivals, train, held, noise, gate, now.model, base.model)


def _probability(one: Tried[Fitted]) -> float:
    rest = [other.gain - one.gain for other in one.rivals]
    return 1 / (1 + float(np.exp([*rest, -one.gain]).sum()))


def read_water(path: Path, robot: Robot, cell_m: float) -> tuple[list[Parameter], Gaussian]:
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
    return water, Gaussian(np.array(known["mean"], dtype=np.float64)[rows], covariance)


__all__ = [
    "ENOUGH", "Batches", "Effect", "diagnose_in_fluid", "effects_of", "moves", "read_water",
    "swim_batches",
]  # fmt: skip
