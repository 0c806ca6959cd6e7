"""Figures of set-points and of a track."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.hardware.tracker import Track
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, new_figure
from sim2real.report.series import Panel, series_figure
from sim2real.robot import Joint
from sim2real.signals import Excitation
from sim2real.viewers.scenes import COMMAND, SignalGroup

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def signal_figure(excitation: Excitation, joints: Sequence[Joint]) -> Figure:
    """Plot the set-points of each joint over time."""
    panels = []
    for j, joint in enumerate(joints):
        group = SignalGroup((joint.name,), "rad", excitation.t, {COMMAND: excitation.command[:, j]})
        low, high = joint.limits_rad
        title = f"{joint.name}: set-point, rad, within {low:g} to {high:g}; fastest "
        panels.append(Panel(group, f"{title}{excitation.largest_rate[j]:.2f} rad/s"))
    return series_figure(panels, "set-points")


def track_figure(track: Track, corners_m: Array) -> Figure:
    """Plot path and headings in the pool; the path is interrupted at missing frames."""
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    shape = (high[1] - low[1]) / (high[0] - low[0])
    with new_figure(560 * min(shape, 1.2) + 60, "Track of the body over the pool") as figure:
        axes = figure.subplots()
        axes.fill(*corners_m.T, facecolor="none", edgecolor=MUTED, linewidth=1.0)
        axes.plot(*track.pose[:, :2].T, color=ACCENT, linewidth=1.2)
        stride = max(1, round(1.0 / float(np.median(np.diff(track.t)))))
        x, y, yaw = track.pose[::stride][track.seen[::stride]].T
        axes.quiver(x, y, np.cos(yaw), np.sin(yaw), color=FAINT, width=0.004, scale=20)
        axes.plot(*track.pose[track.seen][0, :2], "o", color=INK, markersize=5)
        axes.grid(visible=False)
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        coverage = f"seen in {100 * track.seen.mean():.0f} % of {track.t.size} frames"
        axes.set_title(f"{coverage}; one arrow per second")
    return figure
