"""Sections of results as text, for a terminal, a pipe or a log."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from itertools import pairwise

from sim2real.report.page import Note, Section, Table, Text
from sim2real.report.quantity import printable

WIDTH = 100
_WIDE = 24
"""Width of a column from which its cells may be cut off."""


def section_text(section: Section) -> str:
    """The title, the summary, the tables and the notes of a section."""
    lines = textwrap.wrap(f"{section.title}: {section.lead}".removesuffix(": "), WIDTH)
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
            lines += ["", block.heading, *textwrap.wrap(block.paragraph, WIDTH)]
    return "\n".join(lines).strip()


def _table_lines(rows: Iterable[Iterable[str]], right: Iterable[bool]) -> list[str]:
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
