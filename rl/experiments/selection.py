"""Choice of each agent's price of energy, and of the best agent of a training, by trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.deploy.export import policy_of, set_price
from rl.deploy.policy import PolicyController
from rl.experiments.episodes import summary
from rl.experiments.named import controller_of
from rl.experiments.testbeds import IN_TWIN, SimulationSettings, run_trials
from rl.sac.sac import read_agent
from rl.task import TASKS
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

HELD_OUT = ("turn", "mixed")
"""Tasks of the trials; an agent's score is the mean of its rewards in them."""
EXPONENTS = (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)
"""Exponents of the prices tested: -1 is the lowest that an agent was trained for, 0 its default."""
PRICED = ("turn", "near")
SEED = 77_000
PRICE_SEED = 78_000


def held_out(
    folders: Sequence[Path],
    robot: Robot,
    model: Model,
    ranges: Ranges | None,
    *,
    energy: float,
    episodes: int = 20,
    settings: SimulationSettings = IN_TWIN,
) -> dict[str, Any]:
    """Test agents, with their mean actions, in the same randomized trials at one weight of energy.

    Returns in training are no substitute: there actions are sampled and the energy weight grows.

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
            robot, model, ranges, task, controllers, episodes=episodes, seed=SEED, settings=settings
        )
        for agent, episodes_of in swims.items():
            agents[agent][name] = summary(episodes_of, task)
    for rows in agents.values():
        rows["score"] = float(np.mean([rows[name]["reward"] for name in HELD_OUT]))
    best = max(agents, key=lambda agent: agents[agent]["score"])
    return {"best": best, "energy_weight": energy, "episodes": episodes, "agents": agents}


def choose_prices(
    folders: Sequence[Path],
    robot: Robot,
    model: Model,
    ranges: Ranges | None,
    *,
    episodes: int = 20,
    settings: SimulationSettings = IN_TWIN,
) -> dict[str, float]:
    """Set each agent's price of energy to the best one relative to proportional navigation.

    The reward hardly changes along an agent's trade-off of time and energy, so that agents with the
    same price swim at very different paces. The chosen price minimises the larger of the ratios of
    time and energy to those of proportional navigation at middle pace, over all tasks tested. The
    agents' ``policy.zip`` are rewritten.

    Returns:
        The price by the name of the folder, relative to that of the training.
    """
    agents: dict[Path, Any] = {folder: read_agent(folder / "policy.zip") for folder in folders}
    priced = {
        folder: agent
        for folder, agent in agents.items()
        if getattr(agent, "by_price", {}).get("column") is not None
    }
    policies: dict[str, Any] = {}
    for k, agent in enumerate(priced.values()):
        for exponent in EXPONENTS:
            set_price(agent, agent.by_price["prices"] ** exponent)
            policies[f"{k}@{exponent}"] = policy_of(agent)
    limits = [joint.limits_rad for joint in robot.joints]
    worst = np.zeros((len(priced), len(EXPONENTS)))
    for name in PRICED if priced else ():
        controllers: dict[str, Controller] = {
            key: PolicyController(policy) for key, policy in policies.items()
        }
        controllers["pnl"] = controller_of("pnl", limits, episodes)
        swims = run_trials(
            robot, model, ranges, TASKS[name], controllers, episodes=episodes, seed=PRICE_SEED,
            settings=settings,
        )  # fmt: skip
        rows = {key: summary(one, TASKS[name]) for key, one in swims.items()}
        for spent in ("time_s", "energy"):
            ratio = [rows[key][spent] / max(rows["pnl"][spent], 1e-9) for key in policies]
            worst = np.maximum(worst, np.reshape(ratio, worst.shape))
    chosen = {}
    for (folder, agent), row in zip(priced.items(), worst, strict=True):
        chosen[folder.name] = float(agent.by_price["prices"] ** EXPONENTS[int(np.argmin(row))])
        set_price(agent, chosen[folder.name])
        agent.save(folder / "policy.zip")
    return chosen
