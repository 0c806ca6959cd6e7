"""Output of figures: PNG files, and SVG elements for pages."""

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

from sim2real.output import write_whole
from sim2real.report.style import VARIABLES, house_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_DPI = 150
MARGIN_INCHES = 0.15
# Without date and program, so that equal figures give equal files.
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


def save_png(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write ``figure`` to ``path`` at 150 dots per inch."""
    stream = io.BytesIO()
    look: dict[str, Any] = {"bbox_inches": "tight", "pad_inches": MARGIN_INCHES}
    with _unchanged(figure), house_style():
        figure.savefig(stream, format="png", dpi=PNG_DPI, metadata={"Software": None}, **look)
    return write_whole(path, stream.getvalue())


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
    ids = {name: f"f{digest}-{number}" for number, name in enumerate(used)}
    for pattern, replaced in (
        (r' id="([^"]*)"', lambda m: f' id="{ids[m[1]]}"' if m[1] in ids else ""),
        (r'(url\(|href=")#([\w-]+)', lambda m: f"{m[1]}#{ids[m[2]]}"),
        (r"xlink:href", lambda _: "href"),
        (r"font-family: [^;\"]*; ", lambda _: ""),
        (r"(?<=: )#[0-9a-f]{6}", _variable),
        (r' (?:d|x|y)="[^"]*"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0])),
        (r"\s*\n\s*", lambda _: " "),
    ):
        body = re.sub(pattern, replaced, body)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {view[0]} role="img"'
    look = 'font-family="sans-serif" stroke-linejoin="round"'
    return f"{head} aria-label={quoteattr(label)} {look}>{body.strip()}"


def _variable(colour: re.Match[str]) -> str:
    name = VARIABLES.get(colour[0])
    return f"var(--{name}, {colour[0]})" if name else colour[0]
