"""Sections of results, as text and as one self-contained HTML file without network access.

The only script is that of plots of time series (``series``), in pages that have some. Control
characters, as in names from files, are replaced.
"""

import base64
import hashlib
import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from sim2real.errors import optional
from sim2real.output import write_whole

_FOLDER = Path(__file__).parent
_SHOWN = 12
_NUMBER = re.compile(r"[<>≥≤±]?\s?[+\-−]?(\d[\d.,]*(e[+\-]?\d+)?|∞)(?![\w\-:])")
_DASHES = ("", "-", "–", "−")
_PART = re.compile(r"(?<=[_/.])(?=[A-Za-z])")
WIDTH = 100
_WIDE = 24
"""Width of a column of text from which its cells may be cut off."""


@dataclass(frozen=True)
class Text:
    """A paragraph with an optional heading."""

    paragraph: str
    heading: str = ""


@dataclass(frozen=True)
class Note:
    """A remark: positive (``good``), a warning (``warn``) or neutral (``info``)."""

    kind: Literal["good", "warn", "info"]
    text: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header; what follows a line break in a cell is set smaller below it."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise ValueError(f"row {number}: {len(row)} cells, header has {len(self.header)}")

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column has numbers, right-aligned; the first only if it has nothing else."""
        columns = [[row[k] for row in self.rows] for k in range(len(self.header))]
        return tuple(
            any(column) and all(_is_number(cell, alone=k == 0) for cell in column)
            for k, column in enumerate(columns)
        )


@dataclass(frozen=True)
class Figure:
    """A figure: an ``<svg>`` element of ``sim2real.report.drawing.svg``, inserted unchanged."""

    svg: str
    caption: str = ""
    live: str = ""  # the same as JSON to be drawn by uPlot and zoomed into, where scripts run


@dataclass(frozen=True)
class Film:
    """A short film, as a GIF embedded in the page."""

    gif: bytes  # content of the file
    alt: str  # alternative text
    caption: str = ""

    @property
    def source(self) -> str:
        """Data URL for an ``<img>`` element."""
        return "data:image/gif;base64," + base64.b64encode(self.gif).decode()


Block = Text | Note | Table | Figure | Film


@dataclass(frozen=True)
class Section:
    """One part of a report: a title, a summary in a sentence or two, and its content."""

    title: str
    lead: str
    blocks: Sequence[Block] = ()


def printable(text: str) -> str:
    """``text`` without control characters but line breaks."""
    kept = (x if x.isprintable() or x in "\n\u00a0" else "\N{REPLACEMENT CHARACTER}" for x in text)
    return "".join(kept)


def section_text(section: Section) -> str:
    """The title, the summary, the tables and the notes of a section, for a terminal or a log."""
    title = printable(f"{section.title}: {section.lead}".removesuffix(": "))
    lines = textwrap.wrap(title, WIDTH)
    for before, block in pairwise([None, *section.blocks]):
        if isinstance(block, Table):
            titles, _, units = zip(*(x.partition("\n") for x in block.header), strict=True)
            header = [titles, units] if any(units) else [titles]
            lines += ["", *_table_lines([*header, *block.rows], block.numeric)]
        elif isinstance(block, Note):
            lines += [""] if isinstance(before, Table) else []
            mark, text = "! " if block.kind == "warn" else "  ", printable(block.text)
            lines += textwrap.wrap(text, WIDTH, initial_indent=mark, subsequent_indent="  ")
        elif isinstance(block, Text):
            text = printable(block.paragraph)
            lines += ["", printable(block.heading), *textwrap.wrap(text, WIDTH)]
    return "\n".join(lines).strip()


def _table_lines(rows: Sequence[Sequence[str]], right: Sequence[bool]) -> list[str]:
    """Rows of cells as lines, in columns that fit; those with numbers are right-aligned."""
    cells = [[printable(cell.replace("\n", ", ")) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    while sum(widths) + 2 * len(widths) > WIDTH and max(widths) > _WIDE:
        widths[widths.index(max(widths))] -= 1
    sides = [(str.rjust if is_right else str.ljust) for is_right in right]
    return [
        "  ".join(
            side(cell if len(cell) <= width else cell[: width - 1] + "…", width)
            for cell, width, side in zip(row, widths, sides, strict=True)
        ).rstrip()
        for row in cells
    ]


def write_page(
    path: str | os.PathLike[str],
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    provenance: Mapping[str, Any],
) -> Path:
    """Write a report; ``provenance`` (of ``sim2real.output``) is for the footer."""
    return write_whole(path, render_page(title, subtitle, sections, provenance))


def render_page(
    title: str, subtitle: str, sections: Sequence[Section], provenance: Mapping[str, Any]
) -> str:
    """The report as text; arguments as for ``write_page``."""
    live = any(isinstance(b, Figure) and b.live for s in sections for b in s.blocks)
    script = _texts("uplot/uPlot.iife.min.js", "live_plot.js") if live else ""
    style = ("page.css", *(("uplot/uPlot.min.css", "live_plot.css") if live else ()))
    # A content security policy allows this script alone.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page: str = _template().render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        origin=_origin(provenance),
        css=_texts(*style),
        script=script,
        script_source=f"'sha256-{digest}'",
    )
    return page


def render_fragment(sections: Sequence[Section]) -> str:
    """Sections as HTML for another page, such as a notebook, including their style."""
    template = _template()
    blocks = template.blocks["sections"](template.new_context({"sections": sections, "script": ""}))
    style = _texts("notebook.css")
    return f'<div class="sim2real">\n<style>\n{style}</style>\n{"".join(blocks)}</div>\n'


def _texts(*names: str) -> str:
    return "\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in names)


def _template() -> Any:  # noqa: ANN401 - of Jinja
    with optional("plots and pages"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    kind = lambda block: type(block).__name__  # noqa: E731
    environment.globals.update(kind=kind, prose=_prose, breakable=_breakable)
    return environment.get_template("page.html")


def _origin(provenance: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Label and lines of every non-empty part of the footer."""
    seed, inputs = provenance.get("seed"), provenance.get("inputs", {})
    parts = {
        "command": [str(provenance.get("command", ""))],
        "seed": ["" if seed is None else str(seed)],
        "versions": [", ".join(f"{k} {v}" for k, v in provenance.get("versions", {}).items())],
        "inputs (SHA-256)": [
            f"{Path(*Path(k).parts[-2:])}  {v[:_SHOWN]}" for k, v in inputs.items()
        ],
    }
    return [(label, lines) for label, lines in parts.items() if any(lines)]


def _is_number(cell: str, *, alone: bool = False) -> bool:
    """Whether the first line is a number, as ``2.1 N m``; if it is alone, without words after."""
    line = cell.partition("\n")[0].strip()
    match = _NUMBER.match(line)
    return line in _DASHES or (match is not None and not (alone and match.end() < len(line)))


def _prose(text: str) -> str:
    """``text`` with no-break spaces between numbers and percent signs."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", printable(text))


def _breakable(text: str) -> Any:  # noqa: ANN401 - markup
    """``text`` as HTML in which long names, unlike units, may break between their parts."""
    with optional("plots and pages"):
        from markupsafe import Markup, escape
    html = str(escape(_prose(text)))
    return Markup(re.sub(r"\S{11,}", lambda word: _PART.sub("<wbr>", word[0]), html))
