"""Trajectories in the pool with their targets, one panel per controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.metrics import REACHED_M
from sim2real.arrays import Array
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, RULE, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ACROSS = 2
_PANEL = 360
_MARGIN_M = 0.15


@dataclass(frozen=True)
class Path:
    """One swim.

    Attributes:
        position: Of the head's centre of mass in m, shape (T, 2); NaN after the end.
        note: Text of the panel, such as time and energy.
    """

    position: Array
    note: str = ""


def draw(
    paths: Mapping[str, Path | list[Path]],
    targets: Array,
    *,
    pool: tuple[float, float, float, float] | None = None,
) -> Figure:
    """Plot a panel for each name: targets as circles of 5 cm, and the trajectories.

    Args:
        paths: One swim or several by the name of the controller; the first is highlighted.
        targets: In m, shape (N, 2), in order.
        pool: Walls: lowest and highest x, lowest and highest y in m; drawn if within the axes.
    """
    swims = {name: swim if isinstance(swim, list) else [swim] for name, swim in paths.items()}
    points = np.concatenate([targets, *(p.position for of_name in swims.values() for p in of_name)])
    low, high = np.nanmin(points, axis=0) - _MARGIN_M, np.nanmax(points, axis=0) + _MARGIN_M
    rows = -(-len(swims) // _ACROSS)
    shape = (high[1] - low[1]) / (high[0] - low[0])
    with house_style():
        figure = new_figure(rows * (_PANEL * shape + 40) + 20, "Trajectories over the pool")
        panels = figure.subplots(rows, min(_ACROSS, len(swims)), squeeze=False).ravel()
        for axes, (name, of_name) in zip(panels, swims.items(), strict=False):
            _panel(axes, name, of_name, targets, pool)
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        for axes in panels[len(swims) :]:
            axes.set_visible(False)
    return figure


def _panel(axes: Any, name: str, swims: list[Path], targets: Array, pool: Any) -> None:  # noqa: ANN401
    from matplotlib.patches import Circle, Rectangle

    axes.set(aspect="equal", autoscale_on=False, xlabel="x (m)", ylabel="y (m)")
    axes.locator_params(nbins=5)
    axes.grid(False)
    if pool is not None:
        corner, size = (pool[0], pool[2]), (pool[1] - pool[0], pool[3] - pool[2])
        axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=MUTED, linewidth=1.0))
    axes.plot(*targets.T, color=RULE, linewidth=1.0, zorder=1)
    for target in targets:
        axes.add_patch(Circle(target, REACHED_M, facecolor="none", edgecolor=FAINT, zorder=2))
    for k, swim in enumerate(swims[::-1]):
        first = k == len(swims) - 1
        colour, width = (ACCENT, 1.3) if first else (INK, 0.6)
        axes.plot(*swim.position.T, color=colour, linewidth=width, alpha=1 if first else 0.5)
    start = swims[0].position[0]
    axes.plot(*start, "o", color=INK, markersize=4, zorder=4)
    axes.set_title(name, color=INK)
    axes.set_title(swims[0].note, loc="right")
