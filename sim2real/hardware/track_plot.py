"""The track over the pool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.hardware.tracker import Track
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim2real.hardware.camera_file import Array

_ARROW_M = 0.18


def track_figure(track: Track, corners_m: Array) -> Figure:
    """Way and headings over the pool's outline; where it was not seen the way is broken."""
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    shape = (high[1] - low[1]) / (high[0] - low[0])
    with house_style():
        figure = new_figure(560 * min(shape, 1.2) + 60, "Track of the body over the pool")
        axes = figure.subplots()
        axes.fill(*corners_m.T, facecolor="none", edgecolor=MUTED, linewidth=1.0)
        axes.plot(*track.pose[:, :2].T, color=ACCENT, linewidth=1.2)
        every = max(1, round(1.0 / float(np.median(np.diff(track.t)))))
        shown = track.pose[::every][track.seen[::every]]
        ends = shown[:, :2] + _ARROW_M * np.stack([np.cos(shown[:, 2]), np.sin(shown[:, 2])], 1)
        for (x, y, _), (x1, y1) in zip(shown, ends, strict=True):
            axes.annotate(
                "", (x1, y1), (x, y), arrowprops={"arrowstyle": "->", "color": FAINT, "lw": 1.0}
            )
        first = track.pose[track.seen][0]
        axes.plot(first[0], first[1], "o", color=INK, markersize=5)
        axes.grid(visible=False)
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        seen = f"seen in {100 * track.seen.mean():.0f} % of {track.t.size} frames"
        axes.set_title(f"{seen}; an arrow a second")
    return figure
