"""Controllers side by side on the same trials: starts, targets and robots drawn once for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rl.controllers import Controller
from rl.experiments.evaluate import Episodes
from rl.experiments.real_episodes import same_starts
from rl.experiments.testbeds import Controllers, Simulated, some
from rl.make import Fidelity, draws_of
from rl.task import Task
from rl.world import Draws
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

UNSEEN = 10_000
"""Added to a seed: the robots of trials are none of those of training."""


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
    """Let every controller swim the same episodes, all of them in one batch.

    Args:
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: What robots and noise are drawn from; the model itself where None.
        task: The task.
        controllers: By name.
        episodes: Of each.
        seed: Of starts, robots and noise.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid.
        threads: CPU threads.
        options: Further ones of the simulator.

    Returns:
        Their episodes, by name.
    """
    drawn = draws_of(model, ranges, robot, seed=seed + UNSEEN, n=episodes)
    models = list(drawn.models) * (episodes if ranges is None else 1)
    own = [Draws((one,), drawn.noise) for one in models[:episodes]]
    starts = same_starts(task, len(controllers), episodes, seed, len(robot.joints))
    testbed = Simulated(
        task.name, own * len(controllers), fidelity, cell_m, options or {}, device, threads
    )
    several = Controllers(list(controllers.values()), episodes)
    swum = testbed.swim(several, robot, task, starts, seed)
    return {name: some(swum, several.own == k) for k, name in enumerate(controllers)}
