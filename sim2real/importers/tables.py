"""Import of tables with a map of their columns.

Text with columns separated by commas, as Dynamixel and Feetech tools write it, by semicolons, tabs
or spaces, with decimal points or commas and lines of comments.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from sim2real.arrays import Array
from sim2real.clock import check_sampling
from sim2real.csv_columns import LARGEST_FILE_BYTES
from sim2real.errors import InputError, shown
from sim2real.importers.options import ANGLES, MAP, SECONDS_PER, Conversion, check_increasing
from sim2real.recording import Recording
from sim2real.structured import check_size

OTHERS = ("velocity_rad_s", "current_A", "load", "temperature_C")
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "spaces"}


def column_map(pairs: Sequence[str] | None) -> dict[str, str]:
    """Names of the log's columns by ``--columns t=COLUMN J.command=COLUMN ...``."""
    columns: dict[str, str] = {}
    for pair in pairs or ():
        ours, _, theirs = pair.partition("=")
        if not theirs or ours in columns:
            raise InputError("--columns", "", repr(pair), f"{MAP}, each once")
        _, dot, quantity = ours.rpartition(".")
        if ours not in ("t", "supply_V") and not (dot and quantity in (*ANGLES, *OTHERS)):
            expected = f"t, supply_V or J. and one of {', '.join((*ANGLES, *OTHERS))}"
            raise InputError("--columns", "", repr(ours), expected)
        columns[ours] = theirs
    names = [f"{joint}.{quantity}" for joint in _joints(columns) for quantity in ANGLES]
    lacking = [name for name in ("t", *(names or ["a joint"])) if name not in columns]
    if lacking:
        raise InputError("--columns", "", f"nothing for {lacking[0]}", MAP)
    return columns


def read_table(
    file: Path, columns: Mapping[str, str], conversion: Conversion, *, time_unit: str
) -> Recording:
    """Read a table of text as a recording with unknown loads.

    Columns are chosen by ``column_map``. Except for angles and times they have the units in their
    names. Rows before every joint has its first set-point are omitted; a set-point that is missing
    later is the previous one, as in a servo. ``t`` starts at 0. ``InputError`` if a column is
    missing or invalid, a unit is not stated, or the sampling period in the unit of time is not one
    of a servo.
    """
    if time_unit not in SECONDS_PER:
        raise InputError("--time-unit", "", repr(time_unit), f"one of {', '.join(SECONDS_PER)}")
    table, form = _csv(file, columns)
    t = (table["t"] - table["t"][0]) * SECONDS_PER[time_unit]
    check_increasing(file, t, "row {} of the data", 1)
    joints = _joints(columns)
    sent, measured = (
        conversion.radians(joints, q, np.stack([table[f"{j}.{q}"] for j in joints], axis=1), file)
        for q in ANGLES
    )
    measured_at = t[np.isfinite(measured).any(axis=1)]
    if measured_at.size < 2:
        found = f"{measured_at.size} rows with angles"
        raise InputError(file, "positions", found, "two or more")
    where = f"--time-unit {time_unit}"
    check_sampling(file, measured_at, where=where, unit_s=SECONDS_PER[time_unit])
    sent = pd.DataFrame(sent).ffill().to_numpy()
    started = np.isfinite(sent).all(axis=1)
    if started.sum() < 2:
        raise InputError(file, "commands", f"{started.sum()} rows with set-points", "two or more")
    first = int(np.flatnonzero(started)[0])
    others = [n for n in columns if n != "t" and n.rpartition(".")[2] not in ANGLES]
    return Recording(
        name=file.stem,
        kind="servo",
        joints=joints,
        t=t[first:] - t[first],
        command=sent[first:],
        position=measured[first:],
        source="A log; licence not stated in it.",
        columns={name: table[name][first:] for name in others},
        metadata={
            "original_file": file.name,
            "rows_before_first_command": first,
            "units": {joint or "all": unit for joint, unit in conversion.units.items()},
            **({"format": form} if form else {}),
        },
    )


def _joints(columns: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(n.rpartition(".")[0] for n in columns if "." in n))


def _csv(file: Path, columns: Mapping[str, str]) -> tuple[dict[str, Array], str]:
    """The columns of a text file, and a phrase on separators and commas unless they are plain."""
    header, separator, rows = _header(_lines(file), set(columns.values()))
    if len(rows) < 2:
        raise InputError(file, "", f"{len(rows)} rows", "a header and at least two rows")
    form = f"columns separated by {SEPARATORS[separator]}"
    hint = " (decimal commas need another separator of columns)" if separator == "," else ""
    try:
        table = pd.read_csv(
            StringIO("\n".join(rows)),
            sep=r"\s+" if separator == " " else separator,
            header=None,
            names=range(len(header)),
            dtype=str,
            skipinitialspace=True,
        )
    except ValueError as error:
        long = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not long:
            raise InputError(file, "", f"no table ({error})", form) from None
        place, expected = f"row {long[2]} of the data", f"{long[1]}, as in the header{hint}"
        raise InputError(file, place, f"{long[3]} cells", expected) from None
    if not isinstance(table.index, pd.RangeIndex):  # pandas reads surplus cells as row names
        raise InputError(file, "row 1 of the data", "more cells than columns", f"as many{hint}")
    for theirs in columns.values():
        if header.count(theirs) != 1:
            found = f"{theirs} twice" if theirs in header else f"no column {theirs} ({form})"
            raise InputError(file, "header", found, f"one of {', '.join(header[:20])}, once")
    chosen = {theirs: table[header.index(theirs)].str.strip() for theirs in columns.values()}
    comma = separator != "," and any(cells.str.contains(",").any() for cells in chosen.values())
    if comma:
        _check_decimal_commas(file, chosen)
        form += ", decimal commas"
    read = {name: _numbers(file, theirs, chosen[theirs], comma) for name, theirs in columns.items()}
    return read, "" if separator == "," else form


def _lines(file: Path) -> list[str]:
    """The lines of a text file in UTF-8, or in UTF-16 or Windows-1252 as spreadsheets write it."""
    check_size(file, LARGEST_FILE_BYTES, "; cut the log into pieces")
    try:
        content = file.read_bytes()
    except OSError as error:
        raise InputError(file, "", str(error.strerror), "a readable file") from None
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    if not text.strip() or "\0" in text:
        found = "no table (binary data)" if "\0" in text else "no table (an empty file)"
        raise InputError(file, "", found, "rows of text")
    return re.split(r"\r\n|\r|\n", text)


def _header(lines: Sequence[str], wanted: set[str]) -> tuple[list[str], str, list[str]]:
    """Names of the columns, their separator, and the rows below without comments."""
    filled = [line for line in lines if line.strip()]
    rows = [line for line in filled if not line.lstrip().startswith(("#", "//", "%"))]
    if not rows:
        return [], ",", []
    # numpy.savetxt and rostopic echo -p write the header as a comment
    above = filled[: filled.index(rows[0])]
    for line in (rows[0], *reversed(above)):
        texts = dict.fromkeys((line.lstrip().lstrip("#/%"), line))
        for text, separator in product(texts, SEPARATORS):
            names = _cells(text, separator)
            if wanted <= set(names):
                return names, separator, rows[1:] if line is rows[0] else rows
    separator = max(",;\t", key=lambda character: len(_cells(rows[0], character)))
    return _cells(rows[0], separator), separator, rows[1:]


def _cells(line: str, separator: str) -> list[str]:
    """The cells of the header."""
    if separator == " ":
        return line.split()
    return [name.strip() for name in next(csv.reader([line.strip(" ")], delimiter=separator))]


def _check_decimal_commas(file: Path, chosen: Mapping[str, pd.Series]) -> None:
    """Check that commas in numbers can only be decimal commas."""
    cells = pd.concat(list(chosen.values())).dropna()
    with_comma = cells[cells.str.contains(",")]
    if with_comma.str.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}").all():
        found = f"{shown(str(with_comma.iloc[0]))}, with a comma of thousands or of decimals"
        raise InputError(file, "", found, "numbers without separators of thousands")
    for theirs, column in chosen.items():
        dotted = np.flatnonzero(column.str.contains(".", regex=False, na=False))
        if dotted.size:
            place = f"row {dotted[0] + 1} of the data, {theirs}"
            found = f"{shown(str(column.iloc[dotted[0]]))} where others have decimal commas"
            raise InputError(file, place, found, "decimal commas or decimal points throughout")


def _numbers(file: Path, theirs: str, cells: pd.Series, comma: bool) -> Array:
    """The cells of a column as numbers, NaN where one is empty, shape (T,)."""
    text = cells.str.replace(",", ".", regex=False) if comma else cells
    values = pd.to_numeric(text, errors="coerce").to_numpy(np.float64, copy=True)
    wrong = np.flatnonzero((np.isnan(values) & cells.notna().to_numpy()) | np.isinf(values))
    if wrong.size:
        found = shown(str(cells.iloc[wrong[0]]))
        place = f"row {wrong[0] + 1} of the data, {theirs}"
        raise InputError(file, place, found, "a number or an empty cell")
    return values
