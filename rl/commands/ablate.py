"""``sim2real ablate``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.experiments.ablation import ablate
from rl.experiments.ablation_report import markdown, write_report
from rl.experiments.arms import ARMS, arm_of
from rl.experiments.predicted import Agents, predict
from rl.experiments.reality import RealityFile, read_reality
from rl.experiments.testbeds import Real, Simulated, Testbed
from rl.forecast.realities import check_ranges, draw_realities, sample_of
from rl.forecast.swims import SimulationSettings
from rl.randomize import noise_of
from rl.sac import recipes
from rl.sac.train import Arm, Plan, train
from rl.task import Task
from rl.world import Draws
from sim2real.commands.command import where_jobs_run
from sim2real.errors import InputError
from sim2real.executor import map_jobs
from sim2real.model import Model, read_model
from sim2real.output import provenance
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.robot import Robot, read_robot


def run(options: argparse.Namespace) -> int:
    """Train the arms, evaluate the turn in simulation and reality, write the report."""
    if options.out.exists() and not options.out.is_dir():
        raise InputError(options.out, "", "a file", "a folder")
    for name, least in (("seeds", 1), ("repeats", 1)):
        if getattr(options, name) < least:
            raise InputError("ablate", f"--{name}", str(getattr(options, name)), f">= {least}")
    torch.set_num_threads(1)
    robot, model = read_robot(options.robot), read_model(options.model)
    if options.ranges is None:
        raise InputError("ablate", "--ranges", "none", "RANGES.json to draw episodes from")
    ranges, reality = read_ranges(options.ranges), reality_of(options)
    enriched = None if options.enriched is None else read_model(options.enriched)
    predictor = predictor_of(options, robot, model, ranges) if options.forecast else None
    truth = known_of(options, reality)
    unavailable = {"all-and-effects"} if enriched is None else set()
    unavailable |= {"ceiling"} if truth is None else set()
    names = options.arms or [name for name in ARMS if name not in {*unavailable, "none", "midway"}]
    if truth is None and "ceiling" in names:
        raise InputError("ablate", "--arms", "ceiling", "--reality or --truth MODEL.json")
    if enriched is None and any(ARMS[name].effects for name in names):
        raise InputError("ablate", "--arms", "all-and-effects", "--enriched MODEL with it")
    arms = [arm_of(name, model, robot, ranges, enriched, truth) for name in names]
    plan = plan_of(options)
    testbeds = make_testbeds(robot, arms, plan, ranges, reality, options.reality_cell_m)
    files = [options.robot, options.model, options.ranges]
    files += reality.files if isinstance(reality, RealityFile) else [options.reality]
    files += [*([options.truth] if options.truth else []), *(options.first or [])]
    note = provenance([*files, *([options.enriched] if options.enriched else [])], options.seed)
    results = ablate(
        options.out, robot, arms, plan, testbeds, repeats=options.repeats, seed=options.seed,
        sampled=options.sampled, note=note,
        trainer=trainer_of(options), predictor=predictor,
    )  # fmt: skip
    write_report(results, plan, options.out, note)
    print(markdown(results))
    print(f"report: {options.out / 'index.html'}")
    return 0


def reality_of(options: argparse.Namespace) -> Model | RealityFile:
    """The reality that policies are tested in: a model, or a Python file with ``make``."""
    if options.reality.suffix != ".py":
        return read_model(options.reality)
    cell = options.reality_cell_m
    return read_reality(options.reality, **({} if cell is None else {"cell_m": cell}))


def known_of(options: argparse.Namespace, reality: Model | RealityFile) -> Model | None:
    """The true parameters of the reality; None if they are not known."""
    if options.truth is not None:
        return read_model(options.truth)
    return reality if isinstance(reality, Model) else None


def trainer_of(options: argparse.Namespace) -> Callable[..., list[Path]] | None:
    """The training function; None for ``rl.sac.train.train``, all agents in one batch.

    With ``--first`` training continues from policies; with ``--executor`` each run has a process.
    """
    if options.first and options.executor is not None:
        raise InputError("ablate", "--first", "--executor with it", "one of the two")
    if options.first:
        return partial(train, first=options.first)
    return None if options.executor is None else by_jobs(options)


def predictor_of(
    options: argparse.Namespace, robot: Robot, model: Model, ranges: Ranges, realities: int = 50
) -> Callable[[Agents, Task, Path, str], dict[str, Any]]:
    """The forecast of arms in realities that agree with the model and its ranges, in the twin.

    Raises:
        InputError: If the ranges have no posterior sample, or are not those of the model.
    """
    sample = sample_of(ranges, options.ranges)
    check_ranges(ranges, model, options.ranges)
    rng = np.random.default_rng(options.seed)
    drawn = draw_realities(robot, model, ranges, sample, realities, rng)
    settings = SimulationSettings(device=options.device, threads=options.threads)
    return partial(predict, robot=robot, realities=drawn, seed=options.seed, settings=settings)


def plan_of(options: argparse.Namespace) -> Plan:
    """The plan of the training; options override the settings of ``--quick``."""
    options_set = {name: value for name, value in vars(options).items() if value is not None}
    quick = {} if not options.quick else {"recipe": "brief"} if options.first else recipes.QUICK
    return recipes.plan_of(
        {**quick, **options_set},
        seeds=tuple(range(options.seed, options.seed + options.seeds)), fidelity=options.fidelity,
        device=options.device, cell_m=options.cell_m, threads=options.threads,
    )  # fmt: skip


def make_testbeds(
    robot: Robot, arms: Sequence[Arm], plan: Plan, ranges: Ranges, reality: Model | RealityFile,
    cell_m: float | None = None,
) -> list[Testbed]:  # fmt: skip
    """The testbeds: the simulator of each arm, and the reality, which no arm was trained in.

    Args:
        robot: The robot.
        arms: The arms.
        plan: How they are trained.
        ranges: Source of the sensor noise, if the reality is a model.
        reality: A model for the library's simulator, or a Python file, see ``reality``.
        cell_m: Cell size in m, if the reality is a model; default: half of that in training.
    """
    S = len(plan.seeds)
    draws = [arm.draws for arm in arms for _ in range(S)]
    simulation = _simulated("simulation", draws, plan, plan.cell_m, {})
    if isinstance(reality, RealityFile):
        return [simulation, Real(reality, plan.device)]
    noise = noise_of(ranges, [joint.name for joint in robot.joints])
    real = [Draws((reality,), noise)] * len(draws)
    finer: dict[str, Any] = {"substeps": 16}
    if plan.fidelity == "fluid":
        finer = {"smagorinsky": 0.14, "viscosity_m2_s": 4e-5}
    return [simulation, _simulated("reality", real, plan, cell_m or plan.cell_m / 2, finer)]


def _simulated(
    name: str, draws: Sequence[Draws], plan: Plan, cell_m: float, options: dict[str, Any]
) -> Simulated:
    return Simulated(name, draws, plan.fidelity, cell_m, options, plan.device, plan.threads)


def by_jobs(options: argparse.Namespace) -> Any:  # noqa: ANN401 - a trainer
    """A trainer that runs each arm and seed in its own process."""

    def train_jobs(
        folder: Path, robot: Robot, arms: Sequence[Arm], plan: Plan, note: dict[str, Any]
    ) -> list[Path]:
        del robot, note
        calls = {}
        for arm in arms:
            for seed in plan.seeds:
                files = {
                    key: None if value is None else str(value.absolute())
                    for key in ("robot", "model", "ranges", "enriched", "reality", "truth")
                    for value in (getattr(options, key),)
                }
                call = {**files, "arm": arm.name, "seed": seed, "plan": plan_options(options)}
                calls[f"{arm.name}-{seed}"] = call
        work = "rl.commands.ablate:train_one"
        folders = map_jobs(work, calls, folder, **where_jobs_run(options))
        return [folder / folder.name for folder in folders]

    return train_jobs


def plan_options(options: argparse.Namespace) -> dict[str, Any]:
    """The options that ``plan_of`` reads, as JSON values."""
    names = ("quick", *recipes.OPTIONS, "fidelity", "device", "cell_m", "threads")
    return {name: getattr(options, name, None) for name in names}


def train_one(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str,
    enriched: str | None,
    reality: str,
    truth: str | None,
    arm: str,
    seed: int,
    plan: dict[str, Any],
) -> None:
    """Train one arm with one seed, as a job of ``sim2real.executor``."""
    torch.set_num_threads(1)
    fish = read_robot(robot)
    enriched_model = None if enriched is None else read_model(enriched)
    truth_model = read_model(truth or reality) if arm == "ceiling" else None
    trained_arm = arm_of(
        arm, read_model(model), fish, read_ranges(ranges), enriched_model, truth_model
    )
    training_plan = plan_of(argparse.Namespace(**plan, seed=seed, seeds=1))
    train(folder, fish, [trained_arm], training_plan)
