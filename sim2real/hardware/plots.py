"""Figures of set-points and of a track."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.hardware.tracker import Track
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, house_style, new_figure
from sim2real.robot import Joint
from sim2real.signals import Excitation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def signal_figure(excitation: Excitation, joints: Sequence[Joint]) -> Figure:
    """Plot the set-points of each joint over time with its limits."""
    with house_style():
        figure = new_figure(60 + 120 * len(joints), "set-points")
        panels = figure.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0]
        for j, (axes, joint) in enumerate(zip(panels, joints, strict=True)):
            axes.step(excitation.t, excitation.command[:, j], where="post", color=INK, lw=1.0)
            for limit in joint.limits_rad:
                axes.axhline(limit, color=ACCENT, lw=0.8)
            fastest = f"fastest {excitation.largest_rate[j]:.2f} rad/s"
            axes.set_title(f"{joint.name}: set-point, rad; limits red; {fastest}")
        panels[-1].set_xlabel("time, s")
    return figure


_ARROW_M = 0.18


def track_figure(track: Track, corners_m: Array) -> Figure:
    """Plot path and headings in the pool; the path is interrupted at missing frames."""
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    shape = (high[1] - low[1]) / (high[0] - low[0])
    with house_style():
        figure = new_figure(560 * min(shape, 1.2) + 60, "Track of the body over the pool")
        axes = figure.subplots()
        axes.fill(*corners_m.T, facecolor="none", edgecolor=MUTED, linewidth=1.0)
        axes.plot(*track.pose[:, :2].T, color=ACCENT, linewidth=1.2)
        stride = max(1, round(1.0 / float(np.median(np.diff(track.t)))))
        shown = track.pose[::stride][track.seen[::stride]]
        ends = shown[:, :2] + _ARROW_M * np.stack([np.cos(shown[:, 2]), np.sin(shown[:, 2])], 1)
        for (x, y, _), (x1, y1) in zip(shown, ends, strict=True):
            axes.annotate(
                "", (x1, y1), (x, y), arrowprops={"arrowstyle": "->", "color": FAINT, "lw": 1.0}
            )
        start = track.pose[track.seen][0]
        axes.plot(start[0], start[1], "o", color=INK, markersize=5)
        axes.grid(visible=False)
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        coverage = f"seen in {100 * track.seen.mean():.0f} % of {track.t.size} frames"
        axes.set_title(f"{coverage}; one arrow per second")
    return figure
