"""The ablation: test the 180 degree turn of every arm's agents in simulation and in reality.

Every testbed writes a file to the folder of the run and is skipped if that file is of the same
policies and settings.

A folder of pretrained agents, small enough to ship, holds ``ARM-SEED/policy.npz`` of each (only its
policy, see ``rl.deploy.forward``), the ``model.json`` and ``ranges.json`` that they were trained
for, and ``agents.json``: the plan, the SHA-256 of every file and the provenance.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.deploy.controller import PolicyController
from rl.deploy.export import read_zip
from rl.deploy.forward import Policy, npz, read_npz
from rl.experiments.episodes import Episodes, measured
from rl.experiments.testbeds import Controllers, Testbed, same_starts
from rl.sac.train import Plan
from rl.task import TASKS, Task
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import Model, write_model
from sim2real.output import write_json, write_whole
from sim2real.ranges.entry import Ranges, write_ranges
from sim2real.robot import Robot
from sim2real.structured import Fields, read_json

LISTING = "agents.json"


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
        inputs = (weights, robot, testbed.key, task.energy, task.steps, repeats, seed, discount)
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


def read_pretrained(folder: Path, arms: Sequence[str]) -> tuple[list[Path], tuple[int, ...]]:
    """Folders of pretrained agents, all seeds of the first arm, then those of the next; the seeds.

    Raises:
        InputError: If an agent is missing, or its file differs from the listed one.
    """
    path = folder / LISTING
    if not path.is_file():
        raise InputError(path, "", "no such file", "pretrained agents")
    listing = Fields(path, "", read_json(path))
    listed, plan = listing.table("files"), listing.table("plan")
    seeds = plan.content.get("seeds")
    if not isinstance(seeds, list):
        raise plan.error("seeds", "those of a training")
    names = [f"{arm}-{seed}" for arm in arms for seed in seeds]
    for name in names:
        file = folder / name / "policy.npz"
        sha256 = listed.content.get(f"{name}/policy.npz")
        if sha256 is None or not file.is_file():
            raise InputError(file, "", "no such agent", f"one of {LISTING}")
        if _sha256(file) != sha256:
            raise InputError(file, "", "another file", f"the one listed in {LISTING}")
    return [folder / name for name in names], tuple(seeds)


def write_pretrained(
    folder: Path, agents: Sequence[Path], plan: Plan, model: Model, ranges: Ranges,
    note: dict[str, Any],
) -> Path:  # fmt: skip
    """Write the policies of trained agents, ``ARM-SEED`` each, and their listing.

    Agents already in the folder are removed. ``model`` and ``ranges`` are those of the training.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*/policy.npz"):
        shutil.rmtree(old.parent)
    write_model(model, folder / "model.json")
    write_ranges(ranges, folder / "ranges.json")
    for agent in agents:
        write_whole(folder / agent.name / "policy.npz", npz(policy_in(agent)))
    names = ["model.json", "ranges.json", *(f"{agent.name}/policy.npz" for agent in agents)]
    files = {name: _sha256(folder / name) for name in names}
    content = {"plan": plan.content(), "files": files, "provenance": note}
    return write_json(folder / LISTING, content)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
