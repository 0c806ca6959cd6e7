"""Latency episode by episode, and what a posterior predicts of a recording it never saw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.posterior.check import Check
from sim2real.ranges.latency import Latencies
from sim2real.ranges.spread import Spread
from sim2real.report.quantity import printable
from sim2real.report.series import drawable
from sim2real.report.style import ACCENT, INK, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def latency_figure(found: Latencies, drawn: Spread) -> Figure:
    """Draw the latency of each episode with two standard errors, and the range behind them."""
    with house_style():
        figure = new_figure(230, "latency of the commands, episode by episode")
        axes = figure.subplots()
        low, high = (1e3 * (drawn.centre + s * drawn.half_width) for s in (-1, 1))
        axes.axhspan(low, high, color=ACCENT, alpha=0.16, linewidth=0)
        number = np.arange(1, found.seconds.size + 1)
        axes.errorbar(
            number, 1e3 * found.seconds, 2e3 * found.sd, fmt="o", color=INK, ecolor=INK,
            markersize=4, markeredgewidth=0, elinewidth=1.0,
        )  # fmt: skip
        axes.set_title("latency, ms; band: the range")
        axes.set_xlabel("window" if found.windows else "recording")
        axes.locator_params(axis="x", integer=True)
        axes.margins(x=0.03)
    return figure


def predictive_figure(check: Check, joint: str) -> Figure:
    """Draw measured angles less the median prediction, and the band that should hold 95 %."""
    with house_style():
        figure = new_figure(230, printable(f"{joint} in {check.recording}: off its prediction"))
        axes = figure.subplots()
        seen = np.flatnonzero(np.isfinite(check.measured))
        part = slice(int(seen[0]), int(seen[-1]) + 1)
        t, middle = check.t[part], check.median[part]
        low, high = 1e3 * (check.band[:, part] - middle)
        axes.fill_between(t, low, high, color=ACCENT, alpha=0.16, linewidth=0)
        off = 1e3 * (check.measured[part] - middle)
        axes.plot(*drawable(t, off), color=INK, linewidth=0.7)
        axes.set_title("measured − predicted, mrad; band: 95 % of predictions")
        axes.set_xlabel("time, s")
    return figure
