"""Measured against simulated surge, sway, yaw and first joint, before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim.inference.swims import HELD_OUT_SHARE, SIGNALS, UNITS, Simulator, Swim, simulated
from sim2real.arrays import Array
from sim2real.model import Model
from sim2real.report.drawing import svg
from sim2real.report.live_plot import Live, Panel
from sim2real.report.page import Block
from sim2real.report.page import Figure as PageFigure
from sim2real.report.style import ACCENT, FAINT, INK, NARROW, house_style, new_figure
from sim2real.robot import Robot
from sim2real.viewers.signal_group import MEASURED, SignalGroup

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def comparison(
    swim: Swim, before: Model, after: Model, simulator: Simulator, robot: Robot
) -> Figure:
    """Surge, sway, yaw rate and the first joint, with the held-out part shaded.

    Args:
        swim: The recorded swim.
        before: The model before the fit.
        after: The fitted model.
        simulator: Simulator of both.
        robot: The robot.
    """
    tracks = simulated(swim, [before, after], simulator)
    return _drawn(swim, tracks, robot, "calibrated", HELD_OUT_SHARE)


def comparison_block(
    swim: Swim,
    before: Model,
    after: Model,
    simulator: Simulator,
    robot: Robot,
    caption: str,
    *,
    label: str = "calibrated",
    held_out: float = HELD_OUT_SHARE,
) -> Block:
    """The same for a page, with plots to zoom into; other arguments as for ``comparison``.

    ``label`` names the fitted model; ``held_out`` is the share, at the end, that it did not use.
    """
    tracks = simulated(swim, [before, after], simulator)
    drawing = _drawn(swim, tracks, robot, label, held_out)
    end = float(swim.t[-1])
    shaded = [(end * (1 - held_out), end)] if held_out else []
    panels = []
    for k, (name, unit) in enumerate(_signals(robot)):
        values = (swim.signals[:, k], tracks[0][:, k], tracks[1][:, k])
        signals = dict(zip((MEASURED, "before", label), values, strict=True))
        group = SignalGroup((swim.name, name), unit, swim.t, signals)
        panels.append(Panel(group, f"{name}, {unit}", shaded))
    live = Live(panels, caption)
    return PageFigure(svg(drawing), caption, svg(drawing, width=NARROW), live)


def _signals(robot: Robot) -> list[tuple[str, str]]:
    """Names and units of what is plotted."""
    return [*zip(SIGNALS, UNITS, strict=True), (robot.joints[0].name, "rad")]


def _drawn(swim: Swim, tracks: Array, robot: Robot, label: str, held_out: float) -> Figure:
    """The figure of the simulated signals before and after, shape (2, T, 3 + J)."""
    initial, fitted = tracks
    names = [f"{name} ({unit})" for name, unit in _signals(robot)]
    with house_style():
        figure = new_figure(620, f"{swim.name}: measured and simulated")
        axes = figure.subplots(len(names), 1, sharex=True)
        for k, (axis, name) in enumerate(zip(axes, names, strict=True)):
            axis.plot(swim.t, swim.signals[:, k], color=INK, linewidth=1.4, label="measured")
            axis.plot(swim.t, initial[:, k], color=FAINT, linewidth=1, label="before")
            axis.plot(swim.t, fitted[:, k], color=ACCENT, linewidth=1, label=label)
            if held_out:
                axis.axvspan(swim.t[-1] * (1 - held_out), swim.t[-1], color=FAINT, alpha=0.15)
            axis.set_ylabel(name)
        axes[-1].set_xlabel("time (s); shaded: held out" if held_out else "time (s)")
        figure.legend(*axes[0].get_legend_handles_labels(), ncols=3, loc="outside upper right")
    return figure
