"""Models, recordings and checks as text, for a terminal, a pipe or a log."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping

import numpy as np

from sim2real.arrays import Array
from sim2real.check import Check
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.report.quantity import (
    Quantity,
    correlations,
    effect_text,
    milliradians,
    printable,
    quantities,
)

WIDTH = 100
_HEADER = ("", "value", "unit", "90 % interval", "")
_WHITE = 0.1  # lag-1 autocorrelation below which a residual counts as white
_LABEL = 14


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
    all_rows = [_HEADER, *(row for block in rows.values() for row in block)]
    widths = [max(len(row[column]) for row in all_rows) for column in range(len(_HEADER))]
    lines = [_line(_HEADER, widths)]
    for name, joint in model.joints.items():
        lines += ["", textwrap.shorten(printable(name), WIDTH, placeholder="...") or "(no name)"]
        lines += [_line(row, widths) for row in rows[name]]
        lines += _not_determined(table[name])
        lines += _quality(model.fit.get(f"{name}.position_rad", {}))
        lines += _remarks(joint)
    if model.effects:
        lines += ["", "supply and link", *_listed("effects", map(effect_text, model.effects))]
    if model.notes:
        lines += ["", *_notes(model.notes)]
    return "\n".join(lines)


def recording_report(recording: Recording) -> str:
    """The summary of a recording, and a line for each joint."""
    width = max((len(joint) for joint in recording.joints), default=0)
    lines = [f"{recording.name}: {recording.summary}"]
    for j, joint in enumerate(recording.joints):
        command, position = span(recording.command[:, j]), span(recording.position[:, j])
        line = f"  {joint:<{width}}  command {command}, position {position}"
        lines.append(f"{line}, {recording.missing(j)} missing")
    if recording.columns:
        lines.append(f"  further columns: {', '.join(recording.columns)}")
    return "\n".join(printable(line) for line in lines)


def check_report(check: Check) -> str:
    """The check as text for a terminal, at most 100 columns wide."""
    clock, joints = check.timing, len(check.joints)
    pauses = "no gap" if not clock.gaps else f"{sum(g[1] for g in clock.gaps):.3g} s in gaps"
    lines = [
        f"{check.recording}: {check.kind}, {check.duration_s:.2f} s, "
        f"{joints} joint{'s' if joints != 1 else ''}",
        f"clock: {clock.rate_hz:.4g} Hz, jitter {1000 * clock.jitter_s:.2g} ms, {pauses}, "
        f"{clock.missing_cells} positions missing",
        "",
        f"{'joint':<12} {'moves':>5} {'command':>8} {'range':>8} {'noise':>9} {'step':>9} "
        f"{'missing':>7}  load",
        f"{'':<12} {'':>5} {'rad':>8} {'rad':>8} {'rad':>9} {'rad':>9}",
    ]
    for row in check.joints:
        step = f"{row.step_rad:.6f}" if row.step_rad else "-"
        lines.append(
            f"{_cut(row.joint, 12):<12} {row.moves:>5} {row.command_range_rad:>8.3f} "
            f"{row.range_rad:>8.3f} {row.noise_rad:>9.6f} {step:>9} "
            f"{row.missing:>7}  {row.load}"
        )
    lines = [_cut(line.rstrip(), WIDTH) for line in lines]
    findings = [
        finding.text if finding.severity == "note" else f"{finding.severity}: {finding.text}"
        for finding in check.all_findings
    ]
    identifiable = [f"{row.joint}: {f}" for row in check.joints for f in row.identifiable]
    for mark, sentences in (("! ", findings), ("  ", identifiable)):
        if sentences:
            lines.append("")
        for sentence in sentences:
            lines += textwrap.wrap(sentence, WIDTH, initial_indent=mark, subsequent_indent="  ")
    return "\n".join(lines)


def span(angles: Array) -> str:
    """Smallest to largest of the angles that are not missing, in rad."""
    finite = angles[np.isfinite(angles)]
    return f"{finite.min():.3f} to {finite.max():.3f} rad" if finite.size else "none"


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _cells(quantity: Quantity) -> tuple[str, ...]:
    value, low, high = quantity.texts
    between = f"{low} to {high}" if quantity.interval else ""
    percent = quantity.percent
    remark = quantity.origin
    if percent is not None:
        remark = f"± {percent:.2g} %" if percent < 100 else f"± {percent:.0f} %"
        remark = remark if percent < 1000 else "over ± 1000 %"
    return quantity.name, _pointed(value), quantity.unit, between, remark


def _pointed(number: str, before: int = 6, after: int = 6) -> str:
    """``number`` padded to align the decimal points of a column."""
    integer, point, fraction = number.partition(".")
    return f"{integer:>{before}}{point}{fraction}".ljust(before + 1 + after)


def _line(cells: Iterable[str], widths: list[int]) -> str:
    padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
    return ("  " + "  ".join(padded)).rstrip()


def _not_determined(listed: Iterable[Quantity]) -> list[str]:
    names = ", ".join(quantity.name for quantity in listed if quantity.unbounded)
    indent = " " * _LABEL
    first = "  not determined: "
    return textwrap.wrap(first + names, WIDTH, subsequent_indent=indent) if names else []


def _quality(figures: Mapping[str, float | None]) -> list[str]:
    if not figures:
        return []
    errors = f"{milliradians(figures.get('train'))} train, "
    errors += f"{milliradians(figures.get('heldout'))} held out"
    noise = figures.get("noise")
    errors += f"; noise {milliradians(noise)}" if noise is not None else ""
    lines = _listed("RMSE", [errors])
    if "train_without_effects" in figures:
        before = [milliradians(figures.get(f"{k}_without_effects")) for k in ("train", "heldout")]
        lines += _listed("plain PD", [f"{before[0]} train, {before[1]} held out"])
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
    return lines + (_listed("residual", residual) if residual else [])


def _remarks(joint: JointModel) -> list[str]:
    lines = []
    pairs = [f"{first} and {second} {r:+.2f}" for first, second, r in correlations(joint)]
    if pairs:
        lines += _listed("correlated", pairs)
    if joint.effects:
        lines += _listed("effects", [effect_text(e, joint.interval) for e in joint.effects])
    return lines + _notes(joint.notes)


def _notes(notes: Iterable[str]) -> list[str]:
    return [
        line
        for note in notes
        for line in textwrap.wrap(
            printable(note), WIDTH, initial_indent="  ! ", subsequent_indent="    "
        )
    ]


def _listed(label: str, items: Iterable[str]) -> list[str]:
    return textwrap.wrap(
        ", ".join(items),
        WIDTH,
        initial_indent=f"  {label:<{_LABEL - 2}}",
        subsequent_indent=" " * _LABEL,
    )
