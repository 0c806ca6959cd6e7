"""Which agent of a training to take: trials that none of them has seen, at one weight of energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.experiments.evaluate import summary
from rl.experiments.named import controller_of
from rl.experiments.trials import run_trials
from rl.task import TASKS
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

HELD_OUT = ("turn", "mixed")
"""Tasks of the trials; an agent's score is the mean of its rewards in them."""
SEED = 77_000


def held_out(
    folders: Sequence[Path],
    robot: Robot,
    model: Model,
    ranges: Ranges | None,
    *,
    energy: float,
    episodes: int = 20,
    **water: Any,  # noqa: ANN401 - those of ``run_trials``
) -> dict[str, Any]:
    """Let all agents swim the same randomized trials by their mean action.

    A training's own returns say little of this: there agents draw lots, at weights that grow.

    Args:
        folders: The agents'.
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: What robots and noise are drawn from.
        energy: Weight of energy, one for all.
        episodes: Of each agent and task.
        water: Fidelity, device, cell_m, threads.

    Returns:
        ``best``, the name of the folder of highest score, and by name ``score`` and each task's
        summary.
    """
    limits = [joint.limits_rad for joint in robot.joints]
    agents: dict[str, Any] = {folder.name: {} for folder in folders}
    for name in HELD_OUT:
        task = replace(TASKS[name], energy=energy)
        controllers = {
            folder.name: controller_of(str(folder / "policy.zip"), limits, episodes)
            for folder in folders
        }
        swum = run_trials(
            robot, model, ranges, task, controllers, episodes=episodes, seed=SEED, **water
        )
        for agent, one in swum.items():
            agents[agent][name] = summary(one, task)
    for rows in agents.values():
        rows["score"] = float(np.mean([rows[name]["reward"] for name in HELD_OUT]))
    best = max(agents, key=lambda agent: agents[agent]["score"])
    return {"best": best, "energy_weight": energy, "episodes": episodes, "agents": agents}
