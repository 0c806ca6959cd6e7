"""Every option that a log needs and was not given, in one message."""

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
    """Options that a table lacks, each with what it should say; empty where it lacks none."""
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
    """Options on the unit of the angles that a log lacks, each with what it should say."""
    lacking = []
    named = {text.rpartition("=")[2] for text in units or ()}
    if not units:
        counted = [] if counts_per_turn else ["--counts-per-turn N"]
        counted += [] if zero_count is not None or calibration else ["--zero-count N"]
        more = f" (for counts also {' '.join(counted)})" if counted else ""
        lacking.append(f"--units {'|'.join(ANGLE_UNITS)}{more}")
    if named & {"counts", *RANGES} and not counts_per_turn:
        lacking.append("--counts-per-turn N (of a turn of the shaft)")
    if "counts" in named and zero_count is None and calibration is None:
        lacking.append("--zero-count N (the count at angle 0) or --calibration JSON")
    if named & set(RANGES) and calibration is None:
        lacking.append("--calibration JSON")
    return lacking


def bag_options(command_topic: Sequence[str] | None) -> list[str]:
    """Options that a bag lacks."""
    return [] if command_topic else ["--command-topic TOPIC (of the set-points)"]


def ask_for(source: Path, lacking: Sequence[str]) -> None:
    """Ask for all options that are missing, at once.

    Raises:
        InputError: If there are any.
    """
    if lacking:
        names = ", ".join(text.split(" ")[0] for text in lacking)
        raise InputError(source, "", f"no {names}", "; ".join(lacking))
