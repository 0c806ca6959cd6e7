"""Import of tables with a map of their columns.

CSV as Dynamixel and Feetech tools write it, and ``.npz`` archives of arrays by the names of
MuJoCo's ``mjData`` (``time``, ``qpos``, ``ctrl``).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_FILE_BYTES
from sim2real.errors import InputError, shown
from sim2real.importers.units import SECONDS_PER, Conversion
from sim2real.recording import Recording
from sim2real.structured import check_size, read_arrays

ANGLES = ("command", "position")
OTHERS = ("velocity_rad_s", "current_A", "load", "temperature_C")
MAP = "t=COLUMN J.command=COLUMN J.position=COLUMN ..."


def column_map(pairs: Sequence[str] | None) -> dict[str, str]:
    """Parse ``--columns t=COLUMN J.command=COLUMN ...``: names of the log's columns.

    Raises:
        InputError: If there is none for the time, or a joint lacks its command or position.
    """
    columns: dict[str, str] = {}
    for pair in pairs or ():
        ours, equals, theirs = pair.partition("=")
        if not equals or not theirs or ours in columns:
            raise InputError("--columns", "", repr(pair), f"{MAP}, each once")
        quantity = ours.rpartition(".")[2]
        valid = ours in ("t", "supply_V") or ("." in ours and quantity in (*ANGLES, *OTHERS))
        if not valid:
            expected = f"t, supply_V or J. and one of {', '.join((*ANGLES, *OTHERS))}"
            raise InputError("--columns", "", repr(ours), expected)
        columns[ours] = theirs
    joints = _joints(columns)
    lacking = [
        name for name in ["t", *(f"{j}.{q}" for j in joints for q in ANGLES)] if name not in columns
    ]
    if lacking or not joints:
        missing = lacking[0] if lacking else "a joint"
        raise InputError("--columns", "", f"nothing for {missing}", MAP)
    return columns


def read_table(
    path: str | os.PathLike[str],
    columns: Mapping[str, str],
    conversion: Conversion,
    *,
    time_unit: str | None,
) -> Recording:
    """Read a CSV or an ``.npz`` as a recording with unknown loads.

    An array of several columns is indexed: ``qpos[2]``. Rows before every joint has its first
    set-point are omitted; a set-point that is missing later is the previous one, as in a servo.
    ``t`` starts at 0.

    Args:
        path: The log.
        columns: Names of its columns, see `column_map`. Except for angles and times, columns have
            the units in their names.
        conversion: Units of the angles.
        time_unit: ``s``, ``ms``, ``us`` or ``ns``.

    Raises:
        InputError: If a column is missing or invalid, or a unit is not stated.
    """
    file = Path(path)
    if time_unit not in SECONDS_PER:
        found = "nothing" if time_unit is None else repr(time_unit)
        raise InputError("--time-unit", "", found, f"one of {', '.join(SECONDS_PER)}")
    read = _npz if file.suffix == ".npz" else _csv
    table = read(file, columns)
    t = (table["t"] - table["t"][0]) * SECONDS_PER[time_unit]
    decreasing = np.flatnonzero(~(np.diff(t) > 0))
    if decreasing.size:
        found = f"{t[decreasing[0] + 1]:g} s after {t[decreasing[0]]:g} s"
        raise InputError(file, f"row {decreasing[0] + 2} of the data", found, "times that increase")
    joints = _joints(columns)
    conversion.check_joints(joints)
    sent, measured = (
        np.stack([conversion.radians(j, table[f"{j}.{q}"], file) for j in joints], axis=1)
        for q in ANGLES
    )
    sent = pd.DataFrame(sent).ffill().to_numpy()
    started = np.isfinite(sent).all(axis=1)
    if started.sum() < 2:
        raise InputError(file, "commands", f"{started.sum()} rows with set-points", "two or more")
    first = int(np.flatnonzero(started)[0])
    others = {
        name: table[name][first:] for name in columns if name.rpartition(".")[2] not in ANGLES
    }
    others.pop("t")
    return Recording(
        name=file.stem,
        kind="servo",
        joints=joints,
        t=t[first:] - t[first],
        command=sent[first:],
        position=measured[first:],
        source="A log; licence not stated in it.",
        columns=others,
        metadata={
            "original_file": file.name,
            "rows_before_first_command": first,
            "units": {joint or "all": unit for joint, unit in conversion.units.items()},
        },
    )


def _joints(columns: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(n.rpartition(".")[0] for n in columns if "." in n))


def _csv(file: Path, columns: Mapping[str, str]) -> dict[str, Array]:
    check_size(file, LARGEST_FILE_BYTES, "; cut the log into pieces")
    try:
        table = pd.read_csv(file, skipinitialspace=True, compression=None, low_memory=False)
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(file, "", f"no table ({reason})", "comma-separated rows") from None
    if not isinstance(table.index, pd.RangeIndex):  # pandas reads surplus cells as row names
        raise InputError(file, "row 1 of the data", "more cells than columns", "as many")
    if len(table) < 2:
        raise InputError(file, "", f"{len(table)} rows", "a header and at least two rows")
    read = {}
    for ours, theirs in columns.items():
        if theirs not in table:
            available = ", ".join(str(name) for name in table.columns[:20])
            raise InputError(file, "header", f"no column {theirs}", f"one of {available}")
        values = pd.to_numeric(table[theirs], errors="coerce").to_numpy(np.float64, copy=True)
        wrong = np.flatnonzero((np.isnan(values) & table[theirs].notna()) | np.isinf(values))
        if wrong.size:
            found = shown(str(table[theirs].iloc[wrong[0]]))
            place = f"row {wrong[0] + 1} of the data, {theirs}"
            raise InputError(file, place, found, "a number or an empty cell")
        read[ours] = values
    return read


def _npz(file: Path, columns: Mapping[str, str]) -> dict[str, Array]:
    stored = read_arrays(file, "arrays of numbers", "an .npz archive")
    try:
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in stored.items()}
    except (TypeError, ValueError) as error:
        raise InputError(file, "", f"no arrays of numbers ({error})", "an .npz archive") from None
    read = {ours: _array(file, arrays, theirs) for ours, theirs in columns.items()}
    rows = {values.size for values in read.values()}
    if len(rows) > 1 or rows.pop() < 2:
        sizes = ", ".join(f"{columns[ours]}: {values.size}" for ours, values in read.items())
        raise InputError(file, "", f"rows: {sizes}", "as many in each, at least two")
    return read


def _array(file: Path, arrays: Mapping[str, Array], place: str) -> Array:
    """The column of an array ``NAME`` or ``NAME[K]``."""
    parts = re.fullmatch(r"(.*?)(?:\[(\d+)\])?", place)
    name, index = (parts[1], parts[2]) if parts else (place, None)
    if name not in arrays:
        raise InputError(file, "", f"no array {name}", f"one of {', '.join(arrays)}")
    values = arrays[name]
    if values.ndim == 1 and index is None:
        return values
    if values.ndim == 2 and index is not None and int(index) < values.shape[1]:
        column: Array = values[:, int(index)]
        return column
    shape = " x ".join(str(n) for n in values.shape)
    expected = f"{name}[K] with K below {values.shape[-1] if values.ndim == 2 else 0}"
    raise InputError(file, place, f"an array of {shape}", expected)
