"""``sim2real train``."""

from __future__ import annotations

import argparse
import inspect
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.controllers import discrete_train
from rl.executor import Job, run_jobs
from rl.experiments.paces import choose_prices
from rl.experiments.selection import HELD_OUT, held_out
from rl.sac import jobs as sac
from rl.sac.curve import draw_curves, read_progress
from rl.sac.recipes import RECIPES
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import write_json
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

TRAINERS = {"sac": sac, "discrete-cpg": discrete_train}
"""Modules with ``train_run`` and ``QUICK``, by what ``--controller`` says."""


def run(options: argparse.Namespace) -> int:
    """Train one agent for each seed; draw how it went."""
    if options.out.exists() and not options.out.is_dir():
        raise InputError(options.out, "", "a file", "a folder")
    torch.set_num_threads(1)  # the networks are small
    given = call(options)
    if options.executor is None:
        folders = TRAINERS[options.controller].train_run(options.out, **given)
    else:
        folders = _side_by_side(options, given)
    if not options.no_plots:
        draw_curves({"policy": folders}, options.out / "curve.png")
    if options.tensorboard:
        write_tensorboard(folders)
    for folder in folders:
        seen = read_progress(folder)
        some = np.flatnonzero(seen["episodes"] > 0)
        last = f"return {seen['mean_return'][some[-1]]:.2f}" if some.size else "no episode ended"
        print(f"{folder / 'policy.zip'}: {int(seen['steps'][-1])} steps, {last}")
    if options.trials:
        select(options, folders)
    return 0


def select(options: argparse.Namespace, folders: list[Path]) -> None:
    """Choose each agent's price and then the best agent by held-out trials: ``trials.json``."""
    fish, model = read_robot(options.robot), read_model(options.model)
    ranges = None if options.ranges is None else read_ranges(options.ranges)
    water = {"fidelity": options.fidelity, "device": options.device, "cell_m": options.cell_m}
    water["threads"] = options.threads
    prices = choose_prices(folders, fish, model, ranges, episodes=options.trials, **water)
    energy = options.energy_weight or RECIPES[options.recipe or "default"].energy
    found = held_out(folders, fish, model, ranges, energy=energy, episodes=options.trials, **water)
    write_json(options.out / "trials.json", {**found, "prices": prices})
    for agent, rows in found["agents"].items():
        told = ", ".join(
            f"{name} {100 * rows[name]['success']:.0f} % in {rows[name]['time_s']:.1f} s at "
            f"{rows[name]['energy']:.0f} rad2/s2"
            for name in HELD_OUT
        )
        if agent in prices:
            told = f"at {prices[agent]:.2g} times its price of energy {told}"
        print(f"{agent}: {told}; reward {rows['score']:.2f}")
    print(f"best of {options.trials} held-out trials each: {found['best']}")


def call(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of ``train_run``, as JSON keeps them: the quick ones, then what was asked for.

    Raises:
        InputError: If an option is not of this controller.
    """
    asked = {
        "recipe": options.recipe, "task": options.task, "steps": options.steps,
        "envs": options.envs, "segment": options.segment,
        "updates_per_step": options.updates_per_step,
        "learning_rate": options.learning_rate, "discount": options.discount,
        "energy_weight": options.energy_weight, "energy_start": options.energy_start,
    }  # fmt: skip
    count = options.seeds
    trainer = TRAINERS[options.controller]
    given = {name: value for name, value in asked.items() if value is not None}
    if options.first:
        given["first"] = [str(path.absolute()) for path in options.first]
    for name in given.keys() - inspect.signature(trainer.train_run).parameters:
        found, option = f"--controller {options.controller}", f"--{name.replace('_', '-')}"
        raise InputError("train", option, found, "--controller sac")
    return {
        **(trainer.QUICK if options.quick else {}),
        **given,
        "robot": str(options.robot),
        "model": str(options.model),
        "ranges": None if options.ranges is None else str(options.ranges),
        "seeds": list(range(options.seed, options.seed + count)),
        "fidelity": options.fidelity,
        "device": options.device,
        "cell_m": options.cell_m,
        "threads": options.threads,
    }


def _side_by_side(options: argparse.Namespace, given: dict[str, Any]) -> list[Path]:
    """A job for each seed, on this machine or on a cluster."""
    jobs = []
    for seed in given["seeds"]:
        name = f"seed-{seed}"
        files = {
            k: str(Path(given[k]).absolute()) for k in ("robot", "model", "ranges") if given[k]
        }
        one = {**given, **files, "seeds": [seed]}
        if "first" in given:
            chosen = given["seeds"].index(seed) % len(given["first"])
            one["first"] = given["first"][chosen : chosen + 1]
        work = f"{TRAINERS[options.controller].__name__}:train_run"
        jobs.append(Job(name, work, one, options.out / name))
    outcomes = run_jobs(
        jobs, executor=options.executor, at_once=options.jobs, address=options.address,
        gpus=0 if options.device == "cpu" else 1, retries=options.retries,
    )  # fmt: skip
    failed = [str(outcome) for outcome in outcomes if outcome.failure]
    if failed:
        raise RuntimeError("; ".join(failed))
    return [job.folder / f"policy-{job.options['seeds'][0]}" for job in jobs]


def write_tensorboard(folders: list[Path]) -> None:
    """The same figures for TensorBoard, beside each agent's ``progress.csv``.

    Raises:
        InputError: If TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise InputError(
            "train", "--tensorboard", "no TensorBoard", "pip install tensorboard"
        ) from (None)
    for folder in folders:
        seen = read_progress(folder)
        steps = seen.pop("steps")
        with SummaryWriter(str(folder / "tensorboard")) as writer:
            for name, values in seen.items():
                for step, value in zip(steps, values, strict=True):
                    if np.isfinite(value):
                        writer.add_scalar(name, value, int(step))
