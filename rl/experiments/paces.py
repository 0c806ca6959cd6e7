"""At which price of energy a policy swims: chosen after its training, by trials."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.deploy.controller import PolicyController
from rl.deploy.export import policy_of, read_agent, set_price
from rl.experiments.evaluate import summary
from rl.experiments.named import controller_of
from rl.experiments.trials import run_trials
from rl.task import TASKS
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

EXPONENTS = (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)
"""Of the prices tried: the lowest that an agent learned for at -1, its own at 0."""
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
    """Put each agent at the price at which it does best beside proportional navigation.

    The reward hardly changes along an agent's curve of time against energy, so that agents of
    one price end at paces far apart. Taken is the price at which the larger of an agent's time and
    energy, over those of proportional navigation's middle pace and over all tasks tried, is least.

    Args:
        folders: The agents'; their ``policy.zip`` are written anew.
        robot: Links, joints and data sheets.
        model: The calibrated model.
        ranges: What robots and noise are drawn from.
        episodes: Of each agent, price and task.
        device: ``cpu`` or ``cuda:0``.
        water: Fidelity, cell_m, threads.

    Returns:
        For each folder's name the price, over the training's own.
    """
    agents: dict[Path, Any] = {folder: read_agent(folder / "policy.zip") for folder in folders}
    known = {
        folder: agent
        for folder, agent in agents.items()
        if getattr(agent, "by_price", {}).get("column") is not None
    }
    if not known:
        return {}
    limits = [joint.limits_rad for joint in robot.joints]
    policies: dict[str, Any] = {}
    for k, agent in enumerate(known.values()):
        for one in EXPONENTS:
            set_price(agent, agent.by_price["prices"] ** one)
            policies[f"{k}@{one}"] = policy_of(agent)
    worst = np.zeros((len(known), len(EXPONENTS)))
    for name in TRIED_ON:
        controllers: dict[str, Controller] = {
            key: PolicyController(one) for key, one in policies.items()
        }
        controllers["pnl"] = controller_of("pnl", limits, episodes)
        swum = run_trials(
            robot, model, ranges, TASKS[name], controllers, episodes=episodes, seed=SEED,
            device=device, **water,
        )  # fmt: skip
        told = {key: summary(one, TASKS[name]) for key, one in swum.items()}
        worst = np.maximum(worst, [
            [_ratio(told[f"{k}@{one}"], told["pnl"]) for one in EXPONENTS]
            for k in range(len(known))
        ])  # fmt: skip
    chosen = {}
    for (folder, agent), row in zip(known.items(), worst, strict=True):
        chosen[folder.name] = float(agent.by_price["prices"] ** EXPONENTS[int(np.argmin(row))])
        set_price(agent, chosen[folder.name])
        agent.save(folder / ".policy.zip")
        os.replace(folder / ".policy.zip", folder / "policy.zip")
    return chosen


def _ratio(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    return max(one[key] / max(other[key], 1e-9) for key in ("time_s", "energy"))
