"""Output of figures: PNG files, and SVG elements for pages."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from sim2real.output import write_whole
from sim2real.report.style import POINTS_PER_INCH, VARIABLES, WIDE, house_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_DPI = 150
MARGIN_INCHES = 0.15
# Without date and program, so that equal figures give equal files.
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


def save_png(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write ``figure`` to ``path`` at 150 dots per inch, atomically.

    Raises:
        InputError: If the folder cannot be created or written.
    """
    stream = io.BytesIO()
    with _unchanged(figure), house_style():
        figure.savefig(
            stream,
            format="png",
            dpi=PNG_DPI,
            bbox_inches="tight",
            pad_inches=MARGIN_INCHES,
            metadata={"Software": None},
        )
    return write_whole(path, stream.getvalue())


def svg(figure: Figure, *, width: float = WIDE) -> str:
    """``figure`` as an ``<svg>`` element for a page.

    It has no fixed size, so it fills its column; text is kept as text; colours are CSS variables
    with a fallback; ids are unique to the figure, so that a page can have several.

    Args:
        figure: The figure; it is not changed.
        width: Width of the layout in points; ``NARROW`` keeps text legible on a phone.
    """
    stream = io.StringIO()
    with _unchanged(figure), house_style():
        figure.set_size_inches(width / POINTS_PER_INCH, figure.get_size_inches()[1])
        figure.savefig(stream, format="svg", transparent=True, metadata=_NO_METADATA)
    return _inline(stream.getvalue(), figure.get_label())


@contextmanager
def _unchanged(figure: Figure) -> Iterator[None]:
    """Restore the size of a figure and the positions of its panels at the end.

    Drawing moves the panels slightly, which would change the next drawing.
    """
    size = figure.get_size_inches()
    places = [
        (panel, panel.get_position(original=True), panel.get_position()) for panel in figure.axes
    ]
    yield
    figure.set_size_inches(*size)
    for panel, original, active in places:
        panel._set_position(original, which="original")  # type: ignore[attr-defined]
        panel._set_position(active, which="active")  # type: ignore[attr-defined]


def _inline(document: str, label: object) -> str:
    root = ElementTree.fromstring(document)
    root.attrib = {
        "xmlns": "http://www.w3.org/2000/svg",
        "viewBox": root.attrib["viewBox"],
        "role": "img",
        "aria-label": str(label),
        "font-family": "sans-serif",
        "stroke-linejoin": "round",
    }
    digest = sha256(document.encode()).hexdigest()[:8]
    used = dict.fromkeys(re.findall(r'(?:url\(|href=")#([\w-]+)', document))
    ids = {name: f"f{digest}-{number}" for number, name in enumerate(used)}
    for element in root.iter():
        for child in [child for child in element if child.tag.endswith("}style")]:
            element.remove(child)  # it would style the whole page
        element.tag = element.tag.partition("}")[2]
        element.tail = None
        if element.tag != "text":
            element.text = None
        if element is not root:
            element.attrib = dict(_attributes(element.attrib, ids))
    for group in root.iter("g"):
        _hoist_style(group)
    return ElementTree.tostring(root, encoding="unicode")


def _attributes(attributes: dict[str, str], ids: dict[str, str]) -> Iterator[tuple[str, str]]:
    for name, value in attributes.items():
        if name == "id":
            if value in ids:
                yield name, ids[value]
        elif name.endswith("href"):
            yield "href", f"#{ids[value[1:]]}"
        elif name == "clip-path":
            yield name, f"url(#{ids[value[5:-1]]})"
        elif name == "style":
            yield name, _style(value)
        elif name in ("d", "x", "y"):
            yield name, re.sub(r"(\.\d\d)\d+", r"\1", value.replace("\n", "").strip())
        elif not value.startswith("rotate(-0 "):
            yield name, value


def _style(declarations: str) -> str:
    declared = [d for d in declarations.split("; ") if not d.startswith("font-family")]
    return re.sub(
        r"#[0-9a-f]{6}",
        lambda c: f"var(--{VARIABLES[c[0]]}, {c[0]})" if c[0] in VARIABLES else c[0],
        "; ".join(declared),
    )


def _hoist_style(group: ElementTree.Element) -> None:
    """Move the style of many equal markers to their group, which reduces the size of the file."""
    styles = {child.get("style") for child in group}
    if {child.tag for child in group} == {"use"} and len(styles) == 1 and None not in styles:
        group.set("style", group[0].attrib["style"])
        for child in group:
            del child.attrib["style"]
