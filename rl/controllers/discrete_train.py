"""Train the policy of ``discrete_cpg`` with deep Q-learning (Stable-Baselines3).

Mnih et al., "Human-level control through deep reinforcement learning" (Nature 518, 2015).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from rl.controllers.discrete_cpg import TABLE, DiscreteCPGEnv, GaitDQN
from rl.make import Fidelity, episodes_of, make_world, own_stream
from rl.observer import PAPER
from rl.sac.checkpoint import write_progress
from rl.sac.train import check_run
from rl.task import TASKS
from rl.vec_env import FishVecEnv
from sim2real.errors import InputError
from sim2real.output import provenance

COLUMNS = ("steps", "episodes", "mean_return", "success", "mean_length", "exploration")
ROWS = 50
"""Rows of ``progress.csv``."""
QUICK: dict[str, Any] = {"task": "near", "steps": 1_000_000, "envs": 32, "energy_weight": 1e-4}
"""Settings of ``train --quick``: a minute or two on one core, in the twin."""
ACCEPTED = ("task", "steps", "envs", "energy_weight")
"""Options of the command ``train`` that ``train_run`` accepts."""
SETTINGS: dict[str, Any] = {
    "gamma": 0.95,  # per choice: 0.95 per 0.2 s is a horizon of 4 s
    "rate": 1e-3,
    "memory": 100_000,  # choices
    "batch": 256,
    "hidden": [64, 64],
    "warm_up": 2_000,  # random choices before learning begins
    "updates": 8,  # per choice of all robots
    "follow": 200,  # choices between copies to the target network
    "exploring": 0.3,  # share of the training over which exploration decreases to the least
    "least": 0.05,  # final share of random choices
}
"""Hyper-parameters."""


def make_dqn(env: VecEnv, seed: int) -> GaitDQN:
    """An untrained agent for ``env``, a ``DiscreteCPGEnv``."""
    s = SETTINGS
    return GaitDQN(
        "MlpPolicy", env, learning_rate=s["rate"], buffer_size=s["memory"],
        learning_starts=s["warm_up"], batch_size=s["batch"], gamma=s["gamma"], train_freq=1,
        gradient_steps=s["updates"], target_update_interval=s["follow"],
        exploration_fraction=s["exploring"], exploration_final_eps=s["least"],
        policy_kwargs={"net_arch": s["hidden"]}, seed=seed, device="cpu",
    )  # fmt: skip


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    task: str = "point",
    steps: int = 1_000_000,
    envs: int = 32,
    seeds: Sequence[int] = (0,),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    energy_weight: float | None = None,
) -> list[Path]:
    """Train an agent for each seed, one after the other; the folders of the agents.

    See the command ``train`` for the options. A run that was killed keeps finished agents and
    restarts the others.

    Raises:
        InputError: If a file or an option is wrong.
    """
    for option, value in (("--steps", steps), ("--envs", envs)):
        if value < 1:
            raise InputError("train", option, str(value), "at least 1")
    fish, draws, inputs = episodes_of(robot, model, ranges)
    chosen, gaits = TASKS[task], TABLE.content()
    if energy_weight is not None:
        chosen = replace(chosen, energy=energy_weight)
    description = {
        "controller": "discrete-cpg", "task": task, "energy": chosen.energy, "steps": steps,
        "envs": envs, "fidelity": fidelity, "gaits": gaits, "settings": SETTINGS,
    }  # fmt: skip
    folders = [folder / f"policy-{seed}" for seed in seeds]
    for directory, seed in zip(folders, seeds, strict=True):
        note = provenance(inputs, seed)
        check_run(directory, {**description, "seed": seed}, note, same=("inputs",))
        if (directory / "policy.zip").exists():
            continue
        with own_stream(device):
            world = make_world(
                fish, chosen, draws, n_envs=envs, seed=seed, fidelity=fidelity, device=device,
                cell_m=cell_m, threads=threads,
            )  # fmt: skip
            agent = make_dqn(DiscreteCPGEnv(FishVecEnv(world, PAPER)), seed)
            rows = _learn(agent, steps)
        agent.gaits, agent.joints = gaits, [joint.name for joint in fish.joints]
        write_progress(directory / "progress.csv", COLUMNS, rows)
        agent.save(directory / "policy.zip")
    return folders


def _learn(agent: GaitDQN, steps: int) -> list[list[float]]:
    """Train for ``steps`` of all robots together; rows of ``progress.csv``."""
    rows: list[list[float]] = []
    ended: list[tuple[float, float, float]] = []
    recent: deque[bool] = deque(maxlen=200)
    bar = tqdm(total=steps, desc="train", unit="step", disable=None)

    def note() -> None:
        mean = np.mean(ended, axis=0) if ended else np.full(3, np.nan)
        rows.append([agent.num_timesteps * TABLE.hold, len(ended), *mean, agent.exploration_rate])
        ended.clear()
        if recent:
            bar.set_postfix_str(f"{100 * np.mean(recent):.0f} % arrive")

    def after_step(scope: dict[str, Any], _: dict[str, Any]) -> bool:
        for info in scope["infos"]:
            if "episode" in info:
                won = bool(info["is_success"])
                ended.append((info["episode"]["r"], won, info["episode"]["l"]))
                recent.append(won)
        done = agent.num_timesteps * TABLE.hold
        bar.update(done - bar.n)
        if done >= (len(rows) + 1) * max(1, steps // ROWS):
            note()
        return True

    with bar:
        agent.learn(-(-steps // TABLE.hold), callback=after_step)
        if ended or not rows:
            note()
    return rows
