"""Selection of the best agent of a training, by held-out trials at one weight of energy."""

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
    """Test all agents, with their mean actions, in the same randomized trials.

    Returns in training are no substitute: there actions are sampled and the energy weight grows.

    Args:
        folders: Folders of the agents.
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: Distributions of robots and noise.
        energy: Weight of energy, the same for all.
        episodes: Episodes of each agent and task.
        water: Fidelity, device, cell_m, threads.

    Returns:
        ``best``, the folder name of the agent with the highest score, and by name ``score`` and the
        summary of each task.
    """
    limits = [joint.limits_rad for joint in robot.joints]
    agents: dict[str, Any] = {folder.name: {} for folder in folders}
    for name in HELD_OUT:
        task = replace(TASKS[name], energy=energy)
        controllers = {
            folder.name: controller_of(str(folder / "policy.zip"), limits, episodes)
            for folder in folders
        }
        swims = run_trials(
            robot, model, ranges, task, controllers, episodes=episodes, seed=SEED, **water
        )
        for agent, episodes_of in swims.items():
            agents[agent][name] = summary(episodes_of, task)
    for rows in agents.values():
        rows["score"] = float(np.mean([rows[name]["reward"] for name in HELD_OUT]))
    best = max(agents, key=lambda agent: agents[agent]["score"])
    return {"best": best, "energy_weight": energy, "episodes": episodes, "agents": agents}
