"""Learning curves of a run: return and success against steps.

A single group of agents is plotted with a line per agent, several groups with a mean per group.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.output import check_writable
from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

LEAST = 64
"""Minimum number of episodes per point of the curve."""
STYLES = ("-", "-", "-", "--", "--", ":")
Curve = Array
"""Steps, mean return and success, shape (3, points)."""


def read_progress(folder: Path) -> dict[str, Array]:
    """Columns of an agent's ``progress.csv``."""
    table = np.genfromtxt(folder / "progress.csv", delimiter=",", names=True, ndmin=1)
    return {name: table[name] for name in table.dtype.names or ()}


def grouped(progress: Mapping[str, Array]) -> Curve:
    """The curve of groups of rows with at least ``LEAST`` episodes.

    Successful episodes end first: rows with few episodes would be biased towards them.
    """
    points, rows = np.empty((0, 3)), list[int]()
    for k in np.flatnonzero(progress["episodes"] > 0).tolist():
        rows.append(k)
        weight = progress["episodes"][rows]
        if weight.sum() >= LEAST:
            table = np.array([progress["mean_return"][rows], progress["success"][rows]])
            means = np.average(table, axis=1, weights=weight)
            points = np.vstack([points, [progress["steps"][k], *means]])
            rows = []
    return points.T


def averaged(curves: Sequence[Curve]) -> Curve:
    """The mean of non-empty curves, in their common range of steps."""
    curves = [curve for curve in curves if curve.size]
    if not curves:
        return np.empty((3, 0))
    start, end = max(c[0, 0] for c in curves), min(c[0, -1] for c in curves)
    steps = np.linspace(start, max(start, end), 100)
    means = (np.mean([np.interp(steps, c[0], c[n]) for c in curves], axis=0) for n in (1, 2))
    return np.array([steps, *means])


def draw_curves(agents: Mapping[str, Sequence[Path]], path: Path) -> None:
    """Plot the curves of groups of agents.

    Args:
        agents: Folders of the agents of each group; the first group is highlighted.
        path: PNG to write.
    """
    check_writable(path)
    with house_style():
        figure = new_figure(420, "Return and success of episodes against training steps")
        upper, lower = figure.subplots(2, 1, sharex=True)
        for k, (group, folders) in enumerate(agents.items()):
            colour = ACCENT if k == 0 else (INK, FAINT)[(k - 1) % 2]
            style = STYLES[k % len(STYLES)]
            curves = [grouped(read_progress(folder)) for folder in folders]
            for n, curve in enumerate(curves if len(agents) == 1 else [averaged(curves)]):
                steps, mean, won = curve
                label = group if n == 0 else None
                upper.plot(steps / 1e3, mean, style, color=colour, lw=1.1, label=label)
                lower.plot(steps / 1e3, 100 * won, style, color=colour, lw=1.1)
        upper.set_title("mean return of the episodes that ended")
        lower.set_title("share that arrived (%)")
        lower.set(xlabel="steps of the environment, thousands", ylim=(0, 100))
        if len(agents) > 1:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=144)
