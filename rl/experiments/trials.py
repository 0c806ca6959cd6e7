"""Trials with the same starts, targets and robots for all controllers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rl.controllers import Controller
from rl.experiments.evaluate import Episodes
from rl.experiments.real_episodes import same_starts
from rl.experiments.testbeds import Controllers, Simulated, subset
from rl.make import Fidelity, draws_of
from rl.task import Task
from rl.world import Draws
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

UNSEEN = 10_000
"""Offset of the seed, so that trials do not use robots drawn in training."""


def run_trials(
    robot: Robot,
    model: Model,
    ranges: Ranges | None,
    task: Task,
    controllers: Mapping[str, Controller],
    *,
    episodes: int = 50,
    seed: int = 0,
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Episodes]:
    """Run the same episodes with every controller, in one batch.

    Args:
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: Distributions of robots and noise; if None, all robots are the model.
        task: The task.
        controllers: Controllers by name.
        episodes: Episodes of each controller.
        seed: Seed of starts, robots and noise.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid.
        threads: CPU threads.
        options: Further options of the simulator.

    Returns:
        Episodes by the name of the controller.
    """
    drawn = draws_of(model, ranges, robot, seed=seed + UNSEEN, n=episodes)
    models = list(drawn.models) * (episodes if ranges is None else 1)
    draws = [Draws((m,), drawn.noise) for m in models[:episodes]]
    starts = same_starts(task, len(controllers), episodes, seed, len(robot.joints))
    testbed = Simulated(
        task.name, draws * len(controllers), fidelity, cell_m, options or {}, device, threads
    )
    steering = Controllers(list(controllers.values()), episodes)
    swims = testbed.swim(steering, robot, task, starts, seed)
    return {name: subset(swims, steering.owner == k) for k, name in enumerate(controllers)}
