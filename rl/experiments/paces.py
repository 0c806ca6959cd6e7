"""Choice of each policy's price of energy after training, by trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.deploy.export import policy_of, set_price
from rl.deploy.policy import PolicyController
from rl.experiments.evaluate import summary
from rl.experiments.named import controller_of
from rl.experiments.trials import run_trials
from rl.sac.sac import read_agent
from rl.task import TASKS
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

EXPONENTS = (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)
"""Exponents of the prices tested: -1 is the lowest that an agent was trained for, 0 its default."""
TRIED_ON = ("turn", "near")
SEED = 78_000


def choose_prices(
    folders: Sequence[Path],
    robot: Robot,
    model: Model,
    ranges: Ranges | None,
    *,
    episodes: int = 20,
    device: str = "cpu",
    **water: Any,  # noqa: ANN401 - those of ``run_trials``
) -> dict[str, float]:
    """Set each agent's price of energy to the best one relative to proportional navigation.

    The reward hardly changes along an agent's trade-off of time and energy, so that agents with the
    same price swim at very different paces. The chosen price minimises the larger of the ratios of
    time and energy to those of proportional navigation at middle pace, over all tasks tested.

    Args:
        folders: Folders of the agents; their ``policy.zip`` are rewritten.
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: Distributions of robots and noise.
        episodes: Episodes of each agent, price and task.
        device: ``cpu`` or ``cuda:0``.
        water: Fidelity, cell_m, threads.

    Returns:
        The price by the name of the folder, relative to that of the training.
    """
    agents: dict[Path, Any] = {folder: read_agent(folder / "policy.zip") for folder in folders}
    priced = {
        folder: agent
        for folder, agent in agents.items()
        if getattr(agent, "by_price", {}).get("column") is not None
    }
    if not priced:
        return {}
    limits = [joint.limits_rad for joint in robot.joints]
    policies: dict[str, Any] = {}
    for k, agent in enumerate(priced.values()):
        for exponent in EXPONENTS:
            set_price(agent, agent.by_price["prices"] ** exponent)
            policies[f"{k}@{exponent}"] = policy_of(agent)
    worst = np.zeros((len(priced), len(EXPONENTS)))
    for name in TRIED_ON:
        controllers: dict[str, Controller] = {
            key: PolicyController(policy) for key, policy in policies.items()
        }
        controllers["pnl"] = controller_of("pnl", limits, episodes)
        episodes_of = run_trials(
            robot, model, ranges, TASKS[name], controllers, episodes=episodes, seed=SEED,
            device=device, **water,
        )  # fmt: skip
        summaries = {key: summary(swims, TASKS[name]) for key, swims in episodes_of.items()}
        worst = np.maximum(worst, [
            [_ratio(summaries[f"{k}@{x}"], summaries["pnl"]) for x in EXPONENTS]
            for k in range(len(priced))
        ])  # fmt: skip
    chosen = {}
    for (folder, agent), row in zip(priced.items(), worst, strict=True):
        chosen[folder.name] = float(agent.by_price["prices"] ** EXPONENTS[int(np.argmin(row))])
        set_price(agent, chosen[folder.name])
        agent.save(folder / "policy.zip")
    return chosen


def _ratio(agent: Mapping[str, float], baseline: Mapping[str, float]) -> float:
    return max(agent[key] / max(baseline[key], 1e-9) for key in ("time_s", "energy"))
