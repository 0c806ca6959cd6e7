"""A report as one self-contained HTML file, without network access or fonts.

The only script is that of plots of time series (``live_plot``), in pages that have some.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sim2real.errors import optional
from sim2real.output import write_whole
from sim2real.report.cell import breakable, is_number, letters, prose
from sim2real.report.live_plot import Live, live_script, live_style, script_hash

if TYPE_CHECKING:
    from jinja2 import Template

_FOLDER = Path(__file__).parent
_HASH_LETTERS = 12
_PHONE_LETTERS = 50
"""Width of a table, in letters including gaps between columns, that fits on a phone."""


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
    """Rows of text under a header.

    Text after a line break in a cell, such as an interval or a unit, is set smaller below it.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise ValueError(f"row {number}: {len(row)} cells, header has {len(self.header)}")

    @property
    def numeric(self) -> tuple[bool, ...]:
        """For each column whether it contains numbers, which are right-aligned.

        The first column names its row: it is numeric only if its cells contain nothing else.
        """
        return tuple(
            any(column) and all(is_number(cell, alone=k == 0) for cell in column)
            for k, column in enumerate(self._columns)
        )

    @property
    def stacked(self) -> bool:
        """Whether the table is too wide for a phone.

        A phone then shows each row as a list, with the title of the column before each cell.
        """
        columns = zip(self.header, self._columns, self.numeric, strict=True)
        needed = sum(letters(title, cells, numeric=numeric) for title, cells, numeric in columns)
        return needed > _PHONE_LETTERS

    @property
    def _columns(self) -> list[list[str]]:
        return [[row[k] for row in self.rows] for k in range(len(self.header))]


@dataclass(frozen=True)
class Figure:
    """A figure: ``<svg>`` elements of ``sim2real.report.svg``, inserted into the page unchanged.

    Attributes:
        svg: The figure.
        caption: Caption.
        narrow: The same figure in a layout for phones; without it, a phone scrolls the figure
            horizontally.
        live: The same content to zoom into, which replaces both where scripts run.
    """

    svg: str
    caption: str = ""
    narrow: str = ""
    live: Live | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Film:
    """A short film, as a GIF embedded in the page.

    Attributes:
        gif: Content of the file.
        alt: Alternative text.
        caption: Caption.
    """

    gif: bytes
    alt: str
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


def write_page(
    path: str | os.PathLike[str],
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    provenance: Mapping[str, Any],
    *,
    stages: Sequence[tuple[str, bool]] = (),
) -> Path:
    """Write a report atomically.

    Args:
        path: The HTML file to write.
        title: Subject of the report, such as a robot or a recording.
        subtitle: One line below it.
        sections: Sections.
        provenance: Result of ``sim2real.output.provenance``, for the footer.
        stages: Stages of the work in order, each with whether it is done.

    Raises:
        InputError: If the file cannot be written.
        MissingLibrary: If Jinja is not installed.
    """
    return write_whole(path, render_page(title, subtitle, sections, provenance, stages=stages))


def render_page(
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    provenance: Mapping[str, Any],
    *,
    stages: Sequence[tuple[str, bool]] = (),
) -> str:
    """The report as text; arguments as for ``write_page``."""
    live = any(isinstance(b, Figure) and b.live for s in sections for b in s.blocks)
    script = live_script() if live else ""
    return _template().render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        stages=stages,
        origin=_origin(provenance),
        css=(_FOLDER / "page.css").read_text(encoding="utf-8") + (live_style() if live else ""),
        script=script,
        script_source=script_hash(script),
    )


def render_fragment(sections: Sequence[Section]) -> str:
    """Sections as HTML for another page, such as a notebook, including their style.

    Raises:
        MissingLibrary: If Jinja is not installed.
    """
    template = _template()
    blocks = template.blocks["sections"](template.new_context({"sections": sections, "script": ""}))
    style = (_FOLDER / "notebook.css").read_text(encoding="utf-8")
    return f'<div class="sim2real">\n<style>\n{style}</style>\n{"".join(blocks)}</div>\n'


def _template() -> Template:
    with optional("plots and pages"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        kind=lambda block: type(block).__name__, prose=prose, breakable=breakable
    )
    return environment.get_template("page.html")


def _origin(provenance: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Label and lines of every non-empty part of the footer."""
    seed = provenance.get("seed")
    parts = [
        ("command", [str(provenance.get("command", ""))]),
        ("seed", ["" if seed is None else str(seed)]),
        ("versions", [", ".join(f"{k} {v}" for k, v in provenance.get("versions", {}).items())]),
        (
            "inputs (SHA-256)",
            [
                f"{Path(path).name}  {str(digest)[:_HASH_LETTERS]}"
                for path, digest in provenance.get("inputs", {}).items()
            ],
        ),
    ]
    return [(label, lines) for label, lines in parts if any(lines)]
