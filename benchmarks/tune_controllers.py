"""Gains for the controllers that a policy is compared with, found where it learns.

    python benchmarks/tune_controllers.py [--refine] [--generations 40] [--only pnl] [--seed 0]
        [--pace fast] [--out gains.toml]

That is the twin calibrated to a shipped swim, ``datasets/pool/calibrated.json``.

Differential evolution (Storn and Price, J. Global Optim. 11 (1997) 341) over all gains, gait
included. What it lowers is the time of the 180 degree turn and a sixth of the time of the
pentagram, each with its energy at a price of so many seconds for 1000 rad^2/s^2; three prices give
a fast, a middle and a frugal set. The turn is varied a little in heading, the water's law by 20 %
either way, lest gains fit one swim. ``--refine`` looks around the gains that the file has, which
takes a third of the generations. Scored on starts and waters that the search has not seen, and
on the tasks as they are. Writes ``rl/controllers/tuned.toml``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import torch
from harness import command_line
from rl.experiments.evaluate import run_episodes
from scipy.optimize import differential_evolution
from tqdm import tqdm

import sim2real as s2r
from rl.controllers import Controller
from rl.controllers.classical import (
    PACES,
    TUNED,
    ADRCGains,
    DisturbanceRejection,
    PNLGains,
    ProportionalNavigation,
)
from rl.make import make_world
from rl.metrics import energy
from rl.task import CONTROL_S, TASKS, Task
from rl.world import Draws, World
from sim.inference.swims import with_values
from sim.twin.twin import Coefficients
from sim2real.arrays import Array
from sim2real.model import Model
from sim2real.output import write_whole

Starts = tuple[Array, Array, Array]

ROBOT = s2r.read_robot("datasets/pool/robot.toml")
MODEL = s2r.read_model("datasets/pool/calibrated.json")
LIMITS = np.array([joint.limits_rad for joint in ROBOT.joints])
WATER = Coefficients.of(MODEL.body)

PRICES = dict(zip(PACES, (0.1, 0.4, 1.6), strict=True))
"""Seconds for 1000 rad^2/s^2."""
CORNERS = 9
"""Waypoints of the pentagram in the search: two sides and their corners; all when scored."""
SPREAD = 0.2
NEAR = 0.1
"""Standard deviation of a population about known gains, as a share of their bounds."""
_STROKE = {
    "frequency_hz": (0.4, 3.5),
    "amplitude_rad": (0.2, 1.2),
    "front": (0.0, 1.5),
    "lag_rad": (-0.2, 2.0),
    "bend_rad": (0.2, 0.8),
    "ease": (0.0, 1.0),
}
BOUNDS: dict[type, dict[str, tuple[float, float]]] = {
    PNLGains: {
        **_STROKE,
        "navigation_s": (0.0, 4.0),
        "pursuit": (0.0, 2.0),
        "filter_s": (0.02, 1.0),
    },
    ADRCGains: {
        **_STROKE,
        "navigation": (0.5, 4.0),
        "memory_s": (0.2, 5.0),
        "agility_rad_s2": (0.5, 30.0),
        "bandwidth_rad_s": (0.3, 6.0),
        "observer_rad_s": (2.0, 25.0),
        "effect_per_s2": (0.5, 30.0),
    },
}
KINDS: dict[str, tuple[type, Callable[..., Controller]]] = {
    "pnl": (PNLGains, ProportionalNavigation),
    "adrc": (ADRCGains, DisturbanceRejection),
}


@dataclass(frozen=True)
class Trial:
    """Starts S of one task, each swum by C controllers side by side.

    Attributes:
        world: Of S C robots; all of the first start come first.
        n_starts: S.
    """

    world: World
    n_starts: int


def trial(name: str, n_starts: int, copies: int, seed: int, *, varied: bool) -> Trial:
    """A task with fixed starts; ``varied`` in heading and water, or as it is."""
    rng = np.random.default_rng(seed)
    task = TASKS[name]
    pose, joint, targets = task.place(rng, n_starts, len(LIMITS))
    models = [MODEL] * n_starts
    if varied:
        pose[:, 2] += rng.uniform(-0.3, 0.3, n_starts)
        models = [_other_water(rng) for _ in range(n_starts)]
        if task.waypoints > CORNERS:
            task = replace(task, waypoints=CORNERS, steps=2500)
            targets = targets[:, :CORNERS]
    pose, joint, targets = (np.repeat(x, copies, axis=0) for x in (pose, joint, targets))
    fixed = replace(task, place=_placed(task, (pose, joint, targets)))
    draws = [Draws((model,)) for model in models]
    world = make_world(ROBOT, fixed, draws, n_envs=n_starts * copies, threads=1)
    return Trial(world, n_starts)


def _placed(task: Task, starts: Starts) -> Callable[[np.random.Generator, int, int], Starts]:
    """The starts for all at once; anything for robots that begin a second time."""

    def place(rng: np.random.Generator, n: int, J: int) -> Starts:
        if n == len(starts[0]):
            return starts
        pose, joint, targets = task.place(rng, n, J)
        return pose, joint, targets[:, : task.waypoints]

    return place


def _other_water(rng: np.random.Generator) -> Model:
    scale = 1 + rng.uniform(-SPREAD, SPREAD, 3)
    names = ("across", "along", "linear")
    law = {f"twin.{n}": k * getattr(WATER, n) for n, k in zip(names, scale, strict=True)}
    return with_values(MODEL, law)


def cost(trial: Trial, controller: Controller, price: float) -> Array:
    """Time in s and energy at its price, the mean over the starts, shape (C,).

    A robot that does not arrive is charged the longest time, 10 s for each further waypoint and
    20 s for each metre that it stayed away from its next.
    """
    world, E = trial.world, trial.world.n_envs
    steps = world.task.steps
    time, energy, away = np.full(E, steps * CONTROL_S), np.zeros(E), np.zeros(E)
    running, count = np.ones(E, dtype=bool), np.zeros(E)
    seen = world.reset()
    controller.reset(running)
    for k in range(steps):
        step = world.step(torch.from_numpy(controller.act(seen.numpy())))
        seen = step.observation
        count = np.where(running, step.reached.numpy(), count)
        away = np.where(running, np.linalg.norm(step.final[:, -2:].numpy(), axis=1), away)
        ended = running & (step.terminated | step.truncated).numpy()
        arrived = ended & (count >= world.task.waypoints)
        time[arrived] = (k + 1) * CONTROL_S
        running &= ~ended
        energy += np.where(running, np.square(world.rate.numpy()).sum(axis=1), 0.0)
        if not running.any():
            break
    left = world.task.waypoints - count
    missed = np.where(left > 0, 10 * np.maximum(left - 1, 0) + 20 * away, 0.0)
    total = time + price * energy / 1000 + missed
    return np.asarray(total.reshape(trial.n_starts, -1).mean(axis=0))


def search(
    name: str,
    price: float,
    generations: int,
    seed: int,
    first: dict[str, float] | None,
    known: dict[str, float] | None,
) -> tuple[dict[str, float], float]:
    """The best gains found, and their cost on the starts of the search.

    ``first`` joins in; the population is drawn about ``known``, or anywhere where None.
    """
    kind, build = KINDS[name]
    bounds = BOUNDS[kind]
    box: Any = [*bounds.values()]
    size = 4 * len(bounds)
    rng = np.random.default_rng(seed)
    begin: Any = "latinhypercube" if known is None else _about(known, bounds, size, rng)
    trials = _trials(size, seed)

    def objective(x: Array) -> Any:  # noqa: ANN401 - vectorized: (P, C) in, (C,) out
        turn, star = (_total(t, build, kind, x.T, price) for t in trials)
        return turn + star / 6

    with tqdm(total=generations, desc=f"{name} at {price}", disable=None) as bar:

        def tell(intermediate_result: Any) -> None:  # noqa: ANN401 - SciPy finds it by this name
            bar.set_postfix(cost=f"{intermediate_result.fun:.2f}")
            bar.update()

        found = differential_evolution(
            objective, box, maxiter=generations, popsize=4, tol=0.0,
            mutation=(0.4, 0.9), recombination=0.8, polish=False, vectorized=True, init=begin,
            x0=None if first is None else [*first.values()],
            updating="deferred", rng=rng, callback=tell,
        )  # fmt: skip
    return dict(zip(bounds, map(float, found.x), strict=True)), float(found.fun)


def _about(
    known: dict[str, float],
    bounds: dict[str, tuple[float, float]],
    size: int,
    rng: np.random.Generator,
) -> Array:
    """So many gains about known ones, these the last, shape (size, gains)."""
    low, high = np.array([*bounds.values()]).T
    middle = np.array([known[name] for name in bounds])
    off = rng.normal(0.0, NEAR, (size, low.size)) * (high - low)
    off[-1] = 0.0
    return np.asarray(np.clip(middle + off, low, high))


@cache
def _trials(copies: int, seed: int) -> tuple[Trial, Trial]:
    turn = trial("turn", 4, copies, seed, varied=True)
    return turn, trial("pentagram", 2, copies, seed + 1, varied=True)


def _total(
    trial: Trial, build: Callable[..., Controller], kind: type, gains: Array, price: float
) -> Array:
    every = np.tile(gains, (trial.n_starts, 1))
    columns = dict(zip((one.name for one in fields(kind)), every.T, strict=True))
    return cost(trial, build(LIMITS, len(every), kind(**columns)), price)


def scores(name: str, gains: dict[str, float], seed: int) -> dict[str, float]:
    """On starts and waters not seen by the search, and on the tasks as they are."""
    kind, build = KINDS[name]
    out = {}
    for task in ("turn", "pentagram"):
        for label, varied in (("unseen", True), ("plain", False)):
            one = trial(task, 8 if task == "turn" else 4, 1, seed + 1000, varied=varied)
            swims = run_episodes(one.world, build(LIMITS, one.n_starts, kind(**gains)))
            there = swims.success
            key = f"{task}_{label}"
            out[f"{key}_arrived"] = float(there.mean())
            if there.any():
                out[f"{key}_time_s"] = float(swims.time_s[there].mean())
                out[f"{key}_energy"] = float(energy(swims.rate)[there].mean())
    return out


def main() -> None:
    """Search, score, write."""
    about = (False, "about the gains that there are")
    parser = command_line(__doc__, refine=about, generations=40, out=TUNED, seed=0)
    parser.add_argument("--only", choices=[*KINDS], action="append")
    parser.add_argument("--pace", choices=PACES, action="append")
    options = parser.parse_args()
    torch.set_num_threads(1)
    known = tomllib.loads(TUNED.read_text()) if TUNED.exists() else {}
    for name in options.only or KINDS:
        gains: dict[str, float] | None = None
        for pace in options.pace or PACES:
            price = PRICES[pace]
            about = known[name][pace] if options.refine else None
            gains, fun = search(name, price, options.generations, options.seed, gains, about)
            seen = {"cost": fun, **scores(name, gains, options.seed)}
            known.setdefault(name, {})[pace] = {**gains, "score": seen}
            print(name, pace, {k: round(v, 2) for k, v in seen.items()}, flush=True)
            write_whole(options.out, as_toml(known))


def as_toml(tables: dict[str, Any]) -> str:
    """The file of gains."""
    made = "benchmarks/tune_controllers.py, then tune_in_trials.py; they say what the paces are."
    lines = [f"# Written by {made}"]
    for name, paces in tables.items():
        for pace, table in paces.items():
            lines += ["", f"[{name}.{pace}]"]
            lines += [f"{k} = {v:.5g}" for k, v in table.items() if k != "score"]
            inside = ", ".join(f"{k} = {v:.4g}" for k, v in table["score"].items())
            lines.append(f"score = {{ {inside} }}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
