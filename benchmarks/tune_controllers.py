"""Gains for the controllers that a policy is compared with, found where it learns.

    python -m benchmarks.tune_controllers search --out first.toml [--refine] [--only pnl]
    python -m benchmarks.tune_controllers trials --first first.toml --out rl/controllers/tuned.toml
    python -m benchmarks.tune_controllers trials --fidelity fluid --device cuda:0 --out gains.toml

``search`` is in the twin calibrated to a shipped swim, ``datasets/pool/calibrated.json``, by
differential evolution (Storn and Price, J. Global Optim. 11 (1997) 341) over all gains, gait
included. What it lowers is the time of the 180 degree turn and a sixth of the time of the
pentagram, each with its energy at a price of so many seconds for 1000 rad^2/s^2; three prices give
a fast, a middle and a frugal set. The turn is varied a little in heading, the water's law by 20 %
either way, lest gains fit one swim. ``--refine`` looks around the gains that the file has, which
takes a third of the generations.

``trials`` goes on from there by the cross-entropy method (Rubinstein and Kroese, 2004): each round
draws gains about the best so far, for two controllers at three prices, all in one batch. A trial is
the turn and two corners of a pentagram after it, with latencies and noise drawn from the ranges,
which ``search`` does without: what that finds suffers from them. Rounds have trials of their own.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import differential_evolution
from tqdm import tqdm

import sim2real as s2r
from benchmarks.harness import ROOT, command_line
from rl.controllers import Controller
from rl.controllers.classical import (
    PACES,
    TUNED,
    ADRCGains,
    DisturbanceRejection,
    PNLGains,
    ProportionalNavigation,
)
from rl.experiments.episodes import Episodes, measured
from rl.experiments.testbeds import Controllers, SimulationSettings, simulate
from rl.make import draws_of, make_world
from rl.task import CONTROL_S, TASKS, Starts, Task
from rl.world import Draws, World
from sim.inference.swims import with_values
from sim.twin.law import Coefficients
from sim2real.arrays import Array
from sim2real.model import Model
from sim2real.output import write_whole
from sim2real.ranges.entry import read_ranges

Table = dict[str, float]

POOL = ROOT / "datasets" / "pool"
ROBOT = s2r.read_robot(POOL / "robot.toml")
MODEL = s2r.read_model(POOL / "calibrated.json")
LIMITS = np.array([joint.limits_rad for joint in ROBOT.joints])
WATER = Coefficients.of(MODEL.body)

PRICES = dict(zip(PACES, (0.1, 0.4, 1.6), strict=True))
"""Seconds for 1000 rad^2/s^2."""
CORNERS = 9
"""Waypoints of the pentagram in the search: two sides and their corners."""
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
    """Placed S of one task, each swum by C controllers side by side.

    Attributes:
        world: Of S C robots; all of the first start come first.
        n_starts: S.
    """

    world: World
    n_starts: int


def trial(name: str, n_starts: int, copies: int, seed: int) -> Trial:
    """A task with fixed starts, varied in heading and water."""
    rng = np.random.default_rng(seed)
    task = TASKS[name]
    pose, joint, targets = task.place(rng, n_starts, len(LIMITS))
    pose[:, 2] += rng.uniform(-0.3, 0.3, n_starts)
    models = [_other_water(rng) for _ in range(n_starts)]
    if task.waypoints > CORNERS:
        task = replace(task, waypoints=CORNERS, steps=2500)
        targets = targets[:, :CORNERS]
    pose, joint, targets = (np.repeat(x, copies, axis=0) for x in (pose, joint, targets))
    fixed = replace(task, place=_placed(task, Starts(pose, joint, targets)))
    draws = [Draws((model,)) for model in models]
    world = make_world(ROBOT, fixed, draws, n_envs=n_starts * copies, threads=1)
    return Trial(world, n_starts)


def _placed(task: Task, starts: Starts) -> Callable[[np.random.Generator, int, int], Starts]:
    """The starts for all at once; anything for robots that begin a second time."""

    def place(rng: np.random.Generator, n: int, J: int) -> Starts:
        if n == len(starts.pose):
            return starts
        drawn = task.place(rng, n, J)
        return drawn._replace(targets=drawn.targets[:, : task.waypoints])

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
    controller.reset()
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
    first: Table | None,
    known: Table | None,
) -> tuple[Table, float]:
    """The best gains found, and their cost on the starts of the search.

    ``first`` joins in; the population is drawn about ``known``, or anywhere where None.
    """
    bounds = BOUNDS[KINDS[name][0]]
    box: Any = [*bounds.values()]
    size = 4 * len(bounds)
    rng = np.random.default_rng(seed)
    begin: Any = "latinhypercube" if known is None else _about(known, bounds, size, rng)
    trials = _trials(size, seed)

    def objective(x: Array) -> Any:  # noqa: ANN401 - vectorized: (P, C) in, (C,) out
        turn, star = (cost(t, built(name, np.tile(x.T, (t.n_starts, 1))), price) for t in trials)
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
    known: Table,
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
    turn = trial("turn", 4, copies, seed)
    return turn, trial("pentagram", 2, copies, seed + 1)


def built(name: str, gains: Array) -> Controller:
    """The controller of E robots, each with a row of gains (E, G)."""
    kind, build = KINDS[name]
    columns = dict(zip((one.name for one in fields(kind)), gains.T, strict=True))
    return build(LIMITS, kind(**columns))


def searched(options: argparse.Namespace) -> None:
    """Search in the twin and write."""
    known: dict[str, Any] = tomllib.loads(TUNED.read_text()) if TUNED.exists() else {}
    for name in options.only or KINDS:
        gains: Table | None = None
        for pace in options.pace or PACES:
            price = PRICES[pace]
            about = known[name][pace] if options.refine else None
            gains, cost = search(name, price, options.generations, options.seed, gains, about)
            known.setdefault(name, {})[pace] = {**gains, "score": {"cost": cost}}
            print(name, pace, f"cost {cost:.2f}", flush=True)
            write_whole(options.out, as_toml(known))


SEARCHES = [(kind, pace) for kind in KINDS for pace in PRICES]
NARROW = 0.06
"""Standard deviation of the first round's gains, as a share of their bounds."""
KEEP = 3
CORNER_RAD, SIDE_M = 0.8 * np.pi, 0.8


def turn_and_corners(rng: np.random.Generator, n: int, J: int) -> tuple[Array, Array, Array]:
    """The turn, and two more waypoints each 144 degrees round."""
    pose, joint, first = TASKS["turn"].place(rng, n, J)
    pose[:, 2] += rng.uniform(-0.3, 0.3, n)
    way = first[:, 0] - pose[:, :2]
    angle = np.arctan2(way[:, 1], way[:, 0])
    points = [first[:, 0]]
    for sign in (1, -1):
        angle = angle + sign * CORNER_RAD
        points.append(points[-1] + SIDE_M * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return pose, joint, np.stack(points, axis=1)


IN_TRIALS = Task("turn and corners", turn_and_corners, waypoints=3, steps=1200)


def costs(episodes: Episodes, price: Array) -> Array:
    """Time and energy at each robot's price, and what it missed, shape (E,)."""
    figures = measured(episodes, IN_TRIALS)
    time, energy = figures["time_s"], figures["energy"]
    return np.asarray(time + price * energy / 1000 + 20 * (IN_TRIALS.waypoints - episodes.reached))


def swum(gains: dict[Any, Array], options: argparse.Namespace, seed: int) -> dict[Any, Array]:
    """Costs (C, S) of candidates (C, G) of every search on S trials."""
    C, S = options.candidates, options.trials
    drawn = draws_of(MODEL, read_ranges(POOL / "ranges.json"), ROBOT, seed=seed, n=S)
    own = [Draws((model,), drawn.noise) for model in drawn.models]
    controllers, price = [], []
    for kind in KINDS:
        rows = np.concatenate([gains[kind, pace] for pace in PRICES])
        controllers.append(built(kind, np.repeat(rows, S, axis=0)))
        price.append(np.repeat([*PRICES.values()], C * S))
    starts = IN_TRIALS.place(np.random.default_rng(seed), S, len(LIMITS))
    n = len(SEARCHES) * C
    tiled = Starts(*(np.tile(x, (n, *[1] * (x.ndim - 1))) for x in starts))
    settings = SimulationSettings(options.fidelity, options.device, cell_m=options.cell_m)
    steering = Controllers(controllers, n * S // len(controllers))
    episodes = simulate(
        steering, ROBOT, IN_TRIALS, tiled, seed, draws=own * n, settings=settings, name="trials"
    )
    table = costs(episodes, np.concatenate(price)).reshape(len(SEARCHES), C, S)
    return dict(zip(SEARCHES, table, strict=True))


def tried(options: argparse.Namespace) -> None:
    """Look on from known gains in trials, and write."""
    rng = np.random.default_rng(options.seed)
    known: dict[str, Any] = tomllib.loads(options.first.read_text())
    middle, spread, box = {}, {}, {}
    for kind, pace in SEARCHES:
        bounds = BOUNDS[KINDS[kind][0]]
        box[kind, pace] = np.array([*bounds.values()])
        middle[kind, pace] = np.array([known[kind][pace][name] for name in bounds])
        spread[kind, pace] = NARROW * np.ptp(box[kind, pace], axis=1)
    for k in tqdm(range(options.rounds), disable=None):
        drawn = {}
        for key, mean in middle.items():
            off = rng.normal(size=(options.candidates, mean.size)) * spread[key]
            off[0] = 0.0  # the best so far stays in the race
            drawn[key] = np.clip(mean + off, *box[key].T)
        found = swum(drawn, options, options.seed + 50 + k)
        for key, table in found.items():
            cost = table.mean(axis=1)
            best = drawn[key][np.argsort(cost)[:KEEP]]
            last = k == options.rounds - 1
            middle[key] = best[0] if last else best.mean(axis=0)
            spread[key] = 0.5 * spread[key] + 0.5 * best.std(axis=0)
            kind, pace = key
            print(k, kind, pace, f"cost {cost[0]:.2f}, best {cost.min():.2f}", flush=True)
            names = BOUNDS[KINDS[kind][0]]
            gains = dict(zip(names, map(float, middle[key]), strict=True))
            known[kind][pace] = {**gains, "score": {"cost": float(cost.min())}}
        write_whole(options.out, as_toml(known))


def main() -> None:
    """One stage."""
    parser = command_line(
        __doc__, refine=(False, "about the gains that there are"), generations=40, seed=0,
        device="cpu", cell_m=0.02, rounds=8, candidates=12, trials=4, first=TUNED,
    )  # fmt: skip
    parser.add_argument("stage", choices=("search", "trials"))
    parser.add_argument("--only", choices=[*KINDS], action="append")
    parser.add_argument("--pace", choices=PACES, action="append")
    parser.add_argument("--fidelity", choices=("twin", "fluid"), default="twin")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    (searched if options.stage == "search" else tried)(options)


def as_toml(tables: dict[str, Any]) -> str:
    """The file of gains."""
    made = "benchmarks/tune_controllers.py, which says what the paces are."
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
