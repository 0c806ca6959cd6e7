"""Corner plot of the posterior of one servo: marginal and pairwise distributions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.posterior.servo import ServoPosterior
from sim2real.report.quantity import printable
from sim2real.report.style import ACCENT, INK, PAPER, RULE, house_style, new_figure
from sim2real.units import readable_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DRAWN = 20000
_BINS, _GRID = 40, 36
_SHARES = (0.95, 0.8, 0.5)
_INSIDE = ("#e9d9d4", "#d99a89", ACCENT)


def corner_figure(posterior: ServoPosterior, joint: str) -> Figure:
    """Plot histograms on the diagonal and, below it, regions that contain 50, 80 and 95 %.

    Args:
        posterior: The posterior.
        joint: Name of the joint, for screen readers.
    """
    F = len(posterior.names)
    scale = np.array([1e3 if prior.unit == "s" else 1.0 for prior in posterior.parameters])
    values = posterior.values[:: max(1, posterior.values.shape[0] // _DRAWN)] * scale
    ends = np.quantile(values, [0.001, 0.999], axis=0)
    labels = [_label(p.name, "ms" if p.unit == "s" else p.unit) for p in posterior.parameters]
    with house_style():
        figure = new_figure(140 + 120 * F, printable(f"posterior of {joint}"))
        grid = figure.subplots(F, F, squeeze=False)
        for row in range(F):
            for column in range(F):
                axes = grid[row, column]
                if column > row:
                    axes.set_visible(False)
                    continue
                if row == column:
                    _histogram(axes, values[:, row], ends[:, row])
                    axes.set_title(labels[row], color=INK, size=10)
                else:
                    _regions(axes, values[:, [column, row]], ends[:, [column, row]])
                axes.set_xlim(*ends[:, column])
                axes.grid(visible=False)
                _ticks(axes, bottom=row == F - 1, left=column == 0 and row > 0)
    return figure


def _label(name: str, unit: str) -> str:
    return "\n".join([printable(readable_name(name)), unit]).strip()


def _histogram(axes: Axes, values: Array, ends: Array) -> None:
    axes.hist(values, bins=_BINS, range=tuple(ends), color=RULE)
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    axes.axvline(middle, color=ACCENT, linewidth=1.2)
    for end in (low, high):
        axes.axvline(end, color=ACCENT, linewidth=0.9, linestyle=(0, (3, 2)))


def _regions(axes: Axes, values: Array, ends: Array) -> None:
    """Fill the smallest regions that contain each share of the draws."""
    limits = (ends[:, 0], ends[:, 1])
    counts, x, y = np.histogram2d(values[:, 0], values[:, 1], bins=_GRID, range=limits)
    smooth = _smoothed(counts)
    order = np.sort(smooth.ravel())[::-1]
    cumulative = np.cumsum(order) / order.sum()
    levels = np.unique([order[np.searchsorted(cumulative, share)] for share in _SHARES])
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in (x, y)]
    colours = _INSIDE[-levels.size :]
    axes.contourf(*middles, smooth.T, levels=[*levels, order[0] + 1], colors=colours)
    axes.set_facecolor(PAPER)
    axes.set_ylim(*ends[:, 1])


def _smoothed(counts: Array) -> Array:
    """Counts smoothed twice with weights 1, 2, 1."""
    for _ in range(2):
        for axis in (0, 1):
            before = np.roll(counts, 1, axis)
            counts = (before + 2 * counts + np.roll(counts, -1, axis)) / 4
    return counts


def _ticks(axes: Axes, *, bottom: bool, left: bool) -> None:
    axes.locator_params(nbins=3)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelbottom=bottom, labelleft=left, labelsize=9, labelrotation=0)
    if bottom:
        axes.tick_params(axis="x", labelrotation=35)
    if not left:
        axes.set_yticks([])
