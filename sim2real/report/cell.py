"""The text of a page and of a table's cells: what is a number, and where a line may break."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from sim2real.report.extra import report_libraries

if TYPE_CHECKING:
    from markupsafe import Markup

_NUMBER = re.compile(r"[<>≥≤±]?\s?[+\-−]?(\d[\d.,]*(e[+\-]?\d+)?|∞)(?![\w\-:])")
_DASHES = ("", "-", "–", "−")
_LONG_NAME = 10
"""Letters of a name beyond which it may break after ``_``, ``/`` and ``.``; units are shorter."""
_LONG_WORD = 24
"""Letters of a word, such as a digest, beyond which it may break anywhere."""
_PIECE = 12
_GAP_LETTERS = 1
_LEGIBLE_LETTERS = 12
"""Letters a line that a column of words needs to be read with ease."""


def is_number(cell: str, *, alone: bool = False) -> bool:
    """Whether a cell holds a number: ``2.1 N m``, ``−3 %`` and ``0.7° per N m``, not ``2D-1 drag``.

    Args:
        cell: Its text; only the first line counts.
        alone: Whether words after the number make it text.
    """
    first = cell.partition("\n")[0].strip()
    found = _NUMBER.match(first)
    return first in _DASHES or (found is not None and not (alone and found.end() < len(first)))


def letters(title: str, cells: Sequence[str], *, numeric: bool) -> int:
    """How many letters a column of a table needs side by side with others, and the gap before it.

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
    """``text`` with every percent sign kept on the line of its number."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", text)


def breakable(text: str) -> Markup:
    """``text`` as HTML in which long names may break at their joints, and digests anywhere."""
    with report_libraries():
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
