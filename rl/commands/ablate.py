"""``sim2real ablate``."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from rl.experiments.ablation import PAPER, ablate, arm_of
from rl.experiments.ablation_report import default_values, markdown, write_report
from rl.experiments.reality import RealityFile, read_reality
from rl.experiments.testbeds import SimulationSettings, Testbed, real, simulated
from rl.make import noise_of
from rl.sac import plan as plans
from rl.sac.plan import OPTIONS, QUICK, Arm, Plan
from rl.sac.train import train
from rl.world import Draws
from sim2real.commands.command import where_jobs_run
from sim2real.errors import InputError, check_whole
from sim2real.executor import map_jobs
from sim2real.model import Model, read_model
from sim2real.output import provenance
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.robot import Robot, read_robot

FILES = ("robot", "model", "ranges", "enriched", "reality", "truth")
"""Options that are files of the arms."""


def run(options: argparse.Namespace) -> int:
    """Train the arms, evaluate the turn in simulation and reality, write the report."""
    if options.out.exists() and not options.out.is_dir():
        raise InputError(options.out, "", "a file", "a folder")
    for name in ("seeds", "repeats"):
        check_whole("ablate", f"--{name}", getattr(options, name), 1)
    torch.set_num_threads(1)
    robot = read_robot(options.robot)
    if options.ranges is None:
        raise InputError("ablate", "--ranges", "none", "RANGES.json to draw episodes from")
    if options.first and options.executor is not None:
        raise InputError("ablate", "--first", "--executor with it", "one of the two")
    ranges, reality = read_ranges(options.ranges), reality_of(options)
    missing = {}
    if options.truth is None and not isinstance(reality, Model):
        missing["ceiling"] = "--reality or --truth MODEL.json"
    if options.enriched is None:
        missing["full-and-effects"] = "--enriched MODEL with it"
    names = options.arms or [x for x in (*PAPER, "full-and-effects") if x not in missing]
    for name in names:
        if name in missing:
            raise InputError("ablate", "--arms", name, missing[name])
    files = {name: getattr(options, name) for name in FILES}
    arms = [read_arm(name, **files) for name in names]
    plan = plan_of(options)
    testbeds = make_testbeds(robot, arms, plan, ranges, reality, options.reality_cell_m)
    sources = [path for path in files.values() if path is not None and path.suffix != ".py"]
    sources += [*(reality.files if isinstance(reality, RealityFile) else ())]
    note = provenance([*sources, *(options.first or [])], options.seed)
    if options.executor is None:
        agents = train(options.out / "train", robot, arms, plan, note, first=options.first or ())
    else:
        agents = train_jobs(options, names, plan)
    results = ablate(
        options.out, robot, names, agents, plan, testbeds, repeats=options.repeats,
        seed=options.seed,
    )  # fmt: skip
    values = default_values(read_model(options.model), robot)
    write_report(results, plan, options.out, note, values)
    print(markdown(results))
    print(f"report: {options.out / 'index.html'}")
    return 0


def reality_of(options: argparse.Namespace) -> Model | RealityFile:
    """The reality that policies are tested in: a model, or a Python file with ``make``."""
    if options.reality.suffix != ".py":
        return read_model(options.reality)
    cell = options.reality_cell_m
    return read_reality(options.reality, **({} if cell is None else {"cell_m": cell}))


def plan_of(options: argparse.Namespace) -> Plan:
    """The plan of the training; options override the settings of ``--quick``."""
    options_set = {name: value for name, value in vars(options).items() if value is not None}
    quick = {} if not options.quick else {"recipe": "brief"} if options.first else QUICK
    return plans.plan_of(
        {**quick, **options_set},
        seeds=tuple(range(options.seed, options.seed + options.seeds)), fidelity=options.fidelity,
        device=options.device, cell_m=options.cell_m, threads=options.threads,
    )  # fmt: skip


def make_testbeds(
    robot: Robot, arms: Sequence[Arm], plan: Plan, ranges: Ranges, reality: Model | RealityFile,
    cell_m: float | None = None,
) -> list[Testbed]:  # fmt: skip
    """Each arm's simulator, and the reality: a file, or a model with finer cells."""
    draws = [arm.draws for arm in arms for _ in plan.seeds]
    settings = SimulationSettings(plan.fidelity, plan.device, plan.threads, plan.cell_m)
    simulation = simulated("simulation", draws, settings)
    if isinstance(reality, RealityFile):
        return [simulation, real(reality, plan.device)]
    noise = noise_of(ranges, [joint.name for joint in robot.joints])
    finer: dict[str, Any] = {"substeps": 16}
    if plan.fidelity == "fluid":
        finer = {"smagorinsky": 0.14, "viscosity_m2_s": 4e-5}
    settings = replace(settings, cell_m=cell_m or plan.cell_m / 2)
    true = [Draws((reality,), noise)] * len(draws)
    return [simulation, simulated("reality", true, settings, **finer)]


def train_jobs(options: argparse.Namespace, arms: Sequence[str], plan: Plan) -> list[Path]:
    """Train each arm and seed in its own process."""
    files = {name: getattr(options, name) for name in FILES}
    paths = {name: None if x is None else str(x.absolute()) for name, x in files.items()}
    names = ("quick", *OPTIONS, "fidelity", "device", "cell_m", "threads")
    stated = {name: getattr(options, name, None) for name in names}
    calls = {
        f"{arm}-{seed}": {"arm": arm, "seed": seed, "plan": stated, "files": paths}
        for arm in arms
        for seed in plan.seeds
    }
    out = options.out / "train"
    folders = map_jobs("rl.commands.ablate:train_one", calls, out, **where_jobs_run(options))
    return [folder / folder.name for folder in folders]


def train_one(
    folder: Path, *, arm: str, seed: int, plan: dict[str, Any], files: dict[str, str | None]
) -> None:
    """Train one arm with one seed, as a job of ``sim2real.executor``."""
    torch.set_num_threads(1)
    paths: dict[str, Any] = {name: path and Path(path) for name, path in files.items()}
    one = read_arm(arm, **paths)
    options = argparse.Namespace(**plan, first=None, seed=seed, seeds=1)
    train(folder, read_robot(paths["robot"]), [one], plan_of(options))


def read_arm(
    name: str, *, robot: Path, model: Path, ranges: Path, enriched: Path | None, reality: Path,
    truth: Path | None,
) -> Arm:  # fmt: skip
    """An arm from the files of the command."""
    found = None if enriched is None else read_model(enriched)
    true = read_model(truth or reality) if name == "ceiling" else None
    return arm_of(name, read_model(model), read_robot(robot), read_ranges(ranges), found, true)
