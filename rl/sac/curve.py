"""Learning curves of a run: return and success against steps.

A single group of agents is plotted with a line per agent, several groups with a mean per group.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.output import check_writable
from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

_HEIGHT = 420
LEAST = 64
"""Minimum number of episodes per point of the curve."""
STYLES = ("-", "-", "-", "--", "--", ":")


def read_progress(folder: Path) -> dict[str, Array]:
    """Columns of an agent's ``progress.csv``."""
    with (folder / "progress.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def grouped(progress: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """Steps, mean return and success over groups of rows with at least ``LEAST`` episodes.

    Successful episodes end first: rows with few episodes would be biased towards them.
    """
    points: list[tuple[float, float, float]] = []
    rows: list[int] = []
    for k, count in enumerate(progress["episodes"]):
        if count > 0:
            rows.append(k)
        if rows and (sum(progress["episodes"][rows]) >= LEAST):
            weight = progress["episodes"][rows]
            mean, won = (
                np.average(progress[n][rows], weights=weight) for n in ("mean_return", "success")
            )
            points.append((progress["steps"][k], mean, won))
            rows = []
    table = np.array(points).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]


def averaged(curves: Sequence[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """Steps, mean return and success over non-empty curves, in their common range of steps."""
    curves = [curve for curve in curves if curve[0].size]
    if not curves:
        return np.empty(0), np.empty(0), np.empty(0)
    start, end = max(c[0][0] for c in curves), min(c[0][-1] for c in curves)
    steps = np.linspace(start, max(start, end), 100)
    mean, won = (np.mean([np.interp(steps, c[0], c[n]) for c in curves], axis=0) for n in (1, 2))
    return steps, mean, won


def draw_curves(agents: Mapping[str, Sequence[Path]], path: Path) -> None:
    """Plot the curves of groups of agents.

    Args:
        agents: Folders of the agents of each group; the first group is highlighted.
        path: PNG to write.
    """
    check_writable(path)
    with house_style():
        figure = new_figure(_HEIGHT, "Return and success of episodes against training steps")
        upper, lower = figure.subplots(2, 1, sharex=True)
        for k, (group, folders) in enumerate(agents.items()):
            colour = ACCENT if k == 0 else (INK, FAINT)[(k - 1) % 2]
            curves = [grouped(read_progress(folder)) for folder in folders]
            for n, curve in enumerate(curves if len(agents) == 1 else [averaged(curves)]):
                steps, mean, won = curve
                label = group if n == 0 else None
                style = STYLES[k % len(STYLES)]
                upper.plot(steps / 1e3, mean, style, color=colour, lw=1.1, label=label)
                lower.plot(steps / 1e3, 100 * won, style, color=colour, lw=1.1)
        upper.set_title("mean return of the episodes that ended")
        lower.set_title("share that arrived (%)")
        lower.set(xlabel="steps of the environment, thousands", ylim=(0, 100))
        if len(agents) > 1:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=144)
