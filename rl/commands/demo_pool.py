"""The pool's part of ``sim2real demo`` that a second process works on: body, ranges, agents."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from rl.commands.ablate import tried_in
from rl.experiments.ablation import ablate
from rl.experiments.arms import PAPER, arm_of
from rl.experiments.pretrained import Pretrained, drift, read_pretrained
from rl.sac.recipes import plan_of
from rl.sac.train import Plan, train_in_parts
from sim.calibration.swim_parameters import law_parameters, servo_parameters
from sim.calibration.twin_fit import Calibrated, calibrate
from sim.inference.swims import by_twin, swim_of
from sim2real.errors import InputError
from sim2real.model import Model, read_model
from sim2real.ranges.gather import Gathered, gather
from sim2real.recording import Recording, read_recording
from sim2real.robot import Robot, read_robot

SWIMS = ("p1", "p2")
"""Swims of the pool: the first is calibrated on, ranges take both."""
QUICK = plan_of({"recipe": "brief"}, fidelity="twin", threads=2)
"""What each arm of the ablation learns beyond the agents that all go on from."""
SEEDS, REPEATS = 8, 12
PRETRAINED = Path("agents") / "ablation"
"""Where in the pool's folder the ablation's agents are that were trained beforehand."""


@dataclass(frozen=True)
class Pool:
    """The shipped swims, their robot and its servos.

    Attributes:
        folder: Where they are.
        robot: The robot.
        model: Its servos, from a bench.
        recordings: ``SWIMS``.
    """

    folder: Path
    robot: Robot
    model: Model
    recordings: Sequence[Recording]

    @classmethod
    def of(cls, folder: Path) -> Pool:
        """Read the files of a folder."""
        recordings = [read_recording(folder / f"{name}.csv") for name in SWIMS]
        return cls(
            folder, read_robot(folder / "robot.toml"), read_model(folder / "model.json"), recordings
        )

    def calibrated(self) -> Calibrated:
        """The body in the twin, fitted to the first swim."""
        free = [*law_parameters(), *servo_parameters(self.model, self.robot)]
        swim = swim_of(self.recordings[0], self.robot)
        return calibrate([swim], self.model, free, by_twin(self.robot))

    def ranges(self, model: Model) -> Gathered:
        """What to randomize about a calibrated model."""
        return gather(self.recordings, self.robot, model)


@dataclass(frozen=True)
class Done:
    """What a stage has made.

    Attributes:
        value: Its result.
        seconds: How long it took.
    """

    value: Any
    seconds: float


def pool_work(folder: Path, out: Path, seed: int, repeats: int, train: bool) -> Iterator[Done]:
    """Calibration, ranges and, of agents trained beforehand, how they do in both testbeds.

    Args:
        folder: The pool's.
        out: The ablation's.
        seed: Of starts and noise.
        repeats: Turns of each agent in each testbed.
        train: Whether agents will be trained, which this process then leaves to another.

    Yields:
        The ``Calibrated`` and the drift of its model from that of the shipped agents (0 with
        ``train``), see ``pretrained.drift``; the ``Gathered``; and, without ``train``, what
        ``ablate`` tells.
    """
    torch.set_num_threads(1)
    begun = time.perf_counter()

    def done(value: Any) -> Done:  # noqa: ANN401 - a stage's result
        nonlocal begun
        before, begun = begun, time.perf_counter()
        return Done(value, begun - before)

    pool = Pool.of(folder)
    agents = None if train else read_pretrained(folder / PRETRAINED)
    fitted = pool.calibrated()
    yield done((fitted, 0.0 if agents is None else drifted(pool, fitted, agents)))
    found = pool.ranges(fitted.model)
    yield done(found)
    if agents is not None:
        yield done(compared(pool, fitted.model, found, out, seed, repeats, agents))


def drifted(pool: Pool, fitted: Calibrated, agents: Pretrained) -> float:
    """How far a calibration is from that which agents were trained for; see ``drift``."""
    swim = swim_of(pool.recordings[0], pool.robot)
    return drift(agents.model, fitted.model, swim, by_twin(pool.robot), fitted.rmse[1])


def compared(
    pool: Pool,
    model: Model,
    found: Gathered,
    out: Path,
    seed: int,
    repeats: int,
    agents: Pretrained | None = None,
    *,
    plan: Plan = QUICK,
    seeds: int = SEEDS,
) -> dict[str, Any]:
    """The ablation in the twin: what ``ablate`` tells of it.

    Args:
        pool: The robot, and what its reality is.
        model: The calibrated model.
        found: What is randomized about it.
        out: The ablation's folder.
        seed: Of starts and noise, and the first of the seeds where agents are trained.
        repeats: Turns of each agent in each testbed.
        agents: Those trained beforehand; trained now, in two processes, where None.
        plan: How agents are trained.
        seeds: How many of each arm are trained.
    """
    arms = [arm_of(name, model, pool.robot, found.ranges) for name in PAPER]
    own = agents.seeds if agents else tuple(range(seed, seed + seeds))
    plan = replace(plan, seeds=own)
    beds = tried_in(pool.robot, arms, plan, found.ranges, read_model(pool.folder / "reality.json"))
    trainer = agents.restore if agents else partial(train_in_parts, first=agents_in(pool.folder))
    return ablate(out, pool.robot, arms, plan, beds, seed=seed, repeats=repeats, trainer=trainer)


def agents_in(pool: Path) -> list[Path]:
    """The agents that arms go on from: they swim half way between no technique and all."""
    found = sorted((pool / "agents").glob("*.zip"))
    if not found:
        raise InputError(
            pool / "agents", "", "no agents", "NAME.zip files, such as of the arm midway"
        )
    return found
