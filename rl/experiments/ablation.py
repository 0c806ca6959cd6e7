"""The ablation: train every arm, test the 180 degree turn in simulation and in reality, compare.

Every stage writes a file to the folder of the run and is skipped if that file exists; training
resumes from its checkpoint.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.deploy.export import SampledController, read_zip
from rl.deploy.policy import Policy, PolicyController, read_npz
from rl.experiments.evaluate import Episodes, spent
from rl.experiments.predicted import Agents
from rl.experiments.real_episodes import same_starts
from rl.experiments.testbeds import Controllers, Testbed
from rl.sac.plan import Arm, Plan
from rl.sac.train import train
from rl.task import TASKS, Task
from sim2real.arrays import Array
from sim2real.output import write_json
from sim2real.robot import Robot
from sim2real.structured import read_json


def ablate(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    testbeds: Sequence[Testbed],
    *,
    repeats: int = 5,
    seed: int = 0,
    sampled: bool = False,
    longest: int | None = None,
    note: dict[str, Any] | None = None,
    trainer: Callable[..., list[Path]] | None = None,
    predictor: Callable[[Agents, Task, Path, str], dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Train and test all arms.

    Args:
        folder: Folder of the run.
        robot: Links, joints and data sheets.
        arms: The simulator that each group of agents trains in.
        plan: Plan of the training.
        testbeds: Where the policies are tested.
        repeats: Episodes of each agent and testbed.
        seed: Seed of starts and noise.
        sampled: Whether actions are sampled from the policy, as in training.
        longest: Maximum length of a trial in control periods; default: that of the task.
        note: Provenance.
        trainer: Training function with the arguments of ``rl.sac.train.train``, the default.
        predictor: Forecast of the arms' agents at a task: ``rl.experiments.predicted.predict``
            with its other arguments.

    Returns:
        ``agents``: for each, its arm, seed and, by testbed, return (the rewards discounted as in
        training), reward, success, time and energy of each repeat; ``forecast`` with a predictor.
    """
    trainer = trainer or train
    agents = trainer(folder / "train", robot, arms, plan, note)
    turn = TASKS["turn"]
    task = replace(turn, energy=plan.task.energy, steps=longest or turn.steps)

    def controller(k: int, _n: int = 0) -> Controller:
        if sampled:
            return SampledController(agents[k] / "policy.zip", seed=k)
        return PolicyController(policy_in(agents[k]))

    results: dict[str, Any] = {}
    discount = plan.settings.gamma ** (1 / plan.view.period)
    for testbed in testbeds:
        path = folder / f"{testbed.name}.json"
        digest = inputs_digest(agents, robot, testbed, task, (repeats, seed, sampled, discount))
        result = read_json(path) if path.exists() else {}
        if result.get("key") != digest:
            policies = [controller(k) for k in range(len(agents))]
            starts = same_starts(task, len(agents), repeats, seed, len(robot.joints))
            episodes = testbed.swim(Controllers(policies, repeats), robot, task, starts, seed)
            result = {"key": digest, **as_json(episodes, len(agents), task, discount)}
            write_json(path, result)
        results[testbed.name] = result
    names = [(arm.name, s) for arm in arms for s in plan.seeds]
    forecast = {}
    if predictor is not None:
        made: Agents = {arm.name: [] for arm in arms}
        for k, (arm_name, _) in enumerate(names):
            made[arm_name].append(partial(controller, k))
        key = repr((weights_digest(agents).hexdigest(), sampled))
        forecast = {"forecast": predictor(made, task, folder / "forecast.npz", key)}
    return {
        **forecast,
        "repeats": repeats,
        "testbeds": [testbed.name for testbed in testbeds],
        "said": {testbed.name: testbed.description for testbed in testbeds},
        "agents": [
            {"arm": arm, "seed": s, "folder": agents[a].name}
            | {testbed: results[testbed]["agents"][a] for testbed in results}
            for a, (arm, s) in enumerate(names)
        ],
        "targets": {testbed: results[testbed]["targets"] for testbed in results},
    }


def policy_in(agent: Path) -> Policy:
    """The policy in the folder of an agent: ``policy.npz`` if it exists, else ``policy.zip``."""
    small = agent / "policy.npz"
    return read_npz(small) if small.exists() else read_zip(agent / "policy.zip")


def weights_digest(agents: Sequence[Path]) -> hashlib._Hash:
    """SHA-256 of the policies in the folders of agents."""
    digest = hashlib.sha256()
    for agent in agents:
        digest.update(repr([layer.tobytes() for layer in policy_in(agent).weights]).encode())
    return digest


def inputs_digest(
    agents: Sequence[Path],
    robot: Robot,
    testbed: Testbed,
    task: Task,
    settings: tuple[int, int, bool, float],
) -> str:
    """SHA-256 of all inputs of a test: policies, robot, testbed, reward, starts.

    Args:
        agents: Folders.
        robot: The robot.
        testbed: The testbed.
        task: The task.
        settings: Repeats, seed, whether actions are sampled, discount per control period.
    """
    digest = weights_digest(agents)
    digest.update(repr((robot, testbed.key(), task.energy, task.steps, settings)).encode())
    return digest.hexdigest()


def as_json(episodes: Episodes, A: int, task: Task, discount: float) -> dict[str, Any]:
    """Episodes of A agents as JSON values; time and energy as in ``evaluate.spent``."""
    time, energy = spent(episodes, task)
    returns = episodes.discounted(discount)
    rows_of = np.arange(len(energy)).reshape(A, -1)

    def numbers(values: Array) -> list[float | None]:
        return [round(float(x), 6) if np.isfinite(x) else None for x in values]

    agents = [
        {
            "return": numbers(returns[rows]),
            "reward": numbers(episodes.reward[rows]),
            "success": [bool(x) for x in episodes.success[rows]],
            "time_s": numbers(time[rows]),
            "energy": numbers(energy[rows]),
            "faced_s": numbers(episodes.faced_s()[rows]),
            "path": [
                [numbers(point) for point in episodes.pose[::5, e, :2] if np.isfinite(point).all()]
                for e in rows[:2]
            ],
        }
        for rows in rows_of
    ]
    return {"agents": agents, "targets": episodes.targets[rows_of[0], 0].tolist()}


def bootstrap(
    values: Sequence[Sequence[float]], rng: np.random.Generator, draws: int = 4000
) -> tuple[float, float, float]:
    """Mean with a 90 % bootstrap interval; agents are resampled, then their repeats.

    Args:
        values: One list of repeats for each agent.
        rng: Random number generator.
        draws: Number of resamples.
    """
    table = np.array(values, dtype=np.float64)
    A, R = table.shape
    agents = rng.integers(A, size=(draws, A))
    repeats = rng.integers(R, size=(draws, A, R))
    means = table[agents[:, :, None], repeats].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.05, 0.95])
    return float(table.mean()), float(low), float(high)
