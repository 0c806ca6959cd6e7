import math

import numpy as np
import pytest
from good_input import message

from sim2real.importers.options import conversion
from sim2real.importers.tables import column_map, read_table

DYNAMIXEL = """time_ms,Goal Position,Present Position,Present Current,Present Input Voltage
1000,,2048,0,11.9
1010,2048,2048,3,11.9
1020,2148,2049,3,11.9
1030,,2060,,11.8
1040,2248,2100,40,11.8
"""
COLUMNS = ["t=time_ms", "pan.command=Goal Position", "pan.position=Present Position"]
COLUMNS += ["pan.load=Present Current", "supply_V=Present Input Voltage"]
COUNTS = conversion(["counts"], 4096, 2048)


def csv(tmp_path, text=DYNAMIXEL):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def plain(file, unit="s", angles=("rad",)):
    """A file whose columns are t, c and p."""
    columns = column_map(["t=t", "j.command=c", "j.position=p"])
    return read_table(file, columns, conversion(angles), time_unit=unit)


def test_counts_by_a_column_map(tmp_path):
    log = read_table(csv(tmp_path), column_map(COLUMNS), COUNTS, time_unit="ms")
    assert log.joints == ("pan",)
    assert log.t == pytest.approx([0, 0.01, 0.02, 0.03])  # before the first command: nothing
    turn = 2 * math.pi / 4096
    assert log.command[:, 0] == pytest.approx(np.array([0, 100, 100, 200]) * turn)
    assert log.position[:, 0] == pytest.approx(np.array([0, 1, 12, 52]) * turn)
    assert log.columns["pan.load"] == pytest.approx([3, 3, np.nan, 40], nan_ok=True)
    assert log.columns["supply_V"] == pytest.approx([11.9, 11.9, 11.8, 11.8])
    assert log.metadata["rows_before_first_command"] == 1


@pytest.mark.parametrize(
    ("pairs", "parts"),
    [
        (None, ("--columns", "nothing for t")),
        (["t=time"], ("nothing for a joint",)),
        (["t=time", "j.position=q"], ("nothing for j.command",)),
        (["t=time", "j.angle=q"], ("'j.angle'", "command, position")),
        (["t"], ("'t'",)),
        (["t=a", "t=b"], ("'t=b'", "each once")),
        (["t=a", ".command"], ("'.command'",)),
    ],
)
def test_bad_maps(pairs, parts):
    message(lambda: column_map(pairs), *parts)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ("no table",)),
        ("time_ms\n1\n2\n", ("header", "no column Goal Position")),
        (DYNAMIXEL.splitlines()[0] + "\n", ("0 rows",)),
        ("a,b,c\n1,2,3,4\n1,2,3,4\n", ("row 1 of the data", "more cells")),
        (DYNAMIXEL.replace("2049", "fast"), ("row 3 of the data", "'fast'")),
        (DYNAMIXEL.replace("1030", "1015"), ("row 4 of the data", "times that increase")),
        (DYNAMIXEL.replace("1030", ""), ("row 4 of the data", "times that increase")),
        (DYNAMIXEL.replace("2148", "99999"), ("pan", "at most 12.6 rad")),
    ],
)
def test_bad_tables(tmp_path, text, parts):
    file = csv(tmp_path, text)
    message(lambda: read_table(file, column_map(COLUMNS), COUNTS, time_unit="ms"), *parts)


def ticks(step):
    return "t,c,p\n" + "".join(f"{k * step!r},0.1,0.1\n" for k in range(20))


@pytest.mark.parametrize(
    ("text", "unit", "parts"),
    [
        ("t;c;p\n0;1,5;2\n0,01;1.5;2\n", "s", ("row 2 of the data, c", "'1.5'", "decimal commas")),
        ("t;c;p\n1;2,048;2,049\n2;2,048;2,049\n", "s", ("'2,048'", "thousands")),
        ("t,c,p\n0,00,1,5,2,5\n0,01,1,5,2,5\n", "s", ("more cells", "decimal commas need another")),
        ("t,c,p\n0,1,2\n0,01,1,2\n", "s", ("row 2 of the data", "4 cells", "3, as in the header")),
        ("t;c;d\n0;1;2\n1;1;2\n", "s", ("no column p", "semicolons", "one of t, c, d")),
        ("t;c;p;p\n0;1;2;2\n1;1;2;2\n", "s", ("header", "p twice")),
        ("t,c,p\n0,1,2\n\0\n", "s", ("no table (binary",)),
        (ticks(1), "min", ("--time-unit", "'min'")),
        (ticks(0.01), "ns", ("--time-unit ns", "samples 1e-11 s apart", "in seconds?")),
        (ticks(10), "s", ("--time-unit s", "samples 10 s apart", "in milliseconds?")),
        (ticks(1e7), "s", ("--time-unit s", "in nanoseconds?")),
    ],
)
def test_bad_forms_and_units(tmp_path, text, unit, parts):
    message(lambda: plain(csv(tmp_path, text), unit), *parts)


def variant(separator=",", comma=False, comment="", header="{}"):
    """The table with other separators, commas, comments and marks at its header."""
    rows = [line.split(",") for line in DYNAMIXEL.splitlines()]
    lines = [separator.join(cells) for cells in rows]
    lines[1:] = [line.replace(".", ",") if comma else line for line in lines[1:]]
    if comment:
        lines.insert(3, f"{comment} paused here")
        lines.insert(0, f"{comment} recorded on a bench, first run")
    top = 1 if comment else 0
    lines[top] = header.format(lines[top])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "form"),
    [
        (variant(";"), "columns separated by semicolons"),
        (variant(";", comma=True), "columns separated by semicolons, decimal commas"),
        (variant("\t"), "columns separated by tabs"),
        (variant(comment="#"), None),
        (variant(";", comment="%", comma=True), "columns separated by semicolons, decimal commas"),
        (variant(header="# {}"), None),
        (variant(comment="#", header="%{}"), None),
        ("\n\n" + variant().replace("\n", "\r\n"), None),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_other_forms_of_a_table(tmp_path, text, form, encoding):
    named = [pair.replace("Goal Position", "Soll [°]") for pair in COLUMNS]
    expected = read_table(csv(tmp_path), column_map(COLUMNS), COUNTS, time_unit="ms")
    file = tmp_path / "log.tsv"
    file.write_bytes(text.replace("Goal Position", "Soll [°]").encode(encoding))
    log = read_table(file, column_map(named), COUNTS, time_unit="ms")
    np.testing.assert_array_equal(log.t, expected.t)
    np.testing.assert_array_equal(log.command, expected.command)
    np.testing.assert_array_equal(log.position, expected.position)
    for name, values in expected.columns.items():
        np.testing.assert_array_equal(log.columns[name], values)
    assert log.metadata.get("format") == form


def test_columns_separated_by_spaces_below_a_comment(tmp_path):
    t = 0.01 * np.arange(50)
    np.savetxt(tmp_path / "log.csv", np.stack([t, np.sin(t), np.cos(t)], axis=1), header="t c p")
    log = plain(tmp_path / "log.csv")
    np.testing.assert_allclose(log.position[:, 0], np.cos(t), rtol=1e-15)
    assert log.metadata["format"] == "columns separated by spaces"


def test_a_unit_for_each_column(tmp_path):
    text = "t,c,p,d,q\n" + "".join(f"{k},{k},{k},{k},0.{k}\n" for k in range(9))
    columns = ["t=t", "a.command=c", "a.position=p", "b.command=d", "b.position=q"]
    file = csv(tmp_path, text)

    def read(*units):
        log = read_table(file, column_map(columns), conversion(units), time_unit="ms")
        return np.concatenate([log.command[-1], log.position[-1]])

    one = math.pi / 180
    assert read("deg", "b.position=rad") == pytest.approx([8 * one, 8 * one, 8 * one, 0.8])
    each = ("a.command=rad", "a=deg", "b.command=deg", "b.position=rad")
    assert read(*each) == pytest.approx([8, 8 * one, 8 * one, 0.8])
    message(lambda: read("deg", "b.current=rad"), "--units", "b.current", "command or position")
    message(lambda: read("a=deg", "b.command=rad"), "--units", "none for b")
    message(lambda: read("deg", "tilt=deg"), "--units", "tilt", "a, b")
