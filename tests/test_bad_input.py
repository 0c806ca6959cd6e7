"""Whatever is wrong with a file, one line says where, what was found and what was expected."""

import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from good_input import HEADER, MODEL, ROBOT, ROWS, SIDECAR, csv_file, message

from sim2real.design.limits import read_contexts
from sim2real.hardware.tracker import open_video, read_picture
from sim2real.model import read_model
from sim2real.output import check_writable, write_json, write_whole
from sim2real.posterior.chain import read_chain
from sim2real.posterior.posteriors import read_sample
from sim2real.recording import Recording, read_commands, read_recording, write_recording
from sim2real.robot import read_robot


def with_row(number: int, row: str) -> tuple[str, ...]:
    """The good rows with the one that an editor numbers ``number`` replaced."""
    return tuple(row if k + 2 == number else good for k, good in enumerate(ROWS))


def test_the_good_files_are_read(tmp_path: Path) -> None:
    assert read_recording(csv_file(tmp_path)).t.size == 5
    (tmp_path / "robot.toml").write_text(ROBOT)
    assert read_robot(tmp_path / "robot.toml").joint("j1") is not None
    (tmp_path / "model.json").write_text(json.dumps(MODEL))
    assert read_model(tmp_path / "model.json").joints["j1"].kp_Nm_per_rad == 2.2


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        (with_row(4, "0.04,57,0.1"), ("row 4, j1.command_rad", "found 57", "radians", "degrees")),
        (with_row(4, "0.02,0.1,0.1"), ("row 4, t_s", "found 0.02 after 0.02", "that increase")),
        (with_row(4, ",0.1,0.1"), ("row 4, t_s", "an empty cell", "a time in s")),
        (with_row(4, "0.04,,0.1"), ("row 4, j1.command_rad", "an empty cell", "a set-point")),
        (with_row(4, "0.04,fast,0.1"), ("row 4, j1.command_rad", "'fast'", "a number")),
        (with_row(4, "0.04,0.1,True"), ("row 4, j1.position_rad", "'True'", "a number")),
        (with_row(4, "-1e999,0.1,0"), ("row 4, t_s", "inf", "a number")),
        (with_row(4, "1e308,0.1,0"), ("row 4, t_s", "found 1e+308", "at most 1e+10 s")),
        (with_row(4, "\n\n0.04,fast,0.1"), ("row 6, j1.command_rad", "'fast'", "a number")),
        (with_row(4, "0.04,0.1,0.1,7"), ("row 4", "4 cells", "3, as in the header")),
        (tuple(f"{row},7" for row in ROWS), ("row 2", "4 cells", "3")),
        (with_row(4, '0.04,"0.1,0.1'), ("bench.csv",)),
        (ROWS[:1], ("bench.csv", "found 1 row", "at least two rows")),
        ((), ("bench.csv", "found 0 rows", "at least two rows")),
        ("t_s,j1.command_rad,j1.position", ("header", "no column j1.position_rad")),
        ("t_s,j1.command_rad,j1.positon_rad", ("header", "did you mean j1.positon_rad?")),
        ("time,j1.command_rad,j1.position_rad", ("header", "no column t_s", "did you mean time?")),
        ("t_s,j1.command_rad,j1.command_rad", ("header", "j1.command_rad twice", "each column")),
    ],
)
def test_rows_or_header(
    tmp_path: Path, given: tuple[str, ...] | str, parts: tuple[str, ...]
) -> None:
    path = csv_file(tmp_path, **{"header" if isinstance(given, str) else "rows": given})
    message(lambda: read_recording(path), str(path), *parts)


def test_cells_of_further_columns_and_bytes(tmp_path: Path) -> None:
    def further(name: str, cell: str) -> Path:
        return csv_file(tmp_path, tuple(f"{row},{cell}" for row in ROWS), f"{HEADER},{name}")

    path = further("supply_V", "high")
    message(lambda: read_recording(path), "row 2, supply_V", "'high'", "a number")
    path = further("body.x_m", "1e300")
    message(lambda: read_recording(path), "row 2, body.x_m", "1e+300", "at most")
    path = csv_file(tmp_path)
    path.write_bytes(path.read_bytes().replace(b"0.04,0.2", b"0.04,\xb0"))
    message(lambda: read_recording(path), str(path), "row 4", "not UTF-8")


def test_commands_alone(tmp_path: Path) -> None:
    path = csv_file(tmp_path, header="t_s,a,b")
    message(lambda: read_commands(path), str(path), "header", "no J.command_rad column")
    path = csv_file(tmp_path, with_row(3, "0.02,57,0"))
    message(lambda: read_commands(path), "row 3, j1.command_rad", "found 57")


READERS = [read_recording, read_commands, read_robot, read_model]


@pytest.mark.parametrize("read", READERS)
def test_files_that_are_none(tmp_path: Path, read: Callable[[Path], object]) -> None:
    message(lambda: read(tmp_path), str(tmp_path), "found a folder", "file")
    message(lambda: read(tmp_path / "none.csv"), "none.csv", "found no such file")
    message(lambda: read(tmp_path / ("n" * 300)), "nnn", "file")
    regular = tmp_path / "regular"
    regular.write_text("")
    message(lambda: read(regular / "below.csv"), "below.csv", "file")


@pytest.mark.parametrize("read", [*READERS, read_sample, read_chain, read_picture, open_video])
def test_files_without_an_end(tmp_path: Path, read: Callable[[Path], object]) -> None:
    """Refused at once: a pipe would wait for a writer, and /dev/zero fill the memory."""
    os.mkfifo(tmp_path / "pipe.csv")
    message(lambda: read(tmp_path / "pipe.csv"), "pipe.csv", "found a pipe", "a file")
    message(lambda: read(Path("/dev/zero")), "/dev/zero", "found a device", "a file")


@pytest.mark.parametrize("read", READERS)
def test_empty_and_binary_files(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "input.csv"
    path.with_suffix(".json").write_text(json.dumps(SIDECAR))
    for content in (b"", b"\n", b"\xff\xfe\x00j", b"t_s,\xe9\n1,2\n"):
        path.write_bytes(content)
        message(lambda: read(path), str(path))
    path.write_bytes(b"t_s,j1.command_rad\n0,1\n1,\xe9\n")
    message(lambda: read(path), str(path), "bytes that are not UTF-8", "text")


@pytest.mark.parametrize("ending", [".csv", ".json"])
@pytest.mark.parametrize("read", READERS)
def test_huge_files_are_refused_unread(tmp_path, monkeypatch, read, ending) -> None:
    path = csv_file(tmp_path)
    huge = path.with_suffix(ending)
    os.truncate(huge, 10 * 2**30)  # sparse: takes no room
    opened = io.open

    def guarded(file: Any, *args: Any, **kwargs: Any) -> Any:
        assert str(file) != str(huge), "opened"
        return opened(file, *args, **kwargs)

    monkeypatch.setattr("builtins.open", guarded)
    monkeypatch.setattr("io.open", guarded)
    given_path = path if read is read_recording else huge  # which looks for its sidecar by itself
    message(lambda: read(given_path), str(huge), "10240 MiB", "at most", "MiB")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"schema": "sim2real.recording/2"}, ("schema", "recording/2'", "recording/1'")),
        ({"kind": "boat"}, ("kind", "'boat'", "'servo' or 'pool'")),
        ({"kind": ["servo"]}, ("kind", "['servo']", "text")),
        ({"joints": []}, ("joints", "[]", "a list of joint names")),
        ({"joints": ["j1", "j1"]}, ("joints", "['j1', 'j1']", "each name once")),
        ({"joints": ["j2"], "loads": {}}, ("header", "no column j2.command_rad")),
        ({"loads": {"j7": {"inertia_kgm2": 1}}}, ("loads.j7", "a joint not recorded", "j1")),
        ({"loads": {"j1": {"inertia_kgm2": -1}}}, ("loads.j1.inertia_kgm2", "-1", "above 0")),
        ({"loads": ["j" * 5000]}, ("loads", "jjj", "a table")),
        ({"loads": {"j1": {"inertia_kgm2": 1e300}}}, ("loads.j1.inertia_kgm2", "1e+300", "kg m²")),
        ({"medum": "water"}, ("medum", "an unknown key", "did you mean", "medium")),
    ],
)
def test_sidecar_fields(tmp_path: Path, change: dict[str, Any], parts: tuple[str, ...]) -> None:
    path = csv_file(tmp_path)
    path.with_suffix(".json").write_text(json.dumps(SIDECAR | change))
    message(lambda: read_recording(path), str(tmp_path), *parts)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("[[links]]", "[links", ("line 3, column 7", "no TOML")),
        ('servo = "lx824"', 'servo = "lx16"', ("joints[0].servo", "'lx16'", "lx824")),
        ('servo = "lx824"', "", ("joints[0].servo", "nothing", "text")),
        ("[-0.8, 0.8]", "[0.8, -0.8]", ("joints[0].limits_rad", "smaller first")),
        ("[-0.8, 0.8]", "[nan, 0.8]", ("joints[0].limits_rad", "[nan, 0.8]", "two angles")),
        ("[-0.8, 0.8]", f"[0, 1{'0' * 5000}]", ("no TOML", "digits")),
        ("[-0.8, 0.8]", "[" * 100_000, ("no TOML", "nested")),
        ("mass_kg = 0.5", "mass_kg = -0.5", ("links[0].mass_kg", "-0.5", "above 0")),
        ("mass_kg = 0.5", 'mass_kg = "0.5"', ("links[0].mass_kg", "'0.5'", "a number")),
        ("mass_kg = 0.5", "mass_kg = 1e300", ("links[0].mass_kg", "1e+300", "to 1e+06 kg")),
        ("mass_kg = 0.5", "mass_kg = 1e-300", ("links[0].mass_kg", "1e-300", "from 1e-09")),
        ("mass_kg = 0.5", "mass_kg = 0.5\ncom_m = 0.21", ("links[0].com_m", "0.21", "0.2 m")),
        ("[servos.lx824]", "[[servos.lx824]]", ("servos.lx824", "a table")),
        ("[servos.lx824]", "[servo.lx824]", ("servo", "an unknown key", "did you mean servos?")),
        ("max_torque_Nm", "max_torqe_Nm", ("servos.lx824.max_torqe_Nm", "mean max_torque_Nm?")),
        ('name = "fish"', 'name = "fish"\nzzz = 1', ("zzz:", "one of name, links, joints, servos")),
        ("[-0.8, 0.8]", "[-60, 60]", ("joints[0].limits_rad", "[-60, 60]", "degrees?")),
    ],
)
def test_robot_fields(tmp_path: Path, old: str, new: str, parts: tuple[str, ...]) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace(old, new, 1))
    message(lambda: read_robot(path), str(path), *parts)


def of_joint(**change: object) -> dict[str, Any]:
    return {"joints": {"j1": MODEL["joints"]["j1"] | change}}


def test_robot_counts(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    joint = '[[joints]]\nname = "j1"\nservo = "lx824"\nlimits_rad = [-1, 1]\n'
    link = '[[links]]\nname = "fin"\nmass_kg = 1\nlength_m = 1\nwidth_m = 1\nheight_m = 1\n'
    path.write_text(ROBOT + joint)
    message(lambda: read_robot(path), "links", "2 links and 2 joints", "one link more")
    path.write_text(ROBOT + link)
    message(lambda: read_robot(path), "links", "3 links and 1 joints", "one link more")
    path.write_text(ROBOT + joint + link)
    message(lambda: read_robot(path), "joints", "j1, j1", "each name once")
    path.write_text('name = "fish"')
    message(lambda: read_robot(path), "joints", "nothing", "at least one [[joints]]")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (of_joint(kp_Nm_per_rad=-1), ("joints.j1.kp_Nm_per_rad", "-1", "at least 0")),
        (of_joint(latency_s=None), ("joints.j1.latency_s", "None", "a number")),
        (of_joint(inertia_kgm2=0), ("joints.j1.inertia_kgm2", "0", "above 0")),
        (of_joint(interval={"kp": [1, 2, 3]}), ("joints.j1.interval.kp", "two numbers")),
        (of_joint(effects="backlash"), ("joints.j1.effects", "'backlash'")),
        (of_joint(effects=[{"effect": 3}]), ("joints.j1.effects[0].effect", "3", "text")),
        (
            of_joint(effects=[{"effect": "backlash", "parameters": {"gap_rad": "wide"}}]),
            ("joints.j1.effects[0].parameters.gap_rad", "'wide'", "a number"),
        ),
        (
            of_joint(law="motor", motor={"loop_period_s": 1e-9}),
            ("joints.j1.motor.loop_period_s", "1e-09", "0 or at least 2e-05 s"),
        ),
        (of_joint(notes=5), ("joints.j1.notes", "5", "a list")),
        (of_joint(correlation={"kp, kd": "high"}), ("joints.j1.correlation.kp, kd", "'high'")),
        (of_joint(per_inertia="yes"), ("joints.j1.per_inertia", "'yes'", "true or false")),
        ({"schema": "sim2real.recording/1"}, ("schema", "recording/1'", "model/1'")),
        ({"fit": {"j1.position_rad": 3}}, ("fit.j1.position_rad", "3", "a table")),
        ({"fit": {"j1.position_rad": {"train": "low"}}}, ("fit.j1.position_rad.train", "'low'")),
        ({"body": {"twin": 3}}, ("body.twin", "3", "a table")),
        ({"body": {"water": {"viscosity_m2_s": "thick"}}}, ("body.water.viscosity_m2_s", "thick")),
        ({"body": {"normalised_density": [1.0, 0]}}, ("body.normalised_density", "one for each")),
        ({"body": {"normalised_density_sd": 0.1}}, ("body.normalised_density_sd", "0.1")),
        ({"body": {"effects": [3]}}, ("body.effects[0]", "3", "a table")),
        ({"body": {"posterior": {"names": ["a"], "mean": []}}}, ("body.posterior.mean", "1 num")),
        (
            {"body": {"posterior": {"names": ["a"], "mean": [1], "covariance": [[1, 2]]}}},
            ("body.posterior.covariance", "1 rows"),
        ),
    ],
)
def test_model_fields(tmp_path: Path, change: dict[str, Any], parts: tuple[str, ...]) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(MODEL | change))
    message(lambda: read_model(path), str(path), *parts)


@pytest.mark.parametrize("name", ["a\nb", "a\x1b[31m", "a\u2028b", "a\u202eb"])
def test_control_characters_in_names(tmp_path: Path, name: str) -> None:
    path = csv_file(tmp_path)
    path.with_suffix(".json").write_text(json.dumps(SIDECAR | {"joints": [name]}))
    message(lambda: read_recording(path), "bench.json: joints", "control characters")
    path = csv_file(tmp_path, header=f't_s,"{name}.command_rad",j1.position_rad')
    message(lambda: read_commands(path), "bench.csv: header", "control characters")
    (tmp_path / "model.json").write_text(json.dumps(MODEL).replace('"j1"', json.dumps(name)))
    message(lambda: read_model(tmp_path / "model.json"), "joints", "control characters")
    for old in ("fish", "tail", "j1"):
        (tmp_path / "robot.toml").write_text(ROBOT.replace(f'"{old}"', json.dumps(name)))
        message(lambda: read_robot(tmp_path / "robot.toml"), "name", "control characters")
    recording = Recording("r", "servo", (name,), np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)))
    message(lambda: write_recording(recording, tmp_path / "new.csv"), "control characters")
    assert not (tmp_path / "new.csv").exists()


def test_half_of_a_surrogate_pair(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text(json.dumps(MODEL | {"notes": ["\ud800"]}))
    message(lambda: read_model(tmp_path / "model.json"), "surrogate")


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 40_000 + " = 1",
        "[" + "a." * 40_000 + "a]",
        '"a"' + '."a"' * 40_000 + " = 1",
        "x = {" + "'a' . " * 40_000 + "a = 1}",
        'a.b.c = 1\nname = "x"',
        '"__class__" = 1',
        'joints.__class__.x = "1"',
        "[servos.x.__class__]\ny = 1",
    ],
)
def test_nested_keys(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    message(lambda: read_robot(path), str(path))
    message(lambda: read_contexts(path), str(path))


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ('{"schema": ', ("line 1, column", "no JSON")),
        ("[1, 2]", ("a JSON list", "a JSON object")),
        ("[" * 100_000, ("no JSON", "nested")),
        ('{"schema": ' + "9" * 5000 + "}", ("no JSON", "digits")),
    ],
)
def test_sidecar_that_does_not_parse(tmp_path: Path, content: str, parts: tuple[str, ...]) -> None:
    path = csv_file(tmp_path)
    path.with_suffix(".json").write_text(content)
    message(lambda: read_recording(path), str(path.with_suffix(".json")), *parts)
    message(lambda: read_model(path.with_suffix(".json")), *parts)


def test_sidecar_missing_or_no_text(tmp_path: Path) -> None:
    path = csv_file(tmp_path)
    path.with_suffix(".json").write_bytes(b'{"schema": "\xe9"}')
    message(lambda: read_recording(path), "bench.json", "byte 12", "not UTF-8")
    path.with_suffix(".json").unlink()
    command = f"sim2real import {path} --out bench_imported.csv"
    message(lambda: read_recording(path), "bench.json", "no such file", "first", command)


@pytest.mark.parametrize("name", ["log.csv", "run.bag", "folder"])
def test_a_log_that_was_not_imported(tmp_path: Path, name: str) -> None:
    (tmp_path / "log.csv").write_text("Zeit;Soll;Ist\n0,00;0,0;0,0\n")
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n\xff")
    (tmp_path / "folder").mkdir()
    log = tmp_path / name
    line = message(lambda: read_recording(log), f"import the log {name} first")
    assert line.endswith(f": sim2real import {log} --out {log.stem}_imported.csv")


def test_outputs_that_can_not_be_written(tmp_path: Path) -> None:
    recording = read_recording(csv_file(tmp_path))
    regular = tmp_path / "regular"
    regular.write_text("here first")
    target = regular / "deeper" / "out.json"
    for write in (
        lambda: check_writable(target),
        lambda: write_whole(target, "text"),
        lambda: write_json(target, {}),
        lambda: write_recording(recording, target.with_suffix(".csv")),
    ):
        message(write, str(regular), "a folder to write in")
    message(lambda: check_writable(tmp_path), "found a folder", "the name of a file")
    message(lambda: write_whole(tmp_path / ("n" * 300), ""), "nnn")
    assert regular.read_text() == "here first"
