"""Figures of the paths of robots over the pool, a panel for each controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.episodes import FIGURES
from rl.task import POINT, START_ZONE, TARGET_ZONE
from sim2real.arrays import Array
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, RULE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ACROSS = 2
_PANEL = 360
_MARGIN_M = 0.15


Way = tuple[Array, dict[str, Any]]
"""Path of a head, x and y in m, shape (T, 2), NaN after its end; how it is drawn."""


def pool_figure(
    ways: Mapping[str, Sequence[Array]], targets: Array, notes: Mapping[str, str]
) -> Figure:
    """Paths of trials over the pool, the first highlighted, and targets (N, 2) in order."""
    others, first = {"color": INK, "alpha": 0.5, "lw": 0.6}, {"color": ACCENT, "lw": 1.3}
    panels = {
        name: [*((x, others) for x in reversed(of_name[1:])), (of_name[0], first)]
        for name, of_name in ways.items()
    }
    points = np.concatenate([targets, *(x for of_name in ways.values() for x in of_name)])
    low, high = np.nanmin(points, axis=0) - _MARGIN_M, np.nanmax(points, axis=0) + _MARGIN_M
    height = _PANEL * (high[1] - low[1]) / (high[0] - low[0]) + 40

    def mark(axes: Any, name: str) -> None:  # noqa: ANN401
        from matplotlib.patches import Circle

        axes.grid(False)
        axes.plot(*targets.T, color=RULE, linewidth=1.0, zorder=1)
        for target in targets:
            axes.add_patch(Circle(target, POINT.arrive_m, fc="none", ec=FAINT, zorder=2))
        axes.plot(*ways[name][0][0], "o", color=INK, markersize=4, zorder=4)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_title(notes[name], loc="right")

    return _panels(panels, "Trajectories over the pool", height, mark, shared=False)


def zones_figure(ways: Mapping[str, Sequence[Array]], notes: Mapping[str, str]) -> Figure:
    """Paths between the start zone (red) and the target zone (green), a panel for each policy."""
    style = {"color": INK, "alpha": 0.6, "lw": 0.8}

    def mark(axes: Any, name: str) -> None:  # noqa: ANN401
        from matplotlib.patches import Rectangle

        axes.grid(False)
        zones = (START_ZONE, "tab:red", "start"), (TARGET_ZONE, "tab:green", "target")
        for zone, colour, word in zones:
            side, corner = zone.side_m, (zone.x_m - zone.side_m / 2, -zone.side_m / 2)
            axes.add_patch(Rectangle(corner, side, side, color=colour, alpha=0.2, lw=0))
            axes.text(corner[0], 0.58, word, color=MUTED)
        ends = np.array([way[np.isfinite(way[:, 0])][-1] for way in ways[name]])
        axes.plot(*ends.T, "o", color=ACCENT, markersize=3)
        axes.set(xlim=(-1.5, 1.5), ylim=(-0.75, 0.75))
        axes.set_title(notes[name], loc="right")

    panels = {name: [(way, style) for way in of_name] for name, of_name in ways.items()}
    return _panels(panels, "Paths at stages of training", 240, mark, shared=True)


def bars_figure(figures: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Mean and standard deviation of time and energy of each controller's trials, as bars."""
    colours, panels = [ACCENT, *[FAINT] * (len(figures) - 1)], {}
    for name in ("time_s", "energy"):
        spent = [of_name[name] for of_name in figures.values()]
        mean, sd = np.mean(spent, axis=1), np.std(spent, axis=1)
        panels[FIGURES[name].label] = [("", colours, np.array([mean, mean - sd, mean + sd]))]
    return bar_panels("Time and energy of each controller", list(figures), panels)


def bar_panels(
    label: str, names: Sequence[str], panels: Mapping[str, Sequence[tuple[str, Any, Array]]]
) -> Figure:
    """Bars of N names in a panel for each quantity.

    A panel has groups: name, colours, and mean and ends of an interval, shape (3, N).
    """
    with new_figure(60 + 40 * len(names), label) as figure:
        interval = {"ecolor": INK, "lw": 1, "capsize": 2}
        drawn = figure.subplots(1, len(panels), sharey=True)
        for axes, (title, groups) in zip(drawn, panels.items(), strict=True):
            for k, (group, colour, (mean, low, high)) in enumerate(groups):
                y = np.arange(len(names)) + 0.34 * (k - (len(groups) - 1) / 2)
                error = {"xerr": [mean - low, high - mean], "error_kw": interval}
                axes.barh(y, mean, 0.6 / len(groups), color=colour, label=group, **error)
            axes.locator_params(axis="x", nbins=5)
            axes.grid(axis="x")
            axes.grid(visible=False, axis="y")
            axes.margins(x=0.04)
            axes.set_xlabel(title)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        if len(groups) > 1:
            figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def paths_figure(
    ways: Mapping[str, Sequence[Way]],
    label: str,
    *,
    away_m: Sequence[float],
    limits: tuple[Any, Any] | None = None,
) -> Figure:
    """Aligned paths from a start at the origin, with targets ``away_m`` to the left of it."""

    def mark(axes: Any, name: str) -> None:  # noqa: ANN401
        for away in away_m:
            axes.plot([-away], [0], "o", mfc="none", mec=FAINT)
        axes.plot([0], [0], "o", color=INK, markersize=3)
        axes.margins(x=0.04)
        if limits is not None:
            axes.set(xlim=limits[0], ylim=limits[1])

    return _panels(ways, label, 185, mark, shared=True)


def _panels(
    ways: Mapping[str, Sequence[Way]],
    label: str,
    height: float,
    mark: Callable[[Any, str], None],
    *,
    shared: bool,
) -> Figure:
    """A panel for each name, with what ``mark`` adds to its axes."""
    rows, columns = -(-len(ways) // _ACROSS), min(_ACROSS, len(ways))
    with new_figure(rows * height + 20, label) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharex=shared, sharey=shared).ravel()
        for axes in panels[len(ways) :]:
            axes.set_visible(False)
        for axes, (name, of_name) in zip(panels, ways.items(), strict=False):
            for position, style in of_name:
                axes.plot(*position.T, **style)
            axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
            axes.locator_params(nbins=5)
            axes.set_title(name, color=INK)
            mark(axes, name)
            if shared:
                axes.label_outer()
        for axes in panels[len(ways) - columns : len(ways)]:  # none is visible below them
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("x (m)")
    return figure


def aligned(path: Array, target: Array, colour: str = INK) -> Way:
    """A path with its start at the origin and the target on the negative x axis."""
    moved = path - path[0]
    c, s = (target - path[0]) / np.linalg.norm(target - path[0])
    style = {"color": colour, "alpha": 0.7, "lw": 0.7}
    return moved @ np.array([[-c, s], [-s, -c]]), style
