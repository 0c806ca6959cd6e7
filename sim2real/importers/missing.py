"""What is missing: options that a log needs, in one message, and parts that were not imported."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from sim2real.errors import InputError
from sim2real.importers.tables import MAP
from sim2real.importers.units import ANGLE_UNITS, RANGES, SECONDS_PER


def table_options(
    columns: Sequence[str] | None,
    time_unit: str | None,
    units: Sequence[str] | None,
    counts_per_turn: int | None,
    zero_count: float | None,
    calibration: str | os.PathLike[str] | None,
) -> list[str]:
    """Missing options of a table, each with its expected value."""
    lacking = []
    if not columns:
        lacking.append(f"--columns {MAP}")
    if time_unit is None:
        lacking.append(f"--time-unit {'|'.join(SECONDS_PER)}")
    return lacking + angle_options(units, counts_per_turn, zero_count, calibration)


def angle_options(
    units: Sequence[str] | None,
    counts_per_turn: int | None,
    zero_count: float | None,
    calibration: str | os.PathLike[str] | None,
) -> list[str]:
    """Missing options on the unit of the angles, each with its expected value."""
    lacking = []
    stated = {text.rpartition("=")[2] for text in units or ()}
    if not units:
        counted = [] if counts_per_turn else ["--counts-per-turn N"]
        counted += [] if zero_count is not None or calibration else ["--zero-count N"]
        remark = f" (for counts also {' '.join(counted)})" if counted else ""
        lacking.append(f"--units {'|'.join(ANGLE_UNITS)}{remark}")
    if stated & {"counts", *RANGES} and not counts_per_turn:
        lacking.append("--counts-per-turn N (of a turn of the shaft)")
    if "counts" in stated and zero_count is None and calibration is None:
        lacking.append("--zero-count N (the count at angle 0) or --calibration JSON")
    if stated & set(RANGES) and calibration is None:
        lacking.append("--calibration JSON")
    return lacking


def unused_angle_options(
    units: Sequence[str] | None,
    counts_per_turn: int | None,
    zero_count: float | None,
    calibration: str | os.PathLike[str] | None,
) -> list[str]:
    """Options on angles that do not apply to any of the stated units."""
    stated = {text.rpartition("=")[2] for text in units or ()}
    counts, ranges = "counts" in stated, bool(stated & set(RANGES))
    applies = {
        "--counts-per-turn": counts or ranges,
        "--zero-count": counts,
        "--calibration": ranges or (counts and zero_count is None),
    }
    values = (counts_per_turn, zero_count, calibration)
    given = dict(zip(applies, values, strict=True))
    return [name for name in applies if given[name] is not None and not applies[name]]


def bag_options(command_topic: Sequence[str] | None) -> list[str]:
    """Missing options of a bag."""
    return [] if command_topic else ["--command-topic TOPIC (of the set-points)"]


def ask_for(source: Path, lacking: Sequence[str]) -> None:
    """Raise one error for all missing options.

    Raises:
        InputError: If any option is missing.
    """
    if lacking:
        names = ", ".join(text.split(" ")[0] for text in lacking)
        raise InputError(source, "", f"no {names}", "; ".join(lacking))


def refuse(source: Path, options: Sequence[str], of: str, applicable: Sequence[str]) -> None:
    """Raise one error for all options that do not apply.

    Args:
        source: The log.
        options: The options that do not apply, such as ``--units``.
        of: What they do not apply to.
        applicable: The options that do.

    Raises:
        InputError: If there are any.
    """
    if options:
        expected = f"only options that apply to it: {', '.join(applicable)}"
        raise InputError(source, "", f"{', '.join(options)} for {of}", expected)


def import_warnings(sentences: Sequence[str]) -> dict[str, list[str]]:
    """The field of a recording's metadata with what its user should know; none if empty."""
    return {"import_warnings": list(sentences)} if sentences else {}
