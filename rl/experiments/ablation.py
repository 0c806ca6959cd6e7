"""The ablation: train every arm, swim the 180 degree turn in simulation and in reality, compare.

Every stage leaves a file in the run's folder and is not done again where that is there; training
goes on from its checkpoint.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rl.deploy.controller import PolicyController
from rl.deploy.export import read_zip
from rl.deploy.forward import Policy, read_npz
from rl.experiments.evaluate import Episodes, spent
from rl.experiments.real_episodes import same_starts
from rl.experiments.testbeds import Controllers, Testbed
from rl.sac.sampled import SampledController
from rl.sac.train import Arm, Plan, train
from rl.task import TASKS, Task
from sim2real.output import write_json
from sim2real.robot import Robot

Array = NDArray[np.float64]


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
) -> dict[str, Any]:
    """Train and try all arms.

    Args:
        folder: The run's.
        robot: Links, joints and data sheets.
        arms: What each group of agents trains in.
        plan: How to train.
        testbeds: Where to try the policies.
        repeats: Episodes of each agent and testbed.
        seed: Of starts and noise.
        sampled: Whether policies act as in training, with their own noise.
        longest: Control periods of a trial at most; the task's own where None.
        note: Provenance.
        trainer: What trains, called as ``rl.sac.train.train``, which it is where None.

    Returns:
        ``agents``: for each, its arm, seed and, by testbed, return (the rewards discounted as in
        training), reward, success, time and energy of each repeat.
    """
    trainer = trainer or train
    agents = trainer(folder / "train", robot, arms, plan, note)
    turn = TASKS["turn"]
    task = replace(turn, energy=plan.task.energy, steps=longest or turn.steps)
    found: dict[str, Any] = {}
    discount = plan.settings.gamma ** (1 / plan.view.period)
    for testbed in testbeds:
        path = folder / f"{testbed.name}.json"
        asked = key(agents, robot, testbed, task, (repeats, seed, sampled, discount))
        known = json.loads(path.read_text()) if path.exists() else {}
        if known.get("key") != asked:
            policies = [
                SampledController(agent / "policy.zip", seed=k)
                if sampled
                else PolicyController(policy_in(agent))
                for k, agent in enumerate(agents)
            ]
            starts = same_starts(task, len(agents), repeats, seed, len(robot.joints))
            episodes = testbed.swim(Controllers(policies, repeats), robot, task, starts, seed)
            known = {"key": asked, **told(episodes, len(agents), task, discount)}
            write_json(path, known)
        found[testbed.name] = known
    names = [(arm.name, s) for arm in arms for s in plan.seeds]
    return {
        "repeats": repeats,
        "testbeds": [testbed.name for testbed in testbeds],
        "said": {testbed.name: testbed.said for testbed in testbeds},
        "agents": [
            {"arm": arm, "seed": s, "folder": agents[a].name}
            | {testbed: found[testbed]["agents"][a] for testbed in found}
            for a, (arm, s) in enumerate(names)
        ],
        "targets": {testbed: found[testbed]["targets"] for testbed in found},
    }


def policy_in(agent: Path) -> Policy:
    """What is left of an agent in its folder: ``policy.npz``, or else ``policy.zip``."""
    alone = agent / "policy.npz"
    return read_npz(alone) if alone.exists() else read_zip(agent / "policy.zip")


def key(
    agents: Sequence[Path],
    robot: Robot,
    testbed: Testbed,
    task: Task,
    how: tuple[int, int, bool, float],
) -> str:
    """SHA-256 of what decides how agents do in a testbed: policies, robot, testbed, reward, starts.

    Args:
        agents: Folders.
        robot: The robot.
        testbed: The testbed.
        task: The task.
        how: Repeats, seed, whether policies act with noise, discount of a control period.
    """
    whole = hashlib.sha256()
    for agent in agents:
        whole.update(repr([layer.tobytes() for layer in policy_in(agent).weights]).encode())
    whole.update(repr((robot, testbed.key(), task.energy, task.steps, how)).encode())
    return whole.hexdigest()


def told(episodes: Episodes, A: int, task: Task, discount: float) -> dict[str, Any]:
    """Episodes of A agents as JSON keeps them; time and energy as ``evaluate.spent`` has them."""
    time, used = spent(episodes, task)
    returned = episodes.discounted(discount)
    own = np.arange(len(used)).reshape(A, -1)

    def numbers(values: Array) -> list[float | None]:
        return [round(float(x), 6) if np.isfinite(x) else None for x in values]

    agents = [
        {
            "return": numbers(returned[rows]),
            "reward": numbers(episodes.reward[rows]),
            "success": [bool(x) for x in episodes.success[rows]],
            "time_s": numbers(time[rows]),
            "energy": numbers(used[rows]),
            "faced_s": numbers(episodes.faced_s()[rows]),
            "path": [
                [numbers(point) for point in episodes.pose[::5, e, :2] if np.isfinite(point).all()]
                for e in rows[:2]
            ],
        }
        for rows in own
    ]
    return {"agents": agents, "targets": episodes.targets[own[0], 0].tolist()}


def bootstrap(
    values: Sequence[Sequence[float]], rng: np.random.Generator, draws: int = 4000
) -> tuple[float, float, float]:
    """Mean and its 90 % interval over agents and their repeats, resampled in this order.

    Args:
        values: One list of repeats for each agent.
        rng: Random numbers.
        draws: Resamples.
    """
    table = np.array(values, dtype=np.float64)
    A, R = table.shape
    agents = rng.integers(A, size=(draws, A))
    repeats = rng.integers(R, size=(draws, A, R))
    means = table[agents[:, :, None], repeats].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.05, 0.95])
    return float(table.mean()), float(low), float(high)
