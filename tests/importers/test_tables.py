from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from good_input import message

from sim2real.cli import main
from sim2real.importers.tables import column_map, read_table
from sim2real.importers.units import conversion
from sim2real.recording import read_recording

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


def csv(tmp_path: Path, text: str = DYNAMIXEL) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def test_counts_by_a_column_map(tmp_path: Path) -> None:
    log = read_table(csv(tmp_path), column_map(COLUMNS), COUNTS, time_unit="ms")
    assert log.joints == ("pan",)
    assert log.t == pytest.approx([0, 0.01, 0.02, 0.03])  # before the first command: nothing
    turn = 2 * math.pi / 4096
    assert log.command[:, 0] == pytest.approx(np.array([0, 100, 100, 200]) * turn)
    assert log.position[:, 0] == pytest.approx(np.array([0, 1, 12, 52]) * turn)
    assert log.columns["pan.load"] == pytest.approx([3, 3, np.nan, 40], nan_ok=True)
    assert log.columns["supply_V"] == pytest.approx([11.9, 11.9, 11.8, 11.8])
    assert log.metadata["rows_before_first_command"] == 1


def test_mujoco_arrays_through_the_command_line(tmp_path: Path) -> None:
    t = 0.002 * np.arange(50)
    qpos, ctrl = np.zeros((50, 9)), np.zeros((50, 2))
    qpos[:, 7], qpos[:, 8] = np.sin(t), np.cos(t)
    ctrl[:, 0], ctrl[:, 1] = np.sin(t + 0.1), np.cos(t + 0.1)
    np.savez(tmp_path / "log.npz", time=t + 3, qpos=qpos, ctrl=ctrl)
    columns = ["t=time", "hip.command=ctrl[0]", "hip.position=qpos[7]"]
    columns += ["knee.command=ctrl[1]", "knee.position=qpos[8]"]
    out = tmp_path / "out.csv"
    call = ["import", str(tmp_path / "log.npz"), "--columns", *columns]
    assert main([*call, "--units", "rad", "--time-unit", "s", "--out", str(out)]) == 0
    recording = read_recording(out)
    assert recording.joints == ("hip", "knee")
    assert recording.t == pytest.approx(t)
    assert recording.position == pytest.approx(qpos[:, 7:], abs=1e-8)
    assert recording.command == pytest.approx(ctrl, abs=1e-8)


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
def test_bad_maps(pairs: list[str] | None, parts: tuple[str, ...]) -> None:
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
def test_bad_tables(tmp_path: Path, text: str, parts: tuple[str, ...]) -> None:
    file = csv(tmp_path, text)
    message(lambda: read_table(file, column_map(COLUMNS), COUNTS, time_unit="ms"), *parts)


def test_units_of_times_and_counts_are_asked_for(tmp_path: Path) -> None:
    file, columns = csv(tmp_path), column_map(COLUMNS)
    message(lambda: read_table(file, columns, COUNTS, time_unit=None), "--time-unit", "nothing")
    message(lambda: read_table(file, columns, COUNTS, time_unit="min"), "--time-unit", "'min'")
    some = conversion(["counts"], 4096)
    message(lambda: read_table(file, columns, some, time_unit="ms"), "--zero-count")
    some = conversion(["counts"], None, 2048)
    message(lambda: read_table(file, columns, some, time_unit="ms"), "--counts-per-turn")
    tilted = conversion(["counts", "tilt=deg"], 4096, 2048)
    message(lambda: read_table(file, columns, tilted, time_unit="ms"), "--units", "tilt", "pan")


def test_bad_arrays(tmp_path: Path) -> None:
    def read(*pairs: str, **arrays: np.ndarray) -> None:
        file = tmp_path / "log.npz"
        np.savez(file, **arrays)
        units = conversion(["rad"])
        message(lambda: read_table(file, column_map(pairs), units, time_unit="s"), *parts)

    t, q = np.arange(4.0), np.zeros((4, 2))
    columns = ("t=time", "j.command=ctrl[0]", "j.position=qpos[0]")
    parts = ["no array ctrl", "one of time, qpos"]
    read(*columns, time=t, qpos=q)
    parts = ["rows:", "as many in each"]
    read(*columns, time=t, qpos=q, ctrl=q[:3])
    parts = ["qpos[2]", "an array of 4 x 2"]
    read(*columns[:2], "j.position=qpos[2]", time=t, qpos=q, ctrl=q)
    parts = ["qpos", "an array of 4 x 2"]
    read(*columns[:2], "j.position=qpos", time=t, qpos=q, ctrl=q)
    parts = ["no arrays of numbers"]
    read(*columns, time=t, qpos=np.array(["a"]), ctrl=q)
    (tmp_path / "log.npz").write_bytes(b"no archive")
    file, units = tmp_path / "log.npz", conversion(["rad"])
    message(
        lambda: read_table(file, column_map(columns), units, time_unit="s"), "no arrays of numbers"
    )
