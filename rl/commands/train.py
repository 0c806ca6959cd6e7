"""``sim2real train``."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.controllers import discrete_cpg
from rl.experiments.testbeds import (
    HELD_OUT,
    DrawnTrials,
    SimulationSettings,
    choose_prices,
    held_out,
)
from rl.sac import train as sac
from rl.sac.checkpoint import TensorBoard, curves_figure, read_progress
from rl.sac.plan import OPTIONS, RECIPES
from sim2real.commands.command import where_jobs_run
from sim2real.errors import InputError
from sim2real.executor import map_jobs
from sim2real.model import read_model
from sim2real.output import write_json
from sim2real.ranges.entry import read_ranges
from sim2real.report.drawing import save_png
from sim2real.robot import read_robot

TRAINERS = {"sac": sac, "discrete-cpg": discrete_cpg}
"""Modules with ``train_run`` and ``QUICK``, by the value of ``--controller``."""


def run(options: argparse.Namespace) -> int:
    """Train one agent for each seed; plot the learning curves."""
    if options.out.exists() and not options.out.is_dir():
        raise InputError(options.out, "", "a file", "a folder")
    torch.set_num_threads(1)  # the networks are small
    arguments = arguments_of(options)
    watched: dict[str, Any] = {}
    if options.tensorboard:
        if options.controller != "sac" or options.executor is not None:
            expected = "neither --executor nor another --controller than sac"
            raise InputError("train", "--tensorboard", "one of them", expected)
        watched["report"] = TensorBoard(options.out / "tensorboard")
    if options.executor is None:
        folders = TRAINERS[options.controller].train_run(options.out, **arguments, **watched)
    else:
        folders = _side_by_side(options, arguments)
    if not options.no_plots:
        save_png(curves_figure({"policy": folders}), options.out / "curve.png")
    for folder in folders:
        progress = read_progress(folder)
        ended = np.flatnonzero(progress["episodes"] > 0)
        outcome = (
            f"return {progress['mean_return'][ended[-1]]:.2f}" if ended.size else "no episode ended"
        )
        print(f"{folder / 'policy.zip'}: {int(progress['steps'][-1])} steps, {outcome}")
    return 0 if not options.trials or select(options, folders, arguments) else 1


def select(
    options: argparse.Namespace, folders: list[Path], trained: dict[str, Any], learned: float = 0.5
) -> bool:
    """Choose each agent's price and then the best agent by held-out trials: ``trials.json``.

    ``trained`` are the training's arguments; agents trained on ``near`` are tested on it, others on
    turns and all distances. False if even the best reaches less than the share ``learned`` of its
    targets.
    """
    ranges = None if options.ranges is None else read_ranges(options.ranges)
    settings = SimulationSettings(options.fidelity, options.device, options.threads, options.cell_m)
    files = read_robot(options.robot), read_model(options.model), ranges
    swims = DrawnTrials(*files, options.trials, settings)
    prices = choose_prices(swims, folders)
    recipe = RECIPES[options.recipe or "default"]
    energy = trained.get("energy_weight") or recipe.task.energy
    tasks = ("near",) if trained.get("task") == "near" else HELD_OUT
    trials = held_out(swims, folders, energy, tasks)
    write_json(options.out / "trials.json", {**trials, "prices": prices})
    for agent, rows in trials["agents"].items():
        summary = ", ".join(
            f"{name} {100 * rows[name]['success']:.0f} % in {rows[name]['time_s']:.1f} s at "
            f"{rows[name]['energy']:.0f} rad2/s2"
            for name in tasks
        )
        if agent in prices:
            summary = f"at {prices[agent]:.2g} times its price of energy: {summary}"
        print(f"{agent}: {summary}; reward {rows['score']:.2f}")
    print(f"best of {options.trials} held-out trials each: {trials['best']}")
    share = trials["agents"][trials["best"]]["success"]
    if share < learned:
        print(
            f"did not learn: {trials['best']} reaches {100 * share:.0f} % of its targets, below "
            f"{100 * learned:.0f} %; train it for more --steps, or with another --seed"
        )
    return bool(share >= learned)


def arguments_of(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of ``train_run`` as JSON values; options override those of ``--quick``."""
    given = {name: getattr(options, name, None) for name in OPTIONS}
    options_set = {k: x for k, x in given.items() if x is not None and x is not False}
    trainer = TRAINERS[options.controller]
    if options.first:
        options_set["first"] = [str(path.absolute()) for path in options.first]
    for name in options_set.keys() - {*trainer.ACCEPTED}:
        controller, option = f"--controller {options.controller}", f"--{name.replace('_', '-')}"
        raise InputError("train", option, controller, "--controller sac")
    return {
        **(trainer.QUICK if options.quick else {}),
        **options_set,
        "robot": str(options.robot),
        "model": str(options.model),
        "ranges": None if options.ranges is None else str(options.ranges),
        "seeds": list(range(options.seed, options.seed + options.seeds)),
        "fidelity": options.fidelity,
        "device": options.device,
        "cell_m": options.cell_m,
        "threads": options.threads,
    }


def _side_by_side(options: argparse.Namespace, arguments: dict[str, Any]) -> list[Path]:
    """Run a job for each seed, on this machine or on a cluster."""
    paths = [name for name in ("robot", "model", "ranges") if arguments[name]]
    files = {name: str(Path(arguments[name]).absolute()) for name in paths}
    calls, seeds, first = {}, arguments["seeds"], arguments.get("first")
    for k, seed in enumerate(seeds):
        chosen = {"first": [first[k % len(first)]]} if first else {}
        calls[f"seed-{seed}"] = {**arguments, **files, **chosen, "seeds": [seed]}
    work = f"{TRAINERS[options.controller].__name__}:train_run"
    folders = map_jobs(work, calls, options.out, **where_jobs_run(options))
    return [folder / f"policy-{seed}" for folder, seed in zip(folders, seeds, strict=True)]
