"""The part of ``sim2real demo`` that runs in a second process: body, ranges, agents.

The swim is diagnosed before the body is calibrated: without an effect that the robot has, the other
parameters take values that fit its recording and no other motion.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch

from rl.commands.ablate import make_testbeds
from rl.experiments.ablation import ablate
from rl.experiments.arms import PAPER, arm_of
from rl.experiments.pretrained import Pretrained, drift, read_pretrained
from rl.sac.recipes import plan_of
from rl.sac.train import Plan, train_in_parts
from sim.inference.calibration import Calibrated, calibrate
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.swim_parameters import twin_parameters
from sim.inference.swims import Swim, by_followed_twin, by_twin, swim_of
from sim2real.diagnose.result import Diagnosis
from sim2real.errors import InputError
from sim2real.model import Model, read_model
from sim2real.ranges.gather import Gathered, gather
from sim2real.recording import Recording, read_recording
from sim2real.robot import Robot, read_robot

SWIM = "p1"
"""The swim of the pool that is diagnosed, calibrated and gives the ranges."""
QUICK = plan_of({"recipe": "brief"}, fidelity="twin", threads=2)
"""Plan of the training of each arm, which continues from agents that all arms share."""
SEEDS, REPEATS = 8, 12
PRETRAINED = Path("agents") / "ablation"
"""Folder of the pretrained agents of the ablation, relative to that of the pool."""


@dataclass(frozen=True)
class Pool:
    """A shipped swim, its robot and its servos.

    Attributes:
        folder: Where they are.
        robot: The robot.
        model: Its servos, from a bench.
        recording: That of ``SWIM``.
    """

    folder: Path
    robot: Robot
    model: Model
    recording: Recording

    @classmethod
    def of(cls, folder: Path) -> Pool:
        """Read the files of a folder."""
        return cls(
            folder,
            read_robot(folder / "robot.toml"),
            read_model(folder / "model.json"),
            read_recording(folder / f"{SWIM}.csv"),
        )

    @cached_property
    def swim(self) -> Swim:
        """The recording as a swim."""
        return swim_of(self.recording, self.robot)

    def diagnosis(self) -> Diagnosis:
        """What the model of the body leaves out."""
        return diagnose_swims([self.swim], self.model, self.robot, by_followed_twin(self.robot))

    def calibrated(self, model: Model) -> Calibrated:
        """The body in the twin, fitted to the swim, with the effects of ``model``."""
        free = twin_parameters(model, self.robot)
        return calibrate([self.swim], model, free, by_twin(self.robot))

    def ranges(self, model: Model) -> Gathered:
        """Randomization ranges for a calibrated model."""
        return gather([self.recording], self.robot, model)


@dataclass(frozen=True)
class Done:
    """Result of a stage.

    Attributes:
        value: Its result.
        seconds: How long it took.
    """

    value: Any
    seconds: float


def pool_work(folder: Path, out: Path, seed: int, repeats: int, train: bool) -> Iterator[Done]:
    """Diagnosis, calibration, ranges, the evaluation of the pretrained agents in both testbeds.

    Args:
        folder: Folder of the pool.
        out: Folder of the ablation.
        seed: Seed of starts and noise.
        repeats: Turns of each agent in each testbed.
        train: Whether agents will be trained, which the calling process does.

    Yields:
        The ``Diagnosis``; the ``Calibrated`` and the drift of its model from that of the shipped
        agents (0 with ``train``), see ``pretrained.drift``; the ``Gathered``; and, without
        ``train``, the result of ``ablate``.
    """
    torch.set_num_threads(1)
    start = time.perf_counter()

    def done(value: Any) -> Done:  # noqa: ANN401 - a stage's result
        nonlocal start
        before, start = start, time.perf_counter()
        return Done(value, start - before)

    pool = Pool.of(folder)
    agents = None if train else read_pretrained(folder / PRETRAINED)
    missing = pool.diagnosis()
    yield done(missing)
    fitted = pool.calibrated(missing.model)
    yield done((fitted, 0.0 if agents is None else calibration_drift(pool, fitted, agents)))
    gathered = pool.ranges(fitted.model)
    yield done(gathered)
    if agents is not None:
        yield done(run_ablation(pool, fitted.model, gathered, out, seed, repeats, agents))


def calibration_drift(pool: Pool, fitted: Calibrated, agents: Pretrained) -> float:
    """Difference of a calibration from the one that agents were trained for; see ``drift``."""
    return drift(agents.model, fitted.model, pool.swim, by_twin(pool.robot), fitted.rmse[1])


def run_ablation(
    pool: Pool,
    model: Model,
    gathered: Gathered,
    out: Path,
    seed: int,
    repeats: int,
    agents: Pretrained | None = None,
    *,
    plan: Plan = QUICK,
    seeds: int = SEEDS,
) -> dict[str, Any]:
    """Result of ``ablate`` in the twin.

    Args:
        pool: The robot and its reality.
        model: The calibrated model.
        gathered: Randomization ranges of the model.
        out: Folder of the ablation.
        seed: Seed of starts and noise, and the first seed of agents that are trained.
        repeats: Turns of each agent in each testbed.
        agents: Pretrained agents; if None, agents are trained in two processes.
        plan: Plan of the training.
        seeds: Number of agents of each arm that are trained.
    """
    arms = [arm_of(name, model, pool.robot, gathered.ranges) for name in PAPER]
    agent_seeds = agents.seeds if agents else tuple(range(seed, seed + seeds))
    plan = replace(plan, seeds=agent_seeds)
    testbeds = make_testbeds(
        pool.robot, arms, plan, gathered.ranges, read_model(pool.folder / "reality.json")
    )
    trainer = agents.restore if agents else partial(train_in_parts, first=agents_in(pool.folder))
    return ablate(
        out, pool.robot, arms, plan, testbeds, seed=seed, repeats=repeats, trainer=trainer
    )


def agents_in(pool: Path) -> list[Path]:
    """The agents that arms start from, trained half way between no technique and all."""
    files = sorted((pool / "agents").glob("*.zip"))
    if not files:
        raise InputError(
            pool / "agents", "", "no agents", "NAME.zip files, such as of the arm midway"
        )
    return files
