"""Horizontal bar charts with labels above the bars, legible on a phone."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sim2real.report.quantity import printable
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 48
_LINE, _BAR = 17.0, 20.0
_INDENT = 10
_TICK_RIGHT = 1
"""Matplotlib's marker for a tick to the right: the ends of a bracket."""


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        label: Label.
        value: Length.
        text: Number next to the bar.
        strong: Whether it is highlighted.
        members: Items that share the bar, listed below the label in a bracket.
    """

    label: str
    value: float
    text: str
    strong: bool = False
    members: tuple[str, ...] = ()


def bar_figure(panels: Mapping[str, Sequence[Bar]], label: str, *, full: float = 0.0) -> Figure:
    """Plot horizontal bars with labels above them, in panels below each other.

    A bar with an infinite value ends at the right edge.

    Args:
        panels: The bars by title of the panel.
        label: Text for screen readers.
        full: Minimum length of the axis.
    """
    bars = [bar for panel in panels.values() for bar in panel]
    reach = max([full, *(bar.value for bar in bars if math.isfinite(bar.value))]) or 1.0
    heights = [sum(map(_height, panel)) for panel in panels.values()]
    with house_style():
        total = sum(heights) + sum(36 if title else 16 for title in panels)
        figure = new_figure(total, printable(label))
        grid = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axes, (title, panel) in zip(grid, panels.items(), strict=True):
            _draw(axes, panel, reach)
            axes.set_xlim(0, 1.2 * reach)
            axes.set_title(printable(title), color=INK)
    return figure


def _wrapped(label: str) -> list[str]:
    return textwrap.wrap(printable(label), _COLUMNS) or [""]


def _member_lines(bar: Bar) -> list[str]:
    return [line for member in bar.members for line in _wrapped(member)]


def _height(bar: Bar) -> float:
    return _LINE * (len(_wrapped(bar.label)) + len(_member_lines(bar))) + _BAR


def _draw(axes: Axes, bars: Sequence[Bar], reach: float) -> None:
    y = 0.0
    for bar in bars:
        lines, members = _wrapped(bar.label), _member_lines(bar)
        axes.text(0, y, "\n".join(lines), va="top", color=INK if bar.strong else MUTED)
        y += _LINE * len(lines)
        if members:
            _bracket(axes, y, members)
            y += _LINE * len(members)
        _bar(axes, bar, y + 6, reach)
        y += _BAR
    axes.set_ylim(y, 0)
    axes.grid(visible=False)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines["bottom"].set_visible(False)


def _bar(axes: Axes, bar: Bar, y: float, reach: float) -> None:
    value = max(bar.value, 0.0) if math.isfinite(bar.value) else reach
    colour = ACCENT if bar.strong else FAINT
    axes.barh(y, value, height=8, color=colour, linewidth=0)
    look: Any = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "size": 10}
    axes.annotate(bar.text, (value, y), color=INK, **look)


def _bracket(axes: Axes, y: float, lines: Sequence[str]) -> None:
    """Lines of text from ``y`` on, with a bracket to their left."""
    look: Any = {"xytext": (_INDENT, 0), "textcoords": "offset points", "va": "top"}
    for number, text in enumerate(lines):
        axes.annotate(text, (0, y + _LINE * number), color=INK, **look)
    ends = [y + 3, y + _LINE * len(lines) - 3]
    mark: Any = {"marker": _TICK_RIGHT, "markersize": 4, "markeredgewidth": 1.2, "linewidth": 1.2}
    (line,) = axes.plot([0, 0], ends, color=INK, clip_on=False, **mark)
    line.set_in_layout(False)
