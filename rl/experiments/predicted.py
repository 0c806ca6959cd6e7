"""The forecast of an ablation: what each arm is expected to do in reality, and what it does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.experiments.arms import TITLES
from rl.forecast.realities import Realities
from rl.forecast.statistics import interval
from rl.forecast.swims import SimulationSettings, swim
from rl.task import Task
from sim2real.robot import Robot

Agents = dict[str, list[Callable[[int], Controller]]]
"""By the name of an arm, a function from a number of robots to a controller for each agent."""


def predict(
    arms: Agents,
    task: Task,
    file: Path,
    key: str,
    *,
    robot: Robot,
    realities: Realities,
    seed: int,
    trials: int = 2,
    settings: SimulationSettings,
) -> dict[str, Any]:
    """Forecast of every arm, the mean over its agents in each reality.

    Args:
        arms: The agents of each arm.
        task: The task.
        file: File of the trials so far, which are not run again if their key is the same.
        key: Digest of the agents.
        robot: The robot.
        realities: Draws of what the real robot may be.
        seed: Seed of starts, noise and disturbances.
        trials: Trials of each agent in each reality.
        settings: How they are simulated.

    Returns:
        By arm and figure its mean with a 90 % interval; ``loses`` is the reward of the arm "all"
        less that of the arm, in the same realities.
    """
    each = {f"{arm}-{k}": make for arm, of_arm in arms.items() for k, make in enumerate(of_arm)}
    inputs = (key, realities.digest(), robot, task.name, task.energy, task.steps, settings)
    predicted = swim(
        robot, task, realities, each, trials=trials, seed=seed, settings=settings,
        file=file, key=repr(inputs),
    )  # fmt: skip
    even = np.full(len(realities.models), 1 / len(realities.models))
    first, mean = 0, {}
    for arm, of_arm in arms.items():
        own = slice(first, first := first + len(of_arm))
        mean[arm] = {figure: x[own].mean(axis=0) for figure, x in predicted.figures.items()}
    out: dict[str, Any] = {
        arm: {figure: interval(x, even) for figure, x in of_arm.items()}
        for arm, of_arm in mean.items()
    }
    for arm in out.keys() - {"all"} if "all" in out else ():
        out[arm]["loses"] = interval(mean["all"]["reward"] - mean[arm]["reward"], even)
    return out


HEADER = ("arm", "reward, forecast", "reward, reality", "loses, forecast", "loses, reality")


def predicted_rows(results: Mapping[str, Any], table: list[dict[str, Any]]) -> list[list[str]]:
    """Cells under ``HEADER``, one row per arm; none without a forecast.

    Args:
        results: The results of ``ablate``.
        table: Its rows, as ``ablation_report.rows``.
    """
    rewards = {row["arm"]: row["reality"]["reward"] for row in table}
    out = []
    for arm, forecast in results.get("forecast", {}).items():
        lost = ["", ""]
        if "loses" in forecast:
            lost = [_ends(forecast["loses"]), f"{rewards['all'][0] - rewards[arm][0]:.1f}"]
        out.append([TITLES[arm], _ends(forecast["reward"]), _ends(rewards[arm]), *lost])
    return out


def _ends(values: tuple[float, float, float]) -> str:
    mean, low, high = values
    return f"{mean:.1f}\n{low:.1f} to {high:.1f}"
