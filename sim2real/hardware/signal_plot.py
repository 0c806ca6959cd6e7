"""The set-points that will be played, joint by joint, with the limits they keep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sim2real.report.style import ACCENT, INK, house_style, new_figure
from sim2real.robot import Joint
from sim2real.signals import Excitation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def signal_figure(excitation: Excitation, joints: Sequence[Joint]) -> Figure:
    """Draw each joint's set-points over time between its limits."""
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
