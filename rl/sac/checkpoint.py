"""Files of a training run: checkpoint, policies, progress and learning curves."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rl.sac.agents import Agents
from rl.sac.plan import Plan
from sim2real.arrays import Array
from sim2real.errors import InputError, library
from sim2real.output import write_whole
from sim2real.report.drawing import ACCENT, FAINT, INK, new_figure
from sim2real.structured import read_arrays, reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = (
    "steps", "episodes", "mean_return", "success", "mean_length", "actor_loss", "critic_loss",
    "entropy_coefficient", "energy_grown",
)  # fmt: skip
CHECKPOINT = "checkpoint.npz"


class Progress:
    """Progress of a run of A agents."""

    def __init__(self, A: int, steps: int = 0) -> None:
        self.steps = steps  # of the environment for each agent so far
        self.rows: list[list[list[float]]] = [[] for _ in range(A)]  # of ``COLUMNS``
        self.grown = [0.0] * A  # of each energy weight, 0 to 1
        self.success = [0.0] * A  # share of the last 50 episodes

    def note(self, tally: Tensor, agents: Agents, plan: Plan) -> None:
        """Append a row for every agent, and update the growth of the energy weights."""
        losses = agents.losses().cpu()
        more = self.steps - (int(self.rows[0][-1][0]) if self.rows[0] else 0)
        for a, rows in enumerate(self.rows):
            episodes, *means = tally[:, a].tolist()
            rows.append([self.steps, int(episodes), *means, *losses[:, a].tolist(), self.grown[a]])
            if episodes >= 1:
                decay = math.exp(-episodes / 50.0)
                self.success[a] = decay * self.success[a] + (1 - decay) * means[1]
            self.grown[a] = plan.grown(self.grown[a], self.steps, more, self.success[a])

    def summary(self) -> str:
        """Short text of the last rows."""
        returns, success = np.array([rows[-1][2:4] for rows in self.rows]).T
        if not np.isfinite(returns).any():
            return "no episode has ended"
        return f"return {np.nanmean(returns):.1f}, {100 * np.nanmean(success):.0f} % arrive"


class TensorBoard:
    """A report for ``train_run`` that writes rows of progress to ``folder/NAME`` as they come."""

    def __init__(self, folder: Path) -> None:
        """MissingLibrary without TensorBoard."""
        library("tensorboard", "--tensorboard")
        self._folder, self._writers = folder, dict[str, Any]()

    def __call__(self, name: str, row: Mapping[str, float]) -> None:
        """Write the finite columns of an agent's row."""
        from torch.utils.tensorboard import SummaryWriter

        if name not in self._writers:
            self._writers[name] = SummaryWriter(self._folder / name, flush_secs=5)  # type: ignore[no-untyped-call]
        for column, value in row.items():
            if column != "steps" and math.isfinite(value):
                self._writers[name].add_scalar(column, value, int(row["steps"]))


def write_progress(path: Path, columns: Sequence[str], rows: Iterable[Sequence[float]]) -> None:
    """Write ``progress.csv``."""
    lines = [",".join(columns), *(",".join(f"{x:.6g}" for x in row) for row in rows)]
    write_whole(path, "\n".join(lines) + "\n")


def save(folder: Path, agents: Agents, progress: Progress, names: Sequence[str]) -> None:
    """Write the checkpoint, and policy and progress of each agent; each file atomically."""
    arrays = {name: tensor.cpu().numpy() for name, tensor in agents.state().items()}
    arrays["memory"] = agents.memory[:, : agents.filled].cpu().numpy()
    content = json.dumps([progress.rows, progress.grown, progress.success])
    arrays["progress"] = np.frombuffer(content.encode(), np.uint8)
    arrays["counts"] = np.array([progress.steps, agents.position, agents.filled])
    for name, rows in zip(names, progress.rows, strict=True):
        write_progress(folder / name / "progress.csv", COLUMNS, rows)
    save_policies(folder, agents, progress, names, "policy.zip")
    temporary = folder / f".{CHECKPOINT}"
    with temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
    os.replace(temporary, folder / CHECKPOINT)


def save_policies(
    folder: Path, agents: Agents, progress: Progress, names: Sequence[str], file: str
) -> None:
    """Write the policy of each agent to ``file`` in its folder."""
    prices = agents.settings.prices
    with agents.averaged():
        columns = agents.actor.weights[0][:, :, 0].cpu().numpy()
        for a, (name, model) in enumerate(zip(names, agents.models, strict=True)):
            model.num_timesteps = progress.steps
            column = columns[a].copy() if prices > 1 else None
            model.by_price = {"prices": prices, "column": column, "share": 0.0}
            model.save(folder / name / file)


def load(folder: Path, agents: Agents) -> Progress | None:
    """Restore agents from the checkpoint of a folder; None if there is none."""
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
        progress = Progress(len(memory), steps)
        progress.rows, progress.grown, progress.success = json.loads(arrays["progress"].tobytes())
        table = np.array(progress.rows, dtype=np.float64)
        shares = np.array([progress.grown, progress.success], dtype=np.float64)
        agents_and_columns = (*table.shape[:1], *table.shape[2:], *shares.shape)
        if agents_and_columns != (len(memory), len(COLUMNS), 2, len(memory)):
            raise ValueError("progress of other agents")
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(path, "", f"a damaged one ({reason(error)})", expected) from None
    for name, tensor in state.items():
        tensor.copy_(torch.from_numpy(arrays[name]))
    memory[:, :filled] = torch.from_numpy(arrays["memory"]).to(agents.device)
    agents.position = position if filled == memory.shape[1] else filled  # it may have grown
    agents.set_filled(filled)
    return progress


def read_progress(folder: Path) -> dict[str, Array]:
    """Columns of an agent's ``progress.csv``."""
    table = np.genfromtxt(folder / "progress.csv", delimiter=",", names=True, ndmin=1)
    return {name: table[name] for name in table.dtype.names or ()}


def _curve(progress: Mapping[str, Array]) -> Array:
    """Steps, mean return and success of the last 64 episodes, in each row that had one, (3, n)."""
    ended = np.flatnonzero(progress["episodes"] > 0)
    weight = progress["episodes"][ended]
    means = [progress[name][ended] for name in ("mean_return", "success")]
    table = np.array([*means, np.ones(len(ended))])
    sums = np.cumsum(np.hstack([np.zeros((3, 1)), table * weight]), axis=1)
    first = np.searchsorted(sums[2], sums[2, 1:] - 64, side="right") - 1  # of 64 or a few more
    recent = sums[:, 1:] - sums[:, first.clip(min=0)]
    return np.vstack([progress["steps"][ended], recent[:2] / recent[2]])


def _mean_curve(curves: Sequence[Array]) -> tuple[Array, Array]:
    """Mean and standard deviation of non-empty curves, in their common range of steps."""
    curves = [curve for curve in curves if curve.size]
    if not curves:
        return np.empty((3, 0)), np.empty((3, 0))
    start, end = max(c[0, 0] for c in curves), min(c[0, -1] for c in curves)
    steps = np.linspace(start, max(start, end), 100)
    table = np.array([[steps, *(np.interp(steps, c[0], c[n]) for n in (1, 2))] for c in curves])
    return table.mean(axis=0), table.std(axis=0)


def curves_figure(agents: Mapping[str, Sequence[Path]]) -> Figure:
    """Return and success against steps: means of groups of agents.

    Of a single group, the standard deviation over its agents is shaded, as in the paper's Fig. 4.
    """
    with new_figure(420, "Return and success of episodes against training steps") as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for k, (group, folders) in enumerate(agents.items()):
            colour = ACCENT if k == 0 else (INK, FAINT)[(k - 1) % 2]
            style = ("-", "-", "-", "--", "--", ":")[k % 6]
            mean, sd = _mean_curve([_curve(read_progress(folder)) for folder in folders])
            for axes, n, unit in ((upper, 1, 1), (lower, 2, 100)):
                line = unit * mean[n]
                axes.plot(mean[0] / 1e3, line, style, color=colour, lw=1.1, label=group)
                if len(agents) == 1 and len(folders) > 1:
                    low, high = line - unit * sd[n], line + unit * sd[n]
                    axes.fill_between(mean[0] / 1e3, low, high, color=colour, alpha=0.2, lw=0)
        upper.set_title("mean return of the episodes that ended")
        lower.set_title("share that arrived (%)")
        lower.set(xlabel="steps of the environment, thousands", ylim=(0, 100))
        if len(agents) > 1:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure
