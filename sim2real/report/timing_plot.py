"""Figure of the sampling times of a recording: jitter and gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.recording import Recording
from sim2real.report.quantity import printable
from sim2real.report.series import drawable, gaps
from sim2real.report.style import ACCENT, INK, MUTED, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABEL_WIDTH = 0.2  # of the time axis, on a phone


def timing_figure(recording: Recording) -> Figure:
    """Plot the time between samples over the recording, with its histogram.

    Gaps (over three times the median) are drawn as marks at the upper edge, the longest labelled
    with their length.
    """
    interval = 1e3 * np.diff(recording.t)
    after_gap = gaps(recording.t)
    regular = np.ones(interval.size, dtype=bool)
    regular[after_gap - 1] = False
    with house_style():
        figure = new_figure(250, printable(f"{recording.name}: time between samples"))
        over_time, counts = figure.subplots(1, 2, sharey=True, width_ratios=(4, 1))
        bottom, top = _range(interval[regular])
        over_time.plot(
            *drawable(recording.t[1:][regular], interval[regular]),
            "o",
            color=INK,
            markersize=1.6,
            mew=0,
        )
        over_time.set_ylim(bottom, top)
        over_time.set_xlim(recording.t[0], recording.t[-1])
        over_time.set_xlabel("time, s")
        over_time.set_title(_title(interval, interval[~regular]))
        _mark_gaps(over_time, recording.t[after_gap], interval[after_gap - 1], top)
        bins = np.linspace(bottom, top, 61)
        counts.hist(
            interval[regular], bins=bins, orientation="horizontal", histtype="stepfilled", color=INK
        )
        counts.grid(False)
        counts.set_xlabel("samples")
        counts.locator_params(axis="x", nbins=2)
    return figure


def _title(interval: Array, missing: Array) -> str:
    low, median, high = np.percentile(interval, (5, 50, 95))
    title = f"ms between samples: {median:.1f}, nine in ten {low:.1f} to {high:.1f}\n"
    if not missing.size:
        return title + "no gaps"
    gap = "1 gap of" if missing.size == 1 else f"{missing.size} gaps, the longest"
    return title + f"{gap} {missing.max():.0f} ms"


def _range(interval: Array) -> tuple[float, float]:
    """Limits of the interval axis: symmetric about the median, at least 25 % to either side."""
    median = float(np.median(interval))
    reach = max(1.6 * float(np.abs(interval - median).max()), 0.25 * median)
    return max(0.0, median - reach), median + reach


def _mark_gaps(axes: Axes, t: Array, length: Array, top: float) -> None:
    axes.plot(t, np.full(t.size, top), "v", color=ACCENT, markersize=6, mew=0, clip_on=False)
    start, stop = axes.get_xlim()
    labelled: list[float] = []
    for index in np.argsort(-length, kind="stable"):
        if any(abs(t[index] - label) < _LABEL_WIDTH * (stop - start) for label in labelled):
            continue
        labelled.append(float(t[index]))
        at_the_end = t[index] > stop - _LABEL_WIDTH * (stop - start)
        axes.annotate(
            f"{length[index]:.0f} ms",
            (t[index], top),
            xytext=(-6 if at_the_end else 6, -3),
            textcoords="offset points",
            ha="right" if at_the_end else "left",
            va="top",
            color=MUTED,
            size=10,
        )
