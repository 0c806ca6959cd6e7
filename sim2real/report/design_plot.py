"""The design of a recording as text, figure and page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.design.plan import Design, JointDesign
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Section, Table
from sim2real.report.quantity import printable
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, PAPER, house_style, new_figure
from sim2real.units import readable_name, three_digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure as MplFigure

_LEAD = (
    "Commands of {seconds:.0f} s that are expected to determine {joint} best, from what its "
    "{origin} says; {count} commands were compared. Intervals are those of 'identify' on this "
    "recording alone, relative to the parameter."
)
_CAPTION = (
    "Command and expected motion; half-width of the 90 % interval of each parameter if the "
    "recording ended there, in percent of its value; and the share of each parameter's information "
    "that comes from each part of the recording (the square of the angle's derivative)."
)
_PART_S = 0.5
_LINES = ("-", "--", "-.", ":", (0, (6, 1)), (0, (1, 1)))


def design_report(design: Design) -> str:
    """Expected half-width of the interval of each parameter, by joint."""
    lines = []
    for name, joint in design.joints.items():
        lines += [f"{printable(name)}, expected 90 % intervals, from what its {joint.origin} says"]
        if np.isfinite(held := joint.limits.largest_held_rad):
            lines += [f"  within {held:.2g} rad of hanging, where its servo can hold the load"]
        for parameter, width in joint.expected.items():
            known = "" if joint.determined[parameter] else "  not determined"
            label = readable_name(parameter)
            lines.append(f"  {label:<24} ± {three_digits(100 * width):>5} %{known}")
    return "\n".join(lines)


def design_section(design: Design, name: str) -> Section:
    """Table and figure of one joint."""
    joint = design.joints[name]
    rows = [
        (
            readable_name(parameter),
            f"± {three_digits(100 * width)} %",
            "yes" if joint.determined[parameter] else "no",
        )
        for parameter, width in joint.expected.items()
    ]
    blocks: list[Block] = [
        Table(("parameter", "expected 90 % interval", "determined"), rows),
        Figure(svg(design_figure(design.t, name, joint)), _CAPTION),
    ]
    lead = _LEAD.format(
        seconds=len(design.t) * joint.limits.period_s,
        joint=printable(name),
        origin=joint.origin,
        count=joint.found.evaluated,
    )
    return Section(f"Next recording of {printable(name)}", lead, blocks)


def design_figure(t: Array, name: str, joint: JointDesign) -> MplFigure:
    """Plot a command (T,), what it tells over time, and where that comes from."""
    parts = max(round(float(t[-1]) / _PART_S), 1)
    edges = np.linspace(0.0, float(t[-1]), parts + 1)
    names = [readable_name(parameter) for parameter in joint.prior.names]
    angle, slopes = joint.information.sensitivities(joint.found.command[None])
    with house_style():
        figure = new_figure(600, printable(f"{name}: designed command and its information"))
        grid = figure.add_gridspec(3, 1, height_ratios=(2.0, 2.0, 0.35 * len(names)))
        signal = figure.add_subplot(grid[0])
        _draw_signal(signal, t, joint, angle[0, 0])
        widths = figure.add_subplot(grid[1], sharex=signal)
        _draw_widths(widths, edges[1:], 100 * joint.over_time(parts), names, joint)
        shares = figure.add_subplot(grid[2], sharex=signal)
        energy = _shares(slopes[0], parts)
        shares.pcolormesh(edges, np.arange(len(names) + 1), energy.T, cmap=_map(), vmin=0.0)
        shares.set_yticks(np.arange(len(names)) + 0.5, names)
        shares.invert_yaxis()
        shares.grid(visible=False)
        shares.set_title("where the information comes from")
        shares.set_xlabel("time, s")
        for axes in (signal, widths):
            axes.tick_params(labelbottom=False)
    return figure


def _draw_signal(axes: Axes, t: Array, joint: JointDesign, angle: Array) -> None:
    command = joint.found.command
    axes.plot(t, command, color=FAINT, linewidth=0.9, drawstyle="steps-post", label="command")
    axes.plot(t, angle, color=INK, linewidth=0.9, label="expected motion")
    for end in joint.limits.position_rad:
        axes.axhline(end, color=MUTED, linewidth=0.7, linestyle=":")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1.02), ncols=2)
    axes.set_title("rad; dotted: limits")


def _draw_widths(
    axes: Axes, ends: Array, percent: Array, names: list[str], joint: JointDesign
) -> None:
    """Half-widths of the intervals in percent, shape (parts, F)."""
    determined = list(joint.determined.values())
    for k, name in enumerate(names):
        color, style = ACCENT if determined[k] else FAINT, _LINES[k % len(_LINES)]
        axes.plot(ends, percent[:, k], color=color, linestyle=style, linewidth=1.2, label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.6 * percent[-1].min(), 900.0)
    axes.yaxis.set_major_formatter(lambda value, _: three_digits(value))
    axes.yaxis.set_minor_formatter(lambda value, _: "")
    axes.set_title("half-width of the 90 % interval, % (grey: not determined)")
    axes.legend(loc="upper right", ncols=min(len(names), 3), handlelength=2.2)


def _shares(slopes: Array, parts: int) -> Array:
    """Share of each part in the sum of squared derivatives (D, T, F), shape (parts, F)."""
    share = slopes**2 / np.maximum(np.sum(slopes**2, axis=1, keepdims=True), 1e-30)
    split = np.array_split(share, parts, axis=1)
    return np.array([part.sum(axis=1).mean(axis=0) for part in split])


def _map() -> Colormap:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("information", [PAPER, ACCENT])
