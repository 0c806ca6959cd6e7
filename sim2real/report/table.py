"""Results as text, for a terminal, a pipe or a log."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping

from sim2real.model import JointModel, Model
from sim2real.report.page import Note, Section, Table, Text
from sim2real.report.quantity import (
    Quantity,
    effect_text,
    milliradians,
    printable,
    quantities,
)
from sim2real.units import readable_name

WIDTH = 100
_HEADER = ("", "value", "unit", "90 % interval", "")
_WHITE = 0.1  # lag-1 autocorrelation below which a residual counts as white
_LABEL = 14
_WIDE = 24
"""Width of a column from which its cells may be cut off."""
_CORRELATED, _MOST_PAIRS = 0.3, 4


def section_text(section: Section) -> str:
    """The title, the summary, the tables and the notes of a section."""
    lines = textwrap.wrap(f"{section.title}: {section.lead}".removesuffix(": "), WIDTH)
    for block in section.blocks:
        if isinstance(block, Table):
            titles, _, units = zip(*(x.partition("\n") for x in block.header), strict=True)
            header = [titles, units] if any(units) else [titles]
            lines += ["", *table_lines([*header, *block.rows], block.numeric), ""]
        elif isinstance(block, Note):
            lines += _marked(block.text, "! " if block.kind == "warn" else "  ")
        elif isinstance(block, Text):
            lines += [block.heading, *textwrap.wrap(block.paragraph, WIDTH)]
    return "\n".join(lines).strip()


def table_lines(rows: Iterable[Iterable[str]], right: Iterable[bool]) -> list[str]:
    """Rows of cells as lines, in columns; those with numbers are right-aligned.

    Cells of wide columns are cut off so that the table fits.
    """
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


def fit_report(model: Model) -> str:
    """Fitted parameters of every joint with their intervals, and the errors of the fit.

    Parameters whose interval has an infinite end are listed on one line per joint, as the
    recordings do not determine them.

    Args:
        model: The fitted simulator.

    Returns:
        Lines of at most 100 columns, the last without a line break.
    """
    table = {name: quantities(joint) for name, joint in model.joints.items()}
    rows = {name: [_cells(q) for q in each if not q.unbounded] for name, each in table.items()}
    every = [_HEADER, *(row for block in rows.values() for row in block)]
    lines = iter(table_lines(every, [False] * len(_HEADER)))
    text = ["  " + next(lines)]
    for name, joint in model.joints.items():
        text += ["", textwrap.shorten(printable(name), WIDTH, placeholder="...") or "(no name)"]
        text += ["  " + next(lines) for _ in rows[name]]
        text += _listed("not determined:", [q.name for q in table[name] if q.unbounded])
        text += _quality(model.fit.get(f"{name}.position_rad", {}))
        text += _remarks(joint)
    if model.effects:
        text += ["", "supply and link", *_listed("effects", map(effect_text, model.effects))]
    if model.notes:
        text += ["", *_notes(model.notes)]
    return "\n".join(text)


def _cells(quantity: Quantity) -> tuple[str, ...]:
    integer, point, fraction = quantity.texts[0].partition(".")
    value = f"{integer:>6}{point}{fraction}".ljust(13)  # the decimal points are aligned
    return quantity.name, value, quantity.unit, quantity.between, quantity.remark


def _quality(figures: Mapping[str, float | None]) -> list[str]:
    if not figures:
        return []
    noise = figures.get("noise")
    errors = _errors(figures, "") + ("" if noise is None else f"; noise {milliradians(noise)}")
    lines = _listed("RMSE", [errors])
    if "train_without_effects" in figures:
        lines += _listed("plain PD", [_errors(figures, "_without_effects")])
    time, lag, outliers = (
        figures.get(name) for name in ("correlation_time_s", "whiteness", "robust_outliers")
    )
    residual = []
    if lag is not None and abs(lag) < _WHITE:
        residual.append(f"white (lag-1 autocorrelation {lag:.2f})")
    elif time is not None:
        residual.append(f"correlated over {1e3 * time:.0f} ms")
        residual += [] if lag is None else [f"lag-1 autocorrelation {lag:.2f}"]
    if outliers is not None:
        residual.append(f"{100 * outliers:.2g} % outliers")
    return lines + _listed("residual", residual)


def _errors(figures: Mapping[str, float | None], which: str) -> str:
    train, held_out = (milliradians(figures.get(f"{k}{which}")) for k in ("train", "heldout"))
    return f"{train} train, {held_out} held out"


def _remarks(joint: JointModel) -> list[str]:
    strong = sorted(joint.correlation.items(), key=lambda pair: -abs(pair[1]))[:_MOST_PAIRS]
    names = [(map(readable_name, pair.split(", ")), r) for pair, r in strong]
    pairs = [f"{' and '.join(both)} {r:+.2f}" for both, r in names if abs(r) > _CORRELATED]
    effects = [effect_text(effect, joint.interval) for effect in joint.effects]
    return [*_listed("correlated", pairs), *_listed("effects", effects), *_notes(joint.notes)]


def _notes(notes: Iterable[str]) -> list[str]:
    return [f"  {line}" for note in notes for line in _marked(note, "! ", WIDTH - 2)]


def _marked(text: str, mark: str, width: int = WIDTH) -> list[str]:
    return textwrap.wrap(printable(text), width, initial_indent=mark, subsequent_indent="  ")


def _listed(label: str, items: Iterable[str]) -> list[str]:
    """Items on lines after a label; none if there are no items."""
    text = f"  {label:<{_LABEL - 2}}" + (" " if len(label) > _LABEL - 2 else "")
    joined = ", ".join(items)
    indent = " " * _LABEL
    return textwrap.wrap(text + joined, WIDTH, subsequent_indent=indent) if joined else []
