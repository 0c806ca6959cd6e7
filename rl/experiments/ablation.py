"""The ablation: test the 180 degree turn of every arm's agents in simulation and in reality.

Every testbed writes a file to the folder of the run and is skipped if that file is of the same
policies and settings.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.deploy.controller import PolicyController
from rl.deploy.export import read_zip
from rl.deploy.forward import Policy, read_npz
from rl.experiments.episodes import Episodes, measured
from rl.experiments.testbeds import Controllers, Testbed, same_starts
from rl.sac.train import Plan
from rl.task import TASKS, Task
from sim2real.arrays import Array
from sim2real.output import write_json
from sim2real.robot import Robot
from sim2real.structured import read_json


def turn_of(plan: Plan, longest: int | None = None) -> Task:
    """The turn that agents of a plan are tested in, of ``longest`` control periods if given."""
    turn = TASKS["turn"]
    return replace(turn, energy=plan.task.energy, steps=longest or turn.steps)


def ablate(
    folder: Path,
    robot: Robot,
    arms: Sequence[str],
    agents: Sequence[Path],
    plan: Plan,
    testbeds: Sequence[Testbed],
    *,
    repeats: int = 5,
    seed: int = 0,
    longest: int | None = None,
) -> dict[str, Any]:
    """Test the agents of all arms.

    Args:
        folder: Folder of the run.
        robot: Links, joints and data sheets.
        arms: Names of the arms.
        agents: Folders of the agents: all seeds of the first arm, then those of the next.
        plan: Plan of their training.
        testbeds: Where the policies are tested.
        repeats: Episodes of each agent and testbed.
        seed: Seed of starts and noise.
        longest: Maximum length of a trial in control periods; default: that of the task.

    Returns:
        ``agents``: for each, its arm, seed and, by testbed, return (the rewards discounted as in
        training), reward, success, time and energy of each repeat.
    """
    task = turn_of(plan, longest)
    results: dict[str, Any] = {}
    discount = plan.settings.gamma ** (1 / plan.view.period)
    weights = weights_digest(agents)
    for testbed in testbeds:
        path = folder / f"{testbed.name}.json"
        inputs = (weights, robot, testbed.key(), task.energy, task.steps, repeats, seed, discount)
        key = hashlib.sha256(repr(inputs).encode()).hexdigest()
        result = read_json(path) if path.exists() else {}
        if result.get("key") != key:
            policies = [PolicyController(policy_in(agent)) for agent in agents]
            starts = same_starts(task, len(agents), repeats, seed, len(robot.joints))
            episodes = testbed.swim(Controllers(policies, repeats), robot, task, starts, seed)
            result = {"key": key, **as_json(episodes, len(agents), task, discount)}
            write_json(path, result)
        results[testbed.name] = result
    names = [(arm, s) for arm in arms for s in plan.seeds]
    return {
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


def weights_digest(agents: Sequence[Path]) -> str:
    """SHA-256 of the policies in the folders of agents."""
    digest = hashlib.sha256()
    for agent in agents:
        digest.update(repr([layer.tobytes() for layer in policy_in(agent).weights]).encode())
    return digest.hexdigest()


def as_json(episodes: Episodes, A: int, task: Task, discount: float) -> dict[str, Any]:
    """Episodes of A agents as JSON values; time and energy as in ``episodes.spent``."""
    figures = measured(episodes, task)
    columns = {
        "return": episodes.discounted(discount),
        **{name: figures[name] for name in ("reward", "time_s", "energy")},
        "faced_s": episodes.faced_s(),
    }
    rows_of = np.arange(len(episodes.reached)).reshape(A, -1)

    def numbers(values: Array) -> list[float | None]:
        return [round(float(x), 6) if np.isfinite(x) else None for x in values]

    agents = [
        {
            **{name: numbers(values[rows]) for name, values in columns.items()},
            "success": [bool(x) for x in episodes.success[rows]],
            "path": [
                [numbers(point) for point in episodes.pose[::5, e, :2] if np.isfinite(point).all()]
                for e in rows[:2]
            ],
        }
        for rows in rows_of
    ]
    return {"agents": agents, "targets": episodes.targets[rows_of[0], 0].tolist()}
