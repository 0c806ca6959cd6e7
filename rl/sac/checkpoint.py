"""Files of a training run: checkpoint, policies and progress."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from rl.sac.agents import Agents
from sim2real.errors import InputError
from sim2real.output import write_whole
from sim2real.structured import read_arrays, reason

COLUMNS = (
    "steps", "episodes", "mean_return", "success", "mean_length", "actor_loss", "critic_loss",
    "entropy_coefficient", "energy_grown",
)  # fmt: skip
CHECKPOINT = "checkpoint.npz"
EPISODES = 50.0
"""Episodes over which an agent's success is averaged."""


class Progress:
    """Progress of a run of A agents.

    Attributes:
        steps: Steps of the environment for each agent so far.
        rows: One list of rows, ``COLUMNS`` each, for every agent.
        grown: How far each agent's energy weight has grown, from 0 to 1.
        success: Share of each agent's last episodes that succeeded.
    """

    def __init__(self, A: int, steps: int = 0) -> None:
        self.steps = steps
        self.rows: list[list[list[float]]] = [[] for _ in range(A)]
        self.grown = [0.0] * A
        self.success = [0.0] * A

    def note(self, tally: Tensor, agents: Agents) -> None:
        """Append a row for every agent."""
        losses = agents.losses().cpu()
        for a, rows in enumerate(self.rows):
            episodes, *means = tally[:, a].tolist()
            rows.append([self.steps, int(episodes), *means, *losses[:, a].tolist(), self.grown[a]])
            if episodes >= 1:
                decay = math.exp(-episodes / EPISODES)
                self.success[a] = decay * self.success[a] + (1 - decay) * means[1]

    def noted(self) -> int:
        """Number of steps at the last row."""
        return int(self.rows[0][-1][0]) if self.rows[0] else 0

    def grow(self, grown: Callable[[float, int, int, float], float], before: int) -> None:
        """Update the energy weights for the steps since ``before``, see ``Plan.grown``."""
        self.grown = [
            grown(growth, self.steps, self.steps - before, success)
            for growth, success in zip(self.grown, self.success, strict=True)
        ]

    def summary(self) -> str:
        """Short text of the last rows."""
        latest = np.array([rows[-1] for rows in self.rows])
        if not np.isfinite(latest[:, 2]).any():
            return "no episode has ended"
        return (
            f"return {np.nanmean(latest[:, 2]):.1f}, {100 * np.nanmean(latest[:, 3]):.0f} % arrive"
        )


def save(folder: Path, agents: Agents, progress: Progress, names: Sequence[str]) -> None:
    """Write the checkpoint, and policy and progress of each agent; each file atomically."""
    arrays = {name: tensor.cpu().numpy() for name, tensor in agents.state().items()}
    arrays["memory"] = agents.memory[:, : agents.filled].cpu().numpy()
    content = json.dumps([progress.rows, progress.grown, progress.success])
    arrays["progress"] = np.frombuffer(content.encode(), np.uint8)
    arrays["counts"] = np.array([progress.steps, agents.position, agents.filled])
    with agents.averaged():
        for a, (name, model) in enumerate(zip(names, agents.models, strict=True)):
            rows = progress.rows[a]
            directory = folder / name
            directory.mkdir(parents=True, exist_ok=True)
            lines = [",".join(COLUMNS), *(",".join(f"{x:.6g}" for x in row) for row in rows)]
            write_whole(directory / "progress.csv", "\n".join(lines) + "\n")
            model.num_timesteps = progress.steps
            model.by_price = _by_price(agents, a)
            model.save(directory / "policy.zip")
    temporary = folder / f".{CHECKPOINT}"
    with temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
    os.replace(temporary, folder / CHECKPOINT)


def _by_price(agents: Agents, a: int) -> dict[str, Any]:
    """Effect of the price of energy on an actor, see ``rl.deploy.export.set_price``."""
    prices = agents.settings.prices
    column = agents.actor.weights[0][a, :, 0].cpu().numpy().copy() if prices > 1 else None
    return {"prices": prices, "column": column, "share": 0.0}


def load(folder: Path, agents: Agents) -> Progress | None:
    """Restore agents from the checkpoint of a folder; None if there is none.

    Raises:
        InputError: If it is damaged, or not one of such agents.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        return None
    expected = f"a checkpoint of this run; without {CHECKPOINT} it starts anew"
    state, memory = agents.state(), agents.memory
    numbers = sum(tensor.numel() for tensor in (memory, *state.values()))
    arrays = read_arrays(path, expected, largest=4 * numbers + 64 * 2**20)
    try:
        steps, position, filled = (int(x) for x in arrays["counts"])
        if steps < 0 or not 0 <= filled <= memory.shape[1] or not 0 <= position < memory.shape[1]:
            raise ValueError(f"counts {arrays['counts'].tolist()}")
        shapes = {name: tuple(tensor.shape) for name, tensor in state.items()}
        shapes["memory"] = (len(memory), filled, memory.shape[2])
        for name, shape in shapes.items():
            array = arrays[name]
            if array.shape != shape or array.dtype != np.float32 or not np.isfinite(array).all():
                raise ValueError(f"{name} is no finite array of float32 of the shape {shape}")
        progress = _progress(arrays["progress"].tobytes(), len(memory), steps)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(path, "", f"a damaged one ({reason(error)})", expected) from None
    for name, tensor in state.items():
        tensor.copy_(torch.from_numpy(arrays[name]))
    memory[:, :filled] = torch.from_numpy(arrays["memory"]).to(agents.device)
    agents.position = position
    agents.set_filled(filled)
    return progress


def _progress(content: bytes, A: int, steps: int) -> Progress:
    """Progress of A agents, as ``save`` writes it; ``ValueError`` if it is anything else."""
    progress = Progress(A, steps)
    progress.rows, progress.grown, progress.success = json.loads(content)
    lists = (progress.rows, progress.grown, progress.success)
    rows = [row for of_agent in progress.rows for row in of_agent]
    shares = [*progress.grown, *progress.success, *(value for row in rows for value in row)]
    numbers = all(type(value) in (int, float) for value in shares)
    if {len(one) for one in lists} != {A} or {len(row) for row in rows} - {len(COLUMNS)}:
        raise ValueError("progress of other agents")
    if not numbers:
        raise ValueError("progress with other values than numbers")
    return progress
