"""How a robot's mass is spread along it, drawn from nose to tail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.density import Z90, Density
from sim2real.report.quantity import printable
from sim2real.report.style import ACCENT, FAINT, INK, PAPER, RULE, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def density_figure(density: Density) -> Figure:
    """Draw each link as a block: as wide as it is long, as high as its normalised density.

    The area of a block is the link's share of the mass. Whiskers are 90 % intervals.
    """
    ends = np.concatenate([[0.0], np.cumsum(density.length_m)])
    middle = (ends[:-1] + ends[1:]) / 2
    with house_style():
        figure = new_figure(260, "normalised density of each link along the body")
        axes = figure.subplots()
        axes.bar(ends[:-1], density.value, density.length_m, align="edge", color=RULE,
                 edgecolor=PAPER, linewidth=1.5)  # fmt: skip
        axes.axhline(1.0, color=FAINT, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.plot(middle, density.value, "o", color=ACCENT, markersize=5, markeredgewidth=0)
        if density.sd is not None:
            half = Z90 * density.sd
            axes.errorbar(middle, density.value, half, fmt="none", ecolor=ACCENT, capsize=4)
        for x, y, name in zip(middle, density.value, density.links, strict=True):
            label = f"{printable(name)}\n{y:.3f}"
            axes.text(x, y / 2, label, ha="center", va="center", color=INK)
        axes.set_title("normalised density; the dashed line is the whole robot's")
        axes.set_xlabel("from the nose, m")
        axes.set_ylim(0, 1.15 * float(density.value.max()))
        axes.set_xlim(0, float(ends[-1]))
    return figure
