"""The stages of ``sim2real demo`` in the pool, which run in a second process: body, ranges, agents.

The swim is diagnosed before the body is calibrated: without an effect that the robot has, the other
parameters take values that fit its recording and no other motion.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rl.commands.ablate import make_testbeds
from rl.experiments.ablation import PAPER, ablate, arm_of, read_pretrained
from rl.sac.plan import plan_of
from rl.sac.train import train_in_parts
from sim.inference.calibration import Calibration, calibrate
from sim.inference.coordinates import twin_parameters
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.swims import by_followed_twin, by_twin, swim_of
from sim2real.diagnose.result import Diagnosis
from sim2real.errors import InputError
from sim2real.model import Model, read_model
from sim2real.ranges.entry import Ranges
from sim2real.ranges.gather import Gathered, gather
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot

SWIM = "p1"
"""The swim of the pool that is diagnosed, calibrated and gives the ranges."""
QUICK = plan_of({"recipe": "brief"}, fidelity="twin", threads=2)
"""Plan of the training of each arm, which continues from agents that all arms share."""
SEEDS, REPEATS = 5, 12
PRETRAINED = Path("agents") / "ablation"
"""Folder of the pretrained agents of the ablation, relative to that of the pool."""


@dataclass(frozen=True)
class Pool:
    """What the stages found."""

    diagnosis: Diagnosis  # what the model of the body leaves out of the swim
    calibration: Calibration  # the body in the twin, fitted to the swim, with the effects found
    gathered: Gathered  # randomization ranges for the calibrated model
    results: dict[str, Any]  # of the ablation of the pretrained agents; empty if not tested
    seconds: tuple[float, ...]  # how long each stage took


def stages(folder: Path, out: Path, seed: int, tested: bool) -> Pool:
    """Diagnose, calibrate and derive ranges, and if ``tested`` evaluate the pretrained agents."""
    times = [time.perf_counter()]
    robot, servos = robot_in(folder), read_model(folder / "model.json")
    recording = read_recording(folder / f"{SWIM}.csv")
    swim = swim_of(recording, robot)
    missing = diagnose_swims([swim], servos, robot, by_followed_twin(robot))
    times.append(time.perf_counter())
    free = twin_parameters(missing.model, robot)
    twin = by_twin(robot)
    fitted = calibrate([swim], missing.model, free, twin)
    times.append(time.perf_counter())
    gathered = gather([recording], robot, fitted.model)
    times.append(time.perf_counter())
    results = {}
    if tested:
        results = ablated(folder, out, seed, fitted.model, gathered.ranges, pretrained=True)
    times.append(time.perf_counter())
    seconds = tuple(b - a for a, b in zip(times, times[1:], strict=False))
    calibration = Calibration(fitted.model, servos, robot, (swim,), twin, fitted)
    return Pool(missing, calibration, gathered, results, seconds)


def robot_in(folder: Path) -> Robot:
    """The robot of a pool."""
    return read_robot(folder / "robot.toml")


def ablated(
    folder: Path, out: Path, seed: int, model: Model, ranges: Ranges, *, pretrained: bool
) -> dict[str, Any]:
    """Result of ``ablate`` in the twin; ``seed`` is that of starts, noise and the first agent."""
    robot = robot_in(folder)
    arms = [arm_of(name, model, robot, ranges) for name in PAPER]
    if pretrained:
        agents, seeds = read_pretrained(folder / PRETRAINED, PAPER)
        plan = replace(QUICK, seeds=seeds)
    else:
        plan = replace(QUICK, seeds=tuple(range(seed, seed + SEEDS)))
        agents = train_in_parts(out / "train", robot, arms, plan, first=agents_in(folder))
    testbeds = make_testbeds(robot, arms, plan, ranges, read_model(folder / "reality.json"))
    return ablate(out, robot, PAPER, agents, plan, testbeds, seed=seed, repeats=REPEATS)


def agents_in(folder: Path) -> list[Path]:
    """The agents that arms start from, trained with no technique."""
    files = sorted((folder / "agents").glob("*.zip"))
    if not files:
        expected = "NAME.zip files, such as of the arm none"
        raise InputError(folder / "agents", "", "no agents", expected)
    return files
