"""A validation case as a section of a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim.cases.case import Case, Curve
from sim2real.report.page import Block, Figure, Section, Table, Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_MARKED = 40
"""Number of points from which a curve is drawn without markers."""


def cases_section(case: Case, seconds: float) -> Section:
    """Computed and published figures, and the curves."""
    rows = [
        (
            figure.quantity,
            f"{figure.ours:.5g}",
            f"{figure.reference:.5g}",
            f"{100 * figure.error:.2f} %",
            "" if figure.bar is None else f"{100 * figure.bar:g} %",
            "" if figure.bar is None else "met" if figure.met else "MISSED",
        )
        for figure in case.figures
    ]
    header = ("", "ours", "published", "error", "bar", "")
    blocks: list[Block] = [Table(header, rows, caption=f"Source: {case.source}.")]
    blocks += [_picture(curve) for curve in case.curves]
    blocks.append(Text(f"{case.setup}; {seconds:.0f} s."))
    met = sum(figure.met for figure in case.figures)
    return Section(case.title, f"{met} of {len(case.figures)} figures within their bars.", blocks)


def _picture(curve: Curve) -> Figure:
    from sim2real.report.drawing import svg

    drawing = curve_figure(curve)
    return Figure(svg(drawing), curve.title)


def curve_figure(curve: Curve) -> Drawing:
    """Plot the computed and the published curve, with margins for markers at the axis ends."""
    from sim2real.report.style import ACCENT, INK, house_style, new_figure

    with house_style():
        figure = new_figure(260, curve.title)
        axes = figure.subplots()
        many = curve.x.size >= _MARKED
        axes.plot(curve.x, curve.y, "-" if many else "o-", color=INK, markersize=4, label="ours")
        if curve.reference_x.size:
            marked = curve.reference_x.size < _MARKED
            axes.plot(
                curve.reference_x, curve.reference_y, "o" if marked else "-", color=ACCENT,
                markersize=5, fillstyle="none", label="published",
            )  # fmt: skip
            figure.legend(loc="outside upper right", ncols=2)
        axes.margins(x=0.02)
        axes.set_xlabel(curve.x_label)
        axes.set_title(curve.y_label)
    return figure
