"""Whatever a file holds, it is read or refused with an InputError: nothing else escapes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from good_input import HEADER, MODEL, ROBOT, SIDECAR, csv_file
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.recording import read_commands, read_recording
from sim2real.robot import read_robot


def refused_or_read(read: Callable[[], object]) -> None:
    try:
        read()
    except InputError as error:
        assert "\n" not in str(error)


FUZZ = settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
CELLS = st.sampled_from(
    ["", "0", "1", "-1e308", "1e308", "1e999", "nan", "True", '"', "9" * 400, "0x1", "a", "\t", "é"]
)
TABLES = st.lists(st.lists(CELLS | st.floats().map(repr), max_size=5).map(",".join), max_size=6)


@FUZZ
@given(content=st.binary(max_size=200) | TABLES.map(lambda rows: "\n".join(rows).encode()))
def test_any_bytes_as_csv(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bench.csv"
    path.with_suffix(".json").write_text(json.dumps(SIDECAR))
    for start in (b"", HEADER.encode() + b"\n", (HEADER + ",x\n").encode()):
        path.write_bytes(start + content)
        refused_or_read(lambda: read_recording(path))
        refused_or_read(lambda: read_commands(path))


NAMES = st.sampled_from(
    ["schema", "kind", "joints", "loads", "medium", "j1", "inertia_kgm2", "pendulum_mass_kg"]
    + ["fit", "effects", "interval", "notes", "body", "parameters", "effect", "kp_Nm_per_rad"]
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | NAMES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text() | NAMES, inner),
    max_leaves=12,
)
OBJECTS = st.dictionaries(NAMES, JSON)


@FUZZ
@given(content=JSON, change=OBJECTS)
def test_any_json_as_sidecar(tmp_path: Path, content: object, change: dict[str, Any]) -> None:
    path = csv_file(tmp_path)
    for sidecar in (content, SIDECAR | change):
        path.with_suffix(".json").write_text(json.dumps(sidecar))
        refused_or_read(lambda: read_recording(path))
        refused_or_read(lambda: read_commands(path))


@FUZZ
@given(content=JSON, change=OBJECTS)
def test_any_json_as_model(tmp_path: Path, content: object, change: dict[str, Any]) -> None:
    path = tmp_path / "model.json"
    changed = MODEL["joints"]["j1"] | change
    for model in (content, MODEL | change, MODEL | {"joints": {"j1": changed}}):
        path.write_text(json.dumps(model))
        refused_or_read(lambda: read_model(path))


@FUZZ
@given(content=st.text() | st.text(alphabet='[]{}=".,#-+:_ \n\r\t01239aeinfTZ'), at=st.integers(0))
def test_any_text_as_robot(tmp_path: Path, content: str, at: int) -> None:
    path = tmp_path / "robot.toml"
    cut = at % len(ROBOT)
    for text in (content, ROBOT[:cut] + content + ROBOT[cut:], ROBOT[:cut] + content):
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        refused_or_read(lambda: read_robot(path))
