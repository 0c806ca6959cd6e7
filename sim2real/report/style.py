"""Style of all figures of the report."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from sim2real.errors import optional

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, FAINT, RULE = "#1c1e21", "#6a7078", "#a3a8af", "#dcdee1"
ACCENT, PAPER = "#c73e1d", "#ffffff"
# CSS variables that a page sets for light, dark and print; elsewhere the colours are used.
VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    FAINT: "faint",
    RULE: "rule",
    ACCENT: "accent",
    PAPER: "paper",
}
WIDE = 720
POINTS_PER_INCH = 72

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 11.5,
    "text.color": INK,
    "text.parse_math": False,  # a $ in a joint's name is a $
    "axes.edgecolor": RULE,
    "axes.labelcolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.left": False,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.titlelocation": "left",
    "axes.titlesize": 11.5,
    "axes.titlecolor": MUTED,
    "axes.titlepad": 9,
    "axes.xmargin": 0.0,
    "axes.ymargin": 0.08,
    "axes.facecolor": "none",
    "figure.facecolor": PAPER,
    "figure.constrained_layout.h_pad": 0.1,
    "figure.constrained_layout.w_pad": 0.04,  # fonts of browsers are a little wider
    "figure.constrained_layout.wspace": 0.05,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": RULE,
    "xtick.labelcolor": MUTED,
    "xtick.major.size": 3,
    "ytick.major.size": 0,
    "ytick.labelcolor": MUTED,
    "legend.frameon": False,
    "legend.labelcolor": "linecolor",
    "legend.handlelength": 1.0,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.1,
    "legend.borderpad": 0.0,
    "legend.borderaxespad": 0.3,
    "lines.solid_capstyle": "round",
    "lines.dash_capstyle": "round",
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "none",
    "svg.hashsalt": "sim2real",
    "savefig.bbox": None,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Context manager that sets Matplotlib's style to that of the report."""
    with optional("plots and pages"):
        from matplotlib import rc_context
    with rc_context(STYLE):
        yield


def new_figure(height: float, label: str) -> Figure:
    """An empty figure of ``WIDE`` by ``height`` points, one pixel each, for screen readers."""
    size = (WIDE / POINTS_PER_INCH, height / POINTS_PER_INCH)
    return _notebook_figure()(figsize=size, layout="constrained", label=label)


@cache
def _notebook_figure() -> type[Figure]:
    """Matplotlib's figure, which notebooks also show where pyplot is not imported."""
    with optional("plots and pages"):
        from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            with house_style():
                self.savefig(stream, format="png", bbox_inches="tight")
            return stream.getvalue()

    return NotebookFigure
