"""Text of pages and table cells: detection of numbers, line breaks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from sim2real.errors import optional

if TYPE_CHECKING:
    from markupsafe import Markup

_NUMBER = re.compile(r"[<>≥≤±]?\s?[+\-−]?(\d[\d.,]*(e[+\-]?\d+)?|∞)(?![\w\-:])")
_DASHES = ("", "-", "–", "−")
_LONG_NAME = 10
"""Length of a name from which it may break after ``_``, ``/`` and ``.``; units are shorter."""
_LONG_WORD = 24
"""Length of a word, such as a digest, from which it may break anywhere."""
_PIECE = 12
_GAP_LETTERS = 1
_LEGIBLE_LETTERS = 12
"""Minimum width of a column of words, in letters."""


def is_number(cell: str, *, alone: bool = False) -> bool:
    """Whether a cell is a number: ``2.1 N m``, ``−3 %`` and ``0.7° per N m``, not ``2D-1 drag``.

    Args:
        cell: Its text; only the first line counts.
        alone: Whether words after the number make it text.
    """
    line = cell.partition("\n")[0].strip()
    match = _NUMBER.match(line)
    return line in _DASHES or (match is not None and not (alone and match.end() < len(line)))


def letters(title: str, cells: Sequence[str], *, numeric: bool) -> int:
    """Width of a table's column in letters, with the gap before it.

    Args:
        title: The column's title.
        cells: Its cells.
        numeric: Whether it holds numbers, which do not break.
    """
    words = [word for text in (title, *cells) for word in re.split(r"[\s_./]+", text)]
    longest = max((len(cell.partition("\n")[0]) for cell in cells), default=0)
    needed = longest if numeric else min(longest, _LEGIBLE_LETTERS)
    return max([needed, *(min(len(word), _LONG_WORD) for word in words)]) + _GAP_LETTERS


def prose(text: str) -> str:
    """``text`` with no-break spaces between numbers and percent signs."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", text)


def breakable(text: str) -> Markup:
    """``text`` as HTML in which long names may break between parts, and digests anywhere."""
    with optional("plots and pages"):
        from markupsafe import Markup, escape
    words = [
        Markup("<wbr>").join(escape(piece) for piece in _pieces(word))
        for word in prose(text).split(" ")
    ]
    return Markup(" ").join(words)


def _pieces(word: str) -> list[str]:
    if len(word) <= _LONG_NAME:
        return [word]
    pieces = []
    for part in re.split(r"(?<=[_/.])(?=[A-Za-z])", word):
        step = _PIECE if len(part) > _LONG_WORD else max(1, len(part))
        pieces += [part[start : start + step] for start in range(0, len(part), step)]
    return pieces
