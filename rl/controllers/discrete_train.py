"""Train the policy of ``discrete_cpg`` with deep Q-learning (Stable-Baselines3).

Mnih et al., "Human-level control through deep reinforcement learning" (Nature 518, 2015).
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from rl.controllers.discrete_cpg import TABLE, ActionTable
from rl.controllers.discrete_env import DiscreteCPGEnv
from rl.make import Fidelity, draws_of, make_world, own_stream
from rl.observer import PAPER
from rl.task import TASKS
from rl.vec_env import FishVecEnv
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import provenance, write_json, write_whole
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot
from sim2real.structured import read_json

COLUMNS = ("steps", "episodes", "mean_return", "success", "mean_length", "exploration")
ROWS = 50
"""Rows of ``progress.csv``."""
QUICK: dict[str, Any] = {"task": "near", "steps": 1_000_000, "envs": 32, "energy_weight": 1e-4}
"""Settings of ``train --quick``: a minute or two on one core, in the twin."""


@dataclass(frozen=True)
class GaitSettings:
    """Hyper-parameters.

    Attributes:
        gamma: Discount factor per choice: 0.95 per 0.2 s is a horizon of 4 s.
        rate: Learning rate.
        memory: Size of the replay memory in choices.
        batch: Choices of an update.
        hidden: Widths of the hidden layers.
        warm_up: Random choices before learning begins.
        updates: Updates per choice of all robots.
        follow: Choices between copies to the target network.
        exploring: Share of the training over which exploration decreases to ``least``.
        least: Final share of random choices.
    """

    gamma: float = 0.95
    rate: float = 1e-3
    memory: int = 100_000
    batch: int = 256
    hidden: tuple[int, ...] = (64, 64)
    warm_up: int = 2_000
    updates: int = 8
    follow: int = 200
    exploring: float = 0.3
    least: float = 0.05


def make_dqn(env: VecEnv, seed: int, settings: GaitSettings = GaitSettings()) -> DQN:
    """An untrained agent for ``env``, a ``DiscreteCPGEnv``."""
    return DQN(
        "MlpPolicy", env, learning_rate=settings.rate, buffer_size=settings.memory,
        learning_starts=settings.warm_up, batch_size=settings.batch, gamma=settings.gamma,
        train_freq=1, gradient_steps=settings.updates, target_update_interval=settings.follow,
        exploration_fraction=settings.exploring, exploration_final_eps=settings.least,
        policy_kwargs={"net_arch": list(settings.hidden)}, seed=seed, device="cpu",
    )  # fmt: skip


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    name: str = "policy",
    task: str = "point",
    steps: int = 1_000_000,
    envs: int = 32,
    seeds: Sequence[int] = (0,),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    energy_weight: float | None = None,
    table: ActionTable = TABLE,
) -> list[Path]:
    """Train an agent for each seed, one after the other; see the command ``train`` for the options.

    A run that was killed keeps finished agents and restarts the others.

    Returns:
        Folders of the agents, each with ``policy.zip`` and ``progress.csv``.

    Raises:
        InputError: If a file or an option is wrong.
    """
    for option, value in (("--steps", steps), ("--envs", envs)):
        if value < 1:
            raise InputError("train", option, str(value), "at least 1")
    fish, fitted = read_robot(robot), read_model(model)
    drawn = None if ranges is None else read_ranges(ranges)
    chosen, settings = TASKS[task], GaitSettings()
    if energy_weight is not None:
        chosen = replace(chosen, energy=energy_weight)
    draws = draws_of(fitted, drawn, fish, seed=0)
    inputs = [robot, model, *([] if ranges is None else [ranges])]
    description = {
        "controller": "discrete-cpg", "task": task, "energy": chosen.energy, "steps": steps,
        "envs": envs, "fidelity": fidelity, "gaits": table.content(), "settings": asdict(settings),
    }  # fmt: skip
    folders = [folder / f"{name}-{seed}" for seed in seeds]
    for directory, seed in zip(folders, seeds, strict=True):
        if _is_done(directory, {**description, "seed": seed}, provenance(inputs, seed)):
            continue
        with own_stream(device):
            world = make_world(
                fish, chosen, draws, n_envs=envs, seed=seed, fidelity=fidelity, device=device,
                cell_m=cell_m, threads=threads,
            )  # fmt: skip
            agent: Any = make_dqn(DiscreteCPGEnv(FishVecEnv(world, PAPER), table), seed, settings)
            callback = ProgressCallback(steps, table.hold)
            agent.learn(-(-steps // table.hold), callback=callback)
        agent.gaits, agent.joints = table.content(), [joint.name for joint in fish.joints]
        write_whole(directory / "progress.csv", callback.csv())
        save(agent, directory / "policy.zip")
    return folders


def _is_done(directory: Path, description: dict[str, Any], note: dict[str, Any]) -> bool:
    """Whether the agent of ``run.json`` has been trained."""
    path = directory / "run.json"
    if not path.exists():
        write_json(path, {**description, "provenance": note})
    existing = read_json(path)
    expected_content = json.loads(json.dumps(description))
    if {k: existing.get(k) for k in expected_content} != expected_content or existing.get(
        "provenance", {}
    ).get("inputs") != note["inputs"]:
        expected = "the same options and files, or a new folder"
        raise InputError(directory, "run.json", "another run", expected)
    return (directory / "policy.zip").exists()


def save(agent: DQN, path: Path) -> None:
    """Write a policy atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    agent.save(temporary)
    os.replace(temporary, path)


class ProgressCallback(BaseCallback):
    """Progress bar and rows of ``progress.csv``.

    Attributes:
        rows: Rows with the columns ``COLUMNS``.
    """

    def __init__(self, steps: int, hold: int) -> None:
        """``steps`` are control periods of all robots together, ``hold`` those of a choice."""
        super().__init__()
        self.rows: list[list[float]] = []
        self._every, self._hold = max(1, steps // ROWS), hold
        self._ended: list[tuple[float, float, float]] = []
        self._recent: deque[bool] = deque(maxlen=200)
        self._bar = tqdm(total=steps, desc="train", unit="step", disable=None)

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                won = bool(info["is_success"])
                self._ended.append((info["episode"]["r"], won, info["episode"]["l"]))
                self._recent.append(won)
        steps = self.num_timesteps * self._hold
        self._bar.update(steps - self._bar.n)
        if steps >= (len(self.rows) + 1) * self._every:
            self._note(steps)
        return True

    def _on_training_end(self) -> None:
        if self._ended or not self.rows:
            self._note(self.num_timesteps * self._hold)
        self._bar.close()

    def _note(self, steps: int) -> None:
        mean = np.mean(self._ended, axis=0) if self._ended else np.full(3, np.nan)
        exploring = getattr(self.model, "exploration_rate", np.nan)
        self.rows.append([steps, len(self._ended), *mean, exploring])
        self._ended = []
        if self._recent:
            self._bar.set_postfix_str(f"{100 * np.mean(self._recent):.0f} % arrive")

    def csv(self) -> str:
        """The content of ``progress.csv``."""
        lines = [",".join(f"{x:.6g}" for x in row) for row in self.rows]
        return "\n".join([",".join(COLUMNS), *lines]) + "\n"
