"""Figures of the report: their style, PNG files, and SVG elements for pages."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from sim2real.errors import optional
from sim2real.output import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, FAINT, RULE = "#1c1e21", "#6a7078", "#a3a8af", "#dcdee1"
ACCENT, PAPER = "#c73e1d", "#ffffff"
VARIABLES = {
    INK: "ink", MUTED: "muted", FAINT: "faint", RULE: "rule", ACCENT: "accent", PAPER: "paper",
}  # fmt: skip
"""CSS variables that a page sets for light, dark and print; elsewhere the colours are used."""
WIDE = 720
POINTS_PER_INCH = 72
PNG_DPI = 150
MARGIN_INCHES = 0.15
# Without date and program, so that equal figures give equal files.
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))

STYLE: dict[Any, Any] = {
    **dict.fromkeys(("axes.edgecolor", "grid.color", "xtick.color"), RULE),
    **dict.fromkeys(
        ("axes.labelcolor", "axes.titlecolor", "xtick.labelcolor", "ytick.labelcolor"), MUTED
    ),
    **{f"axes.spines.{side}": False for side in ("left", "right", "top")},
    **dict.fromkeys(("font.size", "axes.titlesize"), 11.5),
    "font.family": "sans-serif",
    "text.color": INK,
    "text.parse_math": False,  # a $ in a joint's name is a $
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.titlelocation": "left",
    "axes.titlepad": 9,
    "axes.xmargin": 0.0,
    "axes.ymargin": 0.08,
    "axes.facecolor": "none",
    "figure.facecolor": PAPER,
    "figure.constrained_layout.h_pad": 0.1,
    "figure.constrained_layout.w_pad": 0.04,  # fonts of browsers are a little wider
    "figure.constrained_layout.wspace": 0.05,
    "grid.linewidth": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 0,
    "legend.frameon": False,
    "legend.labelcolor": "linecolor",
    "legend.handlelength": 1.0,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.1,
    "legend.borderpad": 0.0,
    "legend.borderaxespad": 0.3,
    **{f"lines.{kind}_capstyle": "round" for kind in ("solid", "dash")},
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


@contextmanager
def new_figure(height: float, label: str) -> Iterator[Figure]:
    """An empty figure of ``WIDE`` by ``height`` points, one pixel each, to be drawn in the style.

    ``label`` is for screen readers. Notebooks show the figure where pyplot is not imported, too.
    """
    with house_style():
        from matplotlib.figure import Figure

        size = (WIDE / POINTS_PER_INCH, height / POINTS_PER_INCH)
        figure = Figure(size, layout="constrained", label=label)
        figure._repr_png_ = lambda: _png(figure, bbox_inches="tight")  # type: ignore[attr-defined]
        yield figure


def _png(figure: Figure, **look: Any) -> bytes:  # noqa: ANN401 - of savefig
    stream = io.BytesIO()
    with house_style():
        figure.savefig(stream, format="png", **look)
    return stream.getvalue()


def save_png(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write ``figure`` to ``path`` at 150 dots per inch."""
    look = {"bbox_inches": "tight", "pad_inches": MARGIN_INCHES, "metadata": {"Software": None}}
    with _unchanged(figure):
        return write_whole(path, _png(figure, dpi=PNG_DPI, **look))


def svg(figure: Figure) -> str:
    """``figure`` as an ``<svg>`` element of a page: no fixed size, text as text, colours by CSS."""
    stream = io.StringIO()
    with _unchanged(figure), house_style():
        figure.savefig(stream, format="svg", transparent=True, metadata=_NO_METADATA)
    return _inline(stream.getvalue(), str(figure.get_label()))


@contextmanager
def _unchanged(figure: Figure) -> Iterator[None]:
    """Restore the positions of a figure's panels at the end, which drawing moves."""
    places = [
        (panel, panel.get_position(original=True), panel.get_position()) for panel in figure.axes
    ]
    yield
    for panel, original, active in places:
        panel._set_position(original, which="original")  # type: ignore[attr-defined]
        panel._set_position(active, which="active")  # type: ignore[attr-defined]


def _inline(document: str, label: str) -> str:
    """The drawing of Matplotlib's SVG file: without its size, style sheet, fonts and comments."""
    view = re.search(r'viewBox="[^"]*"', document)
    assert view is not None
    body = document[document.index(">", document.index("<svg")) + 1 :]
    body = re.sub(r"(?s)<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", "", body)
    used = dict.fromkeys(re.findall(r'(?:url\(|href=")#([\w-]+)', body))
    digest = sha256(document.encode()).hexdigest()[:8]
    variables = {colour: f"var(--{name}, {colour})" for colour, name in VARIABLES.items()}
    ids = {name: f"f{digest}-{number}" for number, name in enumerate(used)}
    for pattern, replaced in (
        (r' id="([^"]*)"', lambda m: f' id="{ids[m[1]]}"' if m[1] in ids else ""),
        (r'(url\(|href=")#([\w-]+)', lambda m: f"{m[1]}#{ids[m[2]]}"),
        (r"xlink:href", lambda _: "href"),
        (r"font-family: [^;\"]*; ", lambda _: ""),
        (r"(?<=: )#[0-9a-f]{6}", lambda m: variables.get(m[0], m[0])),
        (r' (?:d|x|y)="[^"]*"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0])),
        (r"\s*\n\s*", lambda _: " "),
    ):
        body = re.sub(pattern, replaced, body)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {view[0]} role="img"'
    look = 'font-family="sans-serif" stroke-linejoin="round"'
    return f"{head} aria-label={quoteattr(label)} {look}>{body.strip()}"
