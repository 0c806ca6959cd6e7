"""Figures of swims: paths over the pool, bars, signals beside their simulation, stills of films."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.episodes import FIGURES
from rl.experiments.film import MARGIN_M
from rl.task import DOMAIN_M, START_ZONE, TARGET_ZONE, TASKS
from sim.inference.swims import Swim
from sim.view.video import FRAMES_PER_S
from sim2real.arrays import Array, Picture
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, RULE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    low, high = np.nanmin(points, axis=0) - 0.15, np.nanmax(points, axis=0) + 0.15
    height = 360 * (high[1] - low[1]) / (high[0] - low[0]) + 40

    def mark(axes: Any, name: str) -> None:  # noqa: ANN401
        from matplotlib.patches import Circle

        axes.grid(False)
        axes.plot(*targets.T, color=RULE, linewidth=1.0, zorder=1)
        for target in targets:
            axes.add_patch(Circle(target, TASKS["point"].arrive_m, fc="none", ec=FAINT, zorder=2))
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
    rows, columns = -(-len(ways) // 2), min(2, len(ways))
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


def compared_signals(swim: Swim, signals: Array, heading: Array) -> dict[str, tuple[Array, Array]]:
    """Measured and simulated surge, sway, yaw and first joint, by label.

    The simulation has ``signals`` (T, 3 + J) as ``Swim.signals`` and ``heading`` (T,).
    """
    surge, sway, joint = ((swim.signals[:, k], signals[:, k]) for k in (0, 1, 3))
    yaw = (swim.heading - swim.start[2], heading - swim.start[2])
    return {"surge (m/s)": surge, "sway (m/s)": sway, "yaw (rad)": yaw, "joint 1 (rad)": joint}


def compared_figure(swims: Sequence[tuple[Swim, Mapping[str, tuple[Array, Array]]]]) -> Figure:
    """A column for each swim and its ``compared_signals``, coloured as in the paper's Fig. 3."""
    with new_figure(580, "Measured and simulated swims") as figure:
        panels = figure.subplots(4, len(swims), squeeze=False, sharex="col", sharey="row")
        for column, (swim, rows) in zip(panels.T, swims, strict=True):
            for axes, (label, pair) in zip(column, rows.items(), strict=True):
                if label.startswith("joint"):
                    axes.plot(swim.t, swim.command[:, 0], color=INK, lw=0.6, label="command")
                axes.plot(swim.t, pair[0], color="tab:red", lw=1.0, label="measured")
                axes.plot(swim.t, pair[1], "--", color="tab:blue", lw=1.2, label="simulated")
                axes.set_title(label)
            column[0].set_title(swim.name, loc="right", color=INK)
            column[-1].set_xlabel("time (s)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def stills_figure(
    reels: Mapping[str, Sequence[Picture]], ways: Sequence[Array], target: Array, count: int = 6
) -> Figure:
    """Stills of films from above at the same times, a row for each, around paths and target."""
    points = np.concatenate([*ways, target[None]])
    low, high = np.nanmin(points, axis=0) - 0.3, np.nanmax(points, axis=0) + 0.3
    last = max(len(reel) for reel in reels.values()) - 1
    width, height = high - low
    tall = 680 / count * height / width
    with new_figure(60 + (tall + 30) * len(reels), "Stills of the turn") as figure:
        panels = figure.subplots(len(reels), count, squeeze=False)
        ends = np.array([-1, 1, -1, 1]) * (DOMAIN_M[0] / 2 + MARGIN_M)
        for row, (name, reel) in zip(panels, reels.items(), strict=True):
            for axes, k in zip(row, np.linspace(0, last, count).round().astype(int), strict=True):
                axes.imshow(reel[min(k, len(reel) - 1)], extent=ends)
                axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
                axes.set_title(f"{k / FRAMES_PER_S:.1f} s", color=INK)
                axes.spines[:].set(visible=True)
            row[0].set_ylabel(name)
    return figure


def in_step(reels: Sequence[Sequence[Picture]]) -> Iterator[Picture]:
    """Frames of films side by side; one that is over keeps its last picture."""
    for k in range(max(len(reel) for reel in reels) + FRAMES_PER_S):  # a second longer
        yield np.hstack([reel[min(k, len(reel) - 1)] for reel in reels])
