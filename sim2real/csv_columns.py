"""Read columns of a CSV file as numbers; errors name row and column."""

import re
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from sim2real.arrays import Array
from sim2real.errors import InputError, nearest, shown
from sim2real.structured import check_label, check_size
from sim2real.units import plausible

LARGEST_FILE_BYTES = 256 * 2**20
LARGEST_ANGLE_RAD = 4 * np.pi


def read_table(csv: Path) -> pd.DataFrame:
    """The cells of a CSV file with a header and rows of equal length."""
    check_size(csv, LARGEST_FILE_BYTES, "; cut the recording into pieces")
    try:
        header = pd.read_csv(csv, skipinitialspace=True, compression=None, header=None, nrows=1)
        table = pd.read_csv(csv, skipinitialspace=True, compression=None, low_memory=False)
    except pd.errors.EmptyDataError:
        raise InputError(csv, "", "an empty file", "a header and rows") from None
    except UnicodeDecodeError:
        good = csv.read_bytes().decode(errors="replace").partition("\N{REPLACEMENT CHARACTER}")[0]
        place = f"row {good.count(chr(10)) + 1}"
        raise InputError(csv, place, "bytes that are not UTF-8", "text") from None
    except (ValueError, OSError) as error:
        long = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if long:
            expected, row, cells = long[1], long[2], long[3]
            found = f"{cells} cells"
            raise InputError(csv, f"row {row}", found, f"{expected}, as in the header") from None
        raise InputError(csv, "", f"no table ({error})", "comma-separated rows") from None
    if not isinstance(table.index, pd.RangeIndex):  # pandas reads excess cells as row names
        cells = table.index.nlevels + len(table.columns)
        raise InputError(csv, "row 2", f"{cells} cells", f"{len(table.columns)}, as in the header")
    names = header.iloc[0].dropna()
    for name in names:
        check_label(csv, "header", str(name))
    if names.duplicated().any():
        found = f"{names[names.duplicated()].iloc[0]} twice"
        raise InputError(csv, "header", found, "each column once")
    if not len(table):
        raise InputError(csv, "", "0 rows", "a header and at least two rows")
    return table


def column(csv: Path, table: pd.DataFrame, name: str) -> Array:
    """A column as numbers plausible for the unit in its name, NaN where empty, shape (T,)."""
    if name not in table:
        columns = [str(column) for column in table.columns]
        shortened = [x if len(x) <= 40 else f"{x[:39]}…" for x in columns[:8]]
        omitted = f" and {len(columns) - 8} more" if len(columns) > 8 else ""
        found = f"no column {name} among {', '.join(shortened)}{omitted}"
        times = [c for c in columns if name == "t_s" and (c.lower() == "t" or "time" in c.lower())]
        close = nearest(name, columns) or next(iter(times), None)
        hint = f" (did you mean {close}?)" if close else ""
        raise InputError(csv, "header", found, f"the column {name}{hint}")
    cells = table[name]
    if cells.dtype == object:  # integers beyond the range of a float, perhaps
        cells = cells.map(lambda cell: np.inf if type(cell) is int and abs(cell) > 1e300 else cell)
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, copy=True)
    wrong = np.flatnonzero((np.isnan(values) & table[name].notna().to_numpy()) | np.isinf(values))
    if wrong.size:
        found = shown(str(table[name].iloc[wrong[0]]))
        raise InputError(csv, cell(csv, int(wrong[0]), name), found, "a number or an empty cell")
    _, largest, unit = plausible(name)
    if name != "t_s" and unit == "s":  # times of other clocks
        return values
    huge = np.flatnonzero(np.abs(values) > largest)
    if huge.size:
        place, found = cell(csv, int(huge[0]), name), f"{values[huge[0]]:g}"
        raise InputError(csv, place, found, f"at most {largest:g} {unit} in size")
    return values


def cell(csv: Path, index: int, column: str) -> str:
    """Row as an editor numbers it (the header is row 1, blank lines count), and column."""
    with csv.open(encoding="utf-8", errors="replace") as lines:
        filled = (number for number, line in enumerate(lines, 1) if line.strip())
        row = next(islice(filled, index + 1, None), index + 2)
    return f"row {row}, {column}"


def angles(csv: Path, table: pd.DataFrame, joints: tuple[str, ...], quantity: str) -> Array:
    """Columns ``J.QUANTITY`` of all joints, shape (T, J), of angles that may be in rad."""
    angles = np.stack([column(csv, table, f"{j}.{quantity}") for j in joints], axis=1)
    wrong = np.argwhere(np.abs(angles) > LARGEST_ANGLE_RAD)
    if wrong.size:
        row, j = (int(x) for x in wrong[0])
        place, found = cell(csv, row, f"{joints[j]}.{quantity}"), f"{angles[row, j]:g}"
        expected = f"radians within {LARGEST_ANGLE_RAD:.1f} (degrees, perhaps?)"
        raise InputError(csv, place, found, expected)
    return angles


def times(csv: Path, table: pd.DataFrame) -> Array:
    """The column ``t_s``, shape (T,), T at least 2, without a gap and increasing."""
    t = column(csv, table, "t_s")
    if t.size < 2:
        raise InputError(csv, "", f"{t.size} row", "at least two rows")
    missing = np.flatnonzero(np.isnan(t))
    if missing.size:
        raise InputError(csv, cell(csv, int(missing[0]), "t_s"), "an empty cell", "a time in s")
    back = np.flatnonzero(t[1:] <= t[:-1])
    if back.size:
        row = int(back[0]) + 1
        found = f"{t[row]:g} after {t[row - 1]:g}"
        raise InputError(csv, cell(csv, row, "t_s"), found, "times that increase")
    return t


def commands(csv: Path, table: pd.DataFrame, joints: tuple[str, ...]) -> Array:
    """Set-points of all joints in rad, shape (T, J), missing only at the end of a column."""
    command = angles(csv, table, joints, "command_rad")
    for joint, present in zip(joints, np.isfinite(command).T, strict=True):
        last = int(np.flatnonzero(present)[-1]) if present.any() else 0
        hole = np.flatnonzero(~present[: last + 1])
        if hole.size:
            place = cell(csv, int(hole[0]), f"{joint}.command_rad")
            expected = "a set-point in rad (empty only at the end, where the torque is off)"
            raise InputError(csv, place, "an empty cell", expected)
    return command
