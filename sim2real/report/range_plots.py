"""Figures of the sources of ranges: latencies, predictions, densities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.inference.normal import Z90
from sim2real.posterior.predictive_check import PredictiveCheck
from sim2real.ranges.latency import Latencies, Spread
from sim2real.report.quantity import printable
from sim2real.report.series import drawable
from sim2real.report.style import ACCENT, FAINT, INK, PAPER, RULE, house_style, new_figure
from sim2real.robot import Density

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def density_figure(density: Density) -> Figure:
    """Plot each link as a bar with its length as width and its normalised density as height.

    The area of a bar is the link's share of the mass. Whiskers are 90 % intervals.
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
            margin = Z90 * density.sd
            axes.errorbar(middle, density.value, margin, fmt="none", ecolor=ACCENT, capsize=4)
        for x, y, name in zip(middle, density.value, density.links, strict=True):
            label = f"{printable(name)}\n{y:.3f}"
            axes.text(x, y / 2, label, ha="center", va="center", color=INK)
        axes.set_title("normalised density; dashed: whole robot")
        axes.set_xlabel("from the nose, m")
        axes.set_ylim(0, 1.15 * float(density.value.max()))
        axes.set_xlim(0, float(ends[-1]))
    return figure


def latency_figure(latencies: Latencies, drawn: Spread) -> Figure:
    """Plot the latency of each episode with two standard errors, and the range."""
    with house_style():
        figure = new_figure(230, "latency of the commands by episode")
        axes = figure.subplots()
        low, high = (1e3 * (drawn.centre + s * drawn.half_width) for s in (-1, 1))
        axes.axhspan(low, high, color=ACCENT, alpha=0.16, linewidth=0)
        number = np.arange(1, latencies.seconds.size + 1)
        axes.errorbar(
            number, 1e3 * latencies.seconds, 2e3 * latencies.sd, fmt="o", color=INK, ecolor=INK,
            markersize=4, markeredgewidth=0, elinewidth=1.0,
        )  # fmt: skip
        axes.set_title("latency, ms; band: the range")
        axes.set_xlabel("window" if latencies.windows else "recording")
        axes.locator_params(axis="x", integer=True)
        axes.margins(x=0.03)
    return figure


def predictive_figure(check: PredictiveCheck, joint: str) -> Figure:
    """Plot measured minus predicted (median) angles, and the 95 % band of the prediction."""
    with house_style():
        figure = new_figure(230, printable(f"{joint} in {check.recording}: residual"))
        axes = figure.subplots()
        seen = np.flatnonzero(np.isfinite(check.measured))
        part = slice(int(seen[0]), int(seen[-1]) + 1)
        t, middle = check.t[part], check.median[part]
        low, high = 1e3 * (check.band[:, part] - middle)
        axes.fill_between(t, low, high, color=ACCENT, alpha=0.16, linewidth=0)
        residual = 1e3 * (check.measured[part] - middle)
        axes.plot(*drawable(t, residual), color=INK, linewidth=0.7)
        axes.set_title("measured − predicted, mrad; band: 95 %")
        axes.set_xlabel("time, s")
    return figure
