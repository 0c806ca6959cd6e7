"""The ablation: train every arm, swim the 180 degree turn in simulation and in reality, compare.

Every stage leaves a file in the run's folder and is not done again where that is there; training
goes on from its checkpoint.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rl.controllers import Controller
from rl.evaluate import Episodes, PolicyController, run_episodes
from rl.export import read_zip
from rl.metrics import energy
from rl.pool import Fidelity, make_world, own_stream
from rl.task import TASKS, Task
from rl.train import Arm, Plan, digest, train
from rl.world import Draws
from sim2real.output import write_json
from sim2real.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where policies are tried.

    Attributes:
        name: ``simulation`` or ``reality``.
        draws: Robot and noise of each agent, in the agents' order.
        fidelity: ``twin`` or ``fluid``.
        cell_m: Side of a cell of the fluid.
        options: Further options of the simulator.
    """

    name: str
    draws: Sequence[Draws]
    fidelity: Fidelity
    cell_m: float
    options: Mapping[str, Any]


class Blocks:
    """Several controllers, each steering its block of the environments."""

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self.controllers = list(controllers)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Each begins anew where its robots do."""
        for one, part in zip(self.controllers, np.split(mask, len(self.controllers)), strict=True):
            one.reset(part)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Each for its own block."""
        parts = np.split(observation, len(self.controllers))
        return np.concatenate(
            [one.act(part) for one, part in zip(self.controllers, parts, strict=True)]
        )


def ablate(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    places: Sequence[Place],
    *,
    repeats: int = 5,
    seed: int = 0,
    note: dict[str, Any] | None = None,
    trainer: Callable[..., list[Path]] | None = None,
) -> dict[str, Any]:
    """Train and try all arms.

    Args:
        folder: The run's.
        robot: Links, joints and data sheets.
        arms: What each group of agents trains in.
        plan: How to train.
        places: Where to try the policies.
        repeats: Episodes of each agent and place.
        seed: Of starts and noise.
        note: Provenance.
        trainer: What trains, called as ``rl.train.train``, which it is where None.

    Returns:
        ``agents``: for each, its arm, seed and, by place, reward, success, time and energy of each
        repeat.
    """
    trainer = trainer or train
    agents = trainer(folder / "train", robot, arms, plan, note)
    task = TASKS["turn"]
    found: dict[str, Any] = {}
    for place in places:
        path = folder / f"{place.name}.json"
        asked = key(agents, place, repeats, seed)
        known = json.loads(path.read_text()) if path.exists() else {}
        if known.get("key") != asked:
            episodes = tried(robot, agents, place, plan, task, repeats, seed)
            known = {"key": asked, **told(episodes, len(agents))}
            write_json(path, known)
        found[place.name] = known
    names = [(arm.name, s) for arm in arms for s in plan.seeds]
    return {
        "repeats": repeats,
        "places": [place.name for place in places],
        "agents": [
            {"arm": arm, "seed": s, "folder": agents[a].name}
            | {place: found[place]["agents"][a] for place in found}
            for a, (arm, s) in enumerate(names)
        ],
        "targets": {place: found[place]["targets"] for place in found},
    }


def key(agents: Sequence[Path], place: Place, repeats: int, seed: int) -> str:
    """SHA-256 of what decides how agents do in a place: policies, robots, simulator, starts."""
    whole = hashlib.sha256()
    for agent in agents:
        whole.update(
            repr([layer.tobytes() for layer in read_zip(agent / "policy.zip").weights]).encode()
        )
    rest = (place.fidelity, place.cell_m, dict(place.options), repeats, seed)
    whole.update(repr(([digest(draws) for draws in place.draws], rest)).encode())
    return whole.hexdigest()


def tried(
    robot: Robot, agents: Sequence[Path], place: Place, plan: Plan, task: Task, repeats: int,
    seed: int,
) -> Episodes:  # fmt: skip
    """All agents' episodes in one place, agent by agent; starts are the same for every agent."""
    shown = replace(task, energy=plan.task.energy, place=_same(task, len(agents), repeats, seed))
    with own_stream(plan.device):
        world = make_world(
            robot, shown, place.draws, n_envs=len(agents) * repeats, fidelity=place.fidelity,
            device=plan.device, cell_m=place.cell_m, threads=plan.threads, seed=seed,
            **place.options,
        )  # fmt: skip
        policies = [PolicyController(read_zip(agent / "policy.zip")) for agent in agents]
        return run_episodes(world, Blocks(policies), name=place.name)


def _same(task: Task, A: int, repeats: int, seed: int) -> Any:  # noqa: ANN401 - a task's ``place``
    """Starts and targets of ``repeats`` episodes, the same for each of A agents."""

    def place(rng: np.random.Generator, n: int, J: int) -> tuple[Array, Array, Array]:
        del rng
        starts = task.place(np.random.default_rng(seed), repeats, J)
        tiled = [np.tile(x, (A, *[1] * (x.ndim - 1)))[:n] for x in starts]
        return tiled[0], tiled[1], tiled[2]

    return place


def told(episodes: Episodes, A: int) -> dict[str, Any]:
    """Episodes of A agents as JSON keeps them."""
    spent = energy(episodes.rate)
    own = np.arange(len(spent)).reshape(A, -1)

    def numbers(values: Array) -> list[float | None]:
        return [round(float(x), 6) if np.isfinite(x) else None for x in values]

    agents = [
        {
            "reward": numbers(episodes.reward[rows]),
            "success": [bool(x) for x in episodes.success[rows]],
            "time_s": numbers(episodes.time_s[rows]),
            "energy": numbers(spent[rows]),
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
