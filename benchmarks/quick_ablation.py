"""How often the demo's ablation finds the servo: many ablations in one batch of agents.

    python benchmarks/quick_ablation.py --out FOLDER [--device cuda:0] [--runs 5]

Trains the demo's arms for as many seeds as its ablation has, times ``--runs``, with the demo's plan
and initial agents, simulates the same turns in the twin with the parameters of the reality, and
compares run by run: which arm loses most, whether its interval excludes zero, whether that of
another arm does; the same for other numbers of seeds, drawn from all. Options change the plan.
``--from FILE ...`` evaluates the agents of earlier calls again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sim2real as s2r
from rl.commands.ablate import make_testbeds
from rl.commands.demo_pool import QUICK, REPEATS, SEEDS, agents_in
from rl.experiments.ablation import ablate
from rl.experiments.arms import PAPER, arm_of
from rl.experiments.differences import Difference, differences
from rl.sac.train import train
from sim2real.output import write_json
from sim2real.ranges.entry import read_ranges

POOL = Path("datasets/pool")
DRAWS = 500


def main() -> None:
    """Train, swim, count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--first", type=Path, nargs="+", default=agents_in(POOL))
    parser.add_argument("--steps", type=int, default=QUICK.steps, help="steps of each arm")
    parser.add_argument("--learning-rate", type=float, default=QUICK.settings.rate)
    parser.add_argument("--updates-per-step", type=float, default=QUICK.settings.updates_per_step)
    parser.add_argument("--average", type=float, default=QUICK.settings.average)
    parser.add_argument("--energy-weight", type=float, default=QUICK.task.energy)
    parser.add_argument("--arms", nargs="+", choices=PAPER, default=PAPER)
    parser.add_argument("--from", dest="earlier", type=Path, nargs="+", default=[], metavar="FILE")
    options = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.perf_counter()
    if options.earlier:
        parts = [json.loads(path.read_text())["agents"] for path in options.earlier]
        results: dict[str, Any] = {"agents": [agent for part in parts for agent in part]}
    else:
        results = ablated(options)
    content = {"options": {k: str(v) for k, v in vars(options).items()}, **counted(results)}
    content["seconds"] = round(time.perf_counter() - begun, 1)
    for name, value in content.items():
        print(name, value)
    for agent in results["agents"]:
        agent["reality"].pop("path", None)
    write_json(options.out / "runs.json", {**content, "agents": results["agents"]})


def ablated(options: argparse.Namespace) -> dict[str, Any]:
    """Results of one ablation with the seeds of all runs."""
    robot, model = s2r.read_robot(POOL / "robot.toml"), s2r.read_model(POOL / "calibrated.json")
    ranges, reality = read_ranges(POOL / "ranges.json"), s2r.read_model(POOL / "reality.json")
    arms = [arm_of(name, model, robot, ranges) for name in options.arms]
    seeds = tuple(range(options.seed, options.seed + SEEDS * options.runs))
    settings = replace(
        QUICK.settings, rate=options.learning_rate, updates_per_step=options.updates_per_step,
        average=options.average,
    )  # fmt: skip
    plan = replace(
        QUICK, task=replace(QUICK.task, energy=options.energy_weight), steps=options.steps,
        segment=options.steps, seeds=seeds, device=options.device, settings=settings, threads=1,
    )  # fmt: skip
    testbeds = make_testbeds(robot, arms, plan, ranges, reality)[1:]
    return ablate(
        options.out, robot, arms, plan, testbeds, seed=options.seed, repeats=REPEATS,
        trainer=partial(train, first=options.first),
    )  # fmt: skip


def counted(results: dict[str, Any]) -> dict[str, Any]:
    """Differences of all seeds, of each run, and rates of runs with the same findings."""
    seeds = sorted({agent["seed"] for agent in results["agents"]})
    groups = [seeds[first : first + SEEDS] for first in range(0, len(seeds), SEEDS)]
    runs = [among(results, own) for own in groups]
    rng = np.random.default_rng(0)
    drawn = {
        S: rates([among(results, rng.choice(seeds, S, replace=False)) for _ in range(DRAWS)])
        for S in (6, SEEDS, 10, 12, 16)
        if len(seeds) >= 2 * S
    }
    return {
        "whole": {arm: text_of(one) for arm, one in differences(results).items()},
        "runs": [{arm: text_of(one) for arm, one in run.items()} for run in runs],
        "of the runs": rates(runs),
        "of as many seeds, drawn": drawn,
        "of": len(runs),
    }


def among(results: dict[str, Any], seeds: Sequence[int]) -> dict[str, Difference]:
    """The differences of some of the seeds."""
    own = {int(seed) for seed in seeds}
    return differences({"agents": [agent for agent in results["agents"] if agent["seed"] in own]})


def rates(runs: Sequence[Mapping[str, Difference]]) -> dict[str, float]:
    """Shares of runs: whose servo loses most, is off zero, both; with another arm off zero."""
    servo = np.array([max(run, key=lambda arm: run[arm].mean) == "no-servo" for run in runs])
    off = np.array([run["no-servo"].low > 0 for run in runs])
    false = [any(one.significant for arm, one in run.items() if arm != "no-servo") for run in runs]
    shares = {"servo first": servo, "servo off zero": off, "both": servo & off}
    shares["another arm off zero"] = np.array(false)
    return {name: round(float(one.mean()), 3) for name, one in shares.items()}


def text_of(one: Difference) -> str:
    """A difference in a few words."""
    return f"{one.mean:+.2f} ({one.low:+.2f} to {one.high:+.2f}), sd {one.sd:.2f}"


if __name__ == "__main__":
    main()
