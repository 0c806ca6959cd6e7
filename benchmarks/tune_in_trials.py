"""Gains of the classical controllers, tuned as they are tried: in randomized trials.

    python benchmarks/tune_in_trials.py --out rl/controllers/tuned.toml
    python benchmarks/tune_in_trials.py --fidelity fluid --device cuda:0 --out gains.toml

From gains that are known, the cross-entropy method (Rubinstein and Kroese, 2004) looks on: each
round draws gains about the best so far, for two controllers at three prices of energy, all of them
in one batch. A trial is the 180 degree turn and two corners of a pentagram after it, with latencies
and noise drawn from the ranges, which ``tune_controllers.py`` does without: what that finds suffers
from them. What it lowers is time and energy at its price, as there. Rounds have trials of their
own.
"""

from __future__ import annotations

import argparse
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from harness import command_line
from tqdm import tqdm
from tune_controllers import BOUNDS, KINDS, LIMITS, MODEL, PRICES, ROBOT, as_toml

from rl.controllers.classical import TUNED
from rl.experiments.episodes import Episodes, spent
from rl.experiments.reality import Starts
from rl.experiments.testbeds import Controllers, SimulationSettings, simulate
from rl.make import draws_of
from rl.task import TASKS, Task
from rl.world import Draws
from sim2real.arrays import Array
from sim2real.output import write_whole
from sim2real.ranges.entry import read_ranges

SEARCHES = [(kind, pace) for kind in KINDS for pace in PRICES]
SPREAD = 0.06
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


TASK = Task("turn and corners", turn_and_corners, waypoints=3, steps=1200)


def costs(episodes: Episodes, price: Array) -> Array:
    """Time and energy at each robot's price, and what it missed, shape (E,)."""
    time, energy = spent(episodes, TASK)
    return np.asarray(time + price * energy / 1000 + 20 * (TASK.waypoints - episodes.reached))


def swum(gains: dict[Any, Array], options: argparse.Namespace, seed: int) -> dict[Any, Array]:
    """Costs (C, S) of candidates (C, G) of every search on S trials."""
    C, S = options.candidates, options.trials
    drawn = draws_of(MODEL, read_ranges("datasets/pool/ranges.json"), ROBOT, seed=seed, n=S)
    own = [Draws((model,), drawn.noise) for model in drawn.models]
    controllers, price = [], []
    for kind, (form, build) in KINDS.items():
        rows = np.concatenate([gains[kind, pace] for pace in PRICES])
        columns = np.repeat(rows, S, axis=0).T
        named = dict(zip((one.name for one in fields(form)), columns, strict=True))
        controllers.append(build(LIMITS, columns.shape[1], form(**named)))
        price.append(np.repeat([*PRICES.values()], C * S))
    starts = TASK.place(np.random.default_rng(seed), S, len(LIMITS))
    n = len(SEARCHES) * C
    tiled = Starts(*(np.tile(x, (n, *[1] * (x.ndim - 1))) for x in starts))
    settings = SimulationSettings(options.fidelity, options.device, cell_m=options.cell_m)
    steering = Controllers(controllers, n * S // len(controllers))
    episodes = simulate(ROBOT, TASK, tiled, own * n, steering, settings, seed=seed, name="fluid")
    table = costs(episodes, np.concatenate(price)).reshape(len(SEARCHES), C, S)
    return dict(zip(SEARCHES, table, strict=True))


def main() -> None:
    """Search, write."""
    parser = command_line(
        __doc__, device="cpu", cell_m=0.02, rounds=8, candidates=12, trials=4, seed=0, first=TUNED
    )
    parser.add_argument("--fidelity", choices=("twin", "fluid"), default="twin")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rng = np.random.default_rng(options.seed)
    known: dict[str, Any] = tomllib.loads(options.first.read_text())
    middle, spread, box = {}, {}, {}
    for kind, pace in SEARCHES:
        bounds = BOUNDS[KINDS[kind][0]]
        box[kind, pace] = np.array([*bounds.values()])
        middle[kind, pace] = np.array([known[kind][pace][name] for name in bounds])
        spread[kind, pace] = SPREAD * np.ptp(box[kind, pace], axis=1)
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


if __name__ == "__main__":
    main()
