"""Good files to spoil, and how to look at the line that refuses a bad one."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sim2real.errors import InputError

HEADER = "t_s,j1.command_rad,j1.position_rad"
ROWS = ("0.00,0.1,0.1", "0.02,0.1,0.1", "0.04,0.2,0.1", "0.06,0.2,0.15", "0.08,0.2,0.2")
SIDECAR: dict[str, Any] = {
    "schema": "sim2real.recording/1",
    "kind": "servo",
    "joints": ["j1"],
    "loads": {"j1": {"inertia_kgm2": 0.002}},
}
ROBOT = """
name = "fish"
[[links]]
name = "head"
mass_kg = 0.5
length_m = 0.2
width_m = 0.1
height_m = 0.1
[[links]]
name = "tail"
mass_kg = 0.5
length_m = 0.2
width_m = 0.1
height_m = 0.1
[[joints]]
name = "j1"
servo = "lx824"
limits_rad = [-0.8, 0.8]
[servos.lx824]
max_torque_Nm = 1.67
no_load_speed_rad_s = 5.24
position_step_rad = 0.00419
"""
MODEL: dict[str, Any] = {
    "schema": "sim2real.model/1",
    "joints": {
        "j1": {
            "kp_Nm_per_rad": 2.2,
            "kd_Nms_per_rad": 0.06,
            "latency_s": 0.068,
            "inertia_kgm2": 0.002,
            "interval": {"kp_Nm_per_rad": [2.1, None]},
            "effects": [{"effect": "backlash", "parameters": {"gap_rad": 0.03}}],
        }
    },
}


def message(read: Callable[[], object], *parts: str) -> str:
    """The one line with which ``read`` refuses its input, which holds all ``parts``."""
    with pytest.raises(InputError) as caught:
        read()
    line = str(caught.value)
    for part in (*parts, "found", "expected"):
        assert part in line
    assert "\n" not in line
    assert len(line) < 700
    return line


def refused(capsys: pytest.CaptureFixture[str], status: int, *parts: str) -> str:
    """The line of a command that printed one, which has all ``parts``, and left with status 2."""
    output = capsys.readouterr()
    assert status == 2
    assert output.out == ""
    assert output.err.count("\n") == 1, output.err
    for part in parts:
        assert part in output.err
    return output.err


def csv_file(folder: Path, rows: tuple[str, ...] = ROWS, header: str = HEADER) -> Path:
    path = folder / "bench.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    path.with_suffix(".json").write_text(json.dumps(SIDECAR))
    return path
