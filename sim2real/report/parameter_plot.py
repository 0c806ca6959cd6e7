"""Figure of the fitted parameters of all joints with their 90 % intervals."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sim2real.model import JointModel, Model
from sim2real.report.quantity import Quantity, printable, quantities
from sim2real.report.style import ACCENT, INK, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = 3  # kp, kd, latency
_LONGEST_NAME = 14
_FARTHEST = 2.5  # intervals beyond this many times the largest value are cut off


def parameter_figure(model: Model) -> Figure:
    """Plot kp, kd and latency: one panel each, one row per joint, with 90 % intervals.

    Arrows mark intervals that are unbounded or exceed the panel. If one joint is identified only
    per unit of inertia, all are plotted that way, so that a panel has one unit.
    """
    joints = dict(model.joints)
    if any(joint.per_inertia for joint in joints.values()):
        joints = {name: _per_inertia(joint) for name, joint in joints.items()}
    rows = [quantities(joint) for joint in joints.values()]
    with house_style():
        figure = new_figure(62 + 34 * max(1, len(rows)), "kp, kd and latency of each joint")
        panels = figure.subplots(1, _PANELS, sharey=True, squeeze=False)[0]
        for number, axes in enumerate(panels):
            _draw_panel(axes, [row[number] for row in rows])
        names = [_label(name) for name in joints]
        panels[0].set_yticks(range(len(names)), names)
        panels[0].tick_params(axis="y", labelcolor=INK)
        panels[0].set_ylim(len(names) - 0.4, -0.6)
    return figure


def _draw_panel(axes: Axes, column: list[Quantity]) -> None:
    lowest, highest = _range(column)
    for row, quantity in enumerate(column):
        low, high = quantity.interval or (quantity.value, quantity.value)
        axes.plot([max(low, lowest), min(high, highest)], [row, row], color=INK, linewidth=1.2)
        if low < lowest:
            axes.plot(lowest, row, "<", color=INK, markersize=5, clip_on=False)
        if high > highest:
            axes.plot(highest, row, ">", color=INK, markersize=5, clip_on=False)
        axes.plot(quantity.value, row, "o", color=ACCENT, markersize=5, markeredgewidth=0)
        axes.annotate(
            quantity.texts[0],
            (quantity.value, row),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            color=INK,
            size=10,
        )
    if column:
        axes.set_title(f"{column[0].name}, {column[0].unit}")
    axes.set_xlim(lowest, highest)
    axes.locator_params(axis="x", nbins=3)
    axes.xaxis.set_major_formatter("{x:g}")


def _label(name: str) -> str:
    name = printable(name)
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"


def _range(column: list[Quantity]) -> tuple[float, float]:
    """Limits of a panel: all intervals with a margin, except very wide ones."""
    values = [quantity.value for quantity in column]
    reach = _FARTHEST * max(values, default=1.0)
    ends = [end for quantity in column for end in quantity.interval or () if abs(end) <= reach]
    low, high = min(values + ends, default=0.0), max(values + ends, default=1.0)
    air = max(0.2 * (high - low), 0.05 * abs(high)) or 1.0
    return max(0.0, low - air) if low >= 0 else low - air, high + air


def _per_inertia(joint: JointModel) -> JointModel:
    inertia = joint.inertia_kgm2
    gains = ("kp_Nm_per_rad", "kd_Nms_per_rad")
    scaled = {
        key: (low / inertia, high / inertia)
        for key, (low, high) in joint.interval.items()
        if key in gains
    }
    return replace(
        joint,
        kp_Nm_per_rad=joint.kp_Nm_per_rad / inertia,
        kd_Nms_per_rad=joint.kd_Nms_per_rad / inertia,
        inertia_kgm2=1.0,
        per_inertia=True,
        interval={**joint.interval, **scaled},
    )
