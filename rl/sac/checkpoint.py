"""What a training run leaves in its folder: a checkpoint, policies, how it went."""

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
from sim2real.output import write_whole

COLUMNS = (
    "steps", "episodes", "mean_return", "success", "mean_length", "actor_loss", "critic_loss",
    "entropy_coefficient", "energy_grown",
)  # fmt: skip
CHECKPOINT = "checkpoint.npz"
EPISODES = 50.0
"""Episodes over which an agent's success is averaged."""


class Progress:
    """How far a run of A agents has come, and how it went.

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
        """Add a row for every agent."""
        losses = agents.losses().cpu()
        for a, rows in enumerate(self.rows):
            episodes, *means = tally[:, a].tolist()
            rows.append([self.steps, int(episodes), *means, *losses[:, a].tolist(), self.grown[a]])
            if episodes >= 1:
                kept = math.exp(-episodes / EPISODES)
                self.success[a] = kept * self.success[a] + (1 - kept) * means[1]

    def noted(self) -> int:
        """Steps at the last row."""
        return int(self.rows[0][-1][0]) if self.rows[0] else 0

    def grow(self, grown: Callable[[float, int, int, float], float], before: int) -> None:
        """Let the energy weights grow by what went by since ``before``, as ``Plan.grown`` says."""
        self.grown = [
            grown(one, self.steps, self.steps - before, success)
            for one, success in zip(self.grown, self.success, strict=True)
        ]

    def said(self) -> str:
        """The last rows in a few words."""
        last = np.array([rows[-1] for rows in self.rows])
        if not np.isfinite(last[:, 2]).any():
            return "no episode has ended"
        return f"return {np.nanmean(last[:, 2]):.1f}, {100 * np.nanmean(last[:, 3]):.0f} % arrive"


def save(folder: Path, agents: Agents, progress: Progress, names: Sequence[str]) -> None:
    """Write the checkpoint, and each agent's policy and figures; each whole or not at all."""
    arrays = {name: tensor.cpu().numpy() for name, tensor in agents.state().items()}
    arrays["memory"] = agents.memory[:, : agents.filled].cpu().numpy()
    told = json.dumps([progress.rows, progress.grown, progress.success])
    arrays["progress"] = np.frombuffer(told.encode(), np.uint8)
    arrays["counts"] = np.array([progress.steps, agents.position, agents.filled])
    with agents.averaged():
        for a, (name, model) in enumerate(zip(names, agents.models, strict=True)):
            own = progress.rows[a]
            place = folder / name
            place.mkdir(parents=True, exist_ok=True)
            lines = [",".join(COLUMNS), *(",".join(f"{x:.6g}" for x in row) for row in own)]
            write_whole(place / "progress.csv", "\n".join(lines) + "\n")
            model.num_timesteps = progress.steps
            setattr(model, "by_price", _by_price(agents, a))  # noqa: B010 - kept with the model
            model.save(place / ".policy.zip")
            os.replace(place / ".policy.zip", place / "policy.zip")
    temporary = folder / f".{CHECKPOINT}"
    with temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
    os.replace(temporary, folder / CHECKPOINT)


def _by_price(agents: Agents, a: int) -> dict[str, Any]:
    """What the price of energy does to an actor: see ``rl.deploy.export.set_price``."""
    prices = agents.settings.prices
    column = agents.actor.weights[0][a, :, 0].cpu().numpy().copy() if prices > 1 else None
    return {"prices": prices, "column": column, "share": 0.0}


def load(folder: Path, agents: Agents) -> Progress | None:
    """Put agents back to where the folder's checkpoint left them; None where there is none."""
    path = folder / CHECKPOINT
    if not path.exists():
        return None
    with np.load(path) as held:
        for name, tensor in agents.state().items():
            tensor.copy_(torch.from_numpy(held[name]))
        steps, agents.position, filled = (int(x) for x in held["counts"])
        agents.memory[:, :filled] = torch.from_numpy(held["memory"]).to(agents.device)
        progress = Progress(len(agents.models), steps)
        told = json.loads(held["progress"].tobytes().decode())
        progress.rows, progress.grown, progress.success = told
    agents.set_filled(filled)
    return progress
