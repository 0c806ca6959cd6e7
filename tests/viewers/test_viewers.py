"""Files for viewers, read back by the viewers' own libraries."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from good_input import message, refused

from sim.inference.swims import by_followed_twin, swim_of
from sim.view.swim_page import swims_scene
from sim2real.cli import main
from sim2real.diagnose.result import Diagnosis
from sim2real.model import read_model
from sim2real.recording import POSE, Recording, read_recording
from sim2real.robot import read_robot
from sim2real.viewers.scenes import (
    Scene,
    SignalGroup,
    axis_points,
    recorded,
    with_prediction,
    write_mcap,
    write_rerun,
)

ROOT = Path(__file__).parents[2]
DATA = ROOT / "datasets" / "servo_steps"
POOL = ROOT / "datasets" / "pool"


@pytest.fixture(scope="module")
def bench() -> Recording:
    """Two joints for 0.1 s; one angle is missing and one joint has a current."""
    t = 0.02 * np.arange(6)
    command = np.outer(t, [1.0, -2.0])
    position = command + [0.01, 0.02]
    position[2, 0] = np.nan
    return Recording(
        "a b/c", "servo", ("j1", "j2"), t, command, position, columns={"j2.current_A": 10 * t}
    )


@pytest.fixture(scope="module")
def swim() -> Recording:
    """The first two seconds of a shipped swim."""
    return read_recording(POOL / "p1.csv").between(0, 100)


def rerun_columns(file: Path) -> dict[str, tuple[Any, Any]]:
    """Times, unless it is static, and values of each entity of a file for Rerun."""
    chunk = pytest.importorskip("rerun.chunk", reason="the extra 'view' is not installed")
    columns: dict[str, tuple[Any, Any]] = {}
    for part in chunk.RrdReader(str(file)).stream():
        batch = part.to_record_batch()
        names = [name for name in batch.schema.names if name.endswith((":scalars", ":strips"))]
        if names:
            static = part.is_static
            times = None if static else batch.column("time").cast("int64").to_numpy() / 1e9
            values = [row[0] for row in batch.column(names[0]).to_pylist()]
            columns[part.entity_path] = times, np.array(values)
    return columns


def mcap_messages(file: Path) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Times in s and contents of the messages of each topic; every schema is JSON."""
    reader = pytest.importorskip("mcap.reader", reason="the extra 'view' is not installed")
    topics: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    with file.open("rb") as stream:
        for schema, channel, record in reader.make_reader(stream).iter_messages():
            content = json.loads(record.data)
            assert schema.encoding == "jsonschema"
            assert set(content) <= set(json.loads(schema.data)["properties"])
            topics.setdefault(channel.topic, []).append((record.log_time / 1e9, content))
    return topics


def test_rerun_reads_every_sample(bench: Recording, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
    scene = with_prediction(bench, "j1", bench.command[:, 0] + 0.03)
    columns = rerun_columns(write_rerun(scene, tmp_path / "a.rrd"))
    times, measured = columns["/a\\ b\\/c/j1/position/measured"]
    np.testing.assert_allclose(times, bench.t)
    np.testing.assert_array_equal(measured, bench.position[:, 0])
    residual = columns["/a\\ b\\/c/j1/residual/predicted"][1]
    np.testing.assert_allclose(residual, [-0.02, -0.02, np.nan, -0.02, -0.02, -0.02])
    np.testing.assert_array_equal(
        columns["/a\\ b\\/c/j2/current/measured"][1], bench.columns["j2.current_A"]
    )


def test_mcap_has_a_message_for_each_sample(bench: Recording, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra 'view' is not installed")
    early = replace(bench, t=bench.t - 0.04)
    topics = mcap_messages(write_mcap(recorded(early), tmp_path / "a.mcap"))
    assert set(topics) == {"/a b_c/j1/position", "/a b_c/j2/position", "/a b_c/j2/current"}
    times, contents = zip(*topics["/a b_c/j1/position"], strict=True)
    np.testing.assert_allclose(times, bench.t)
    assert [content["command"] for content in contents] == bench.command[:, 0].tolist()
    assert ["measured" in content for content in contents] == [True, True, False, True, True, True]


def test_a_swim_moves_in_both_files(swim: Recording, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
    scene = recorded(swim, read_robot(POOL / "robot.toml"))
    (track,) = scene.tracks
    columns = rerun_columns(write_rerun(scene, tmp_path / "a.rrd"))
    times, points = columns["/p1/body/measured"]
    np.testing.assert_allclose(times, track.t)
    np.testing.assert_allclose(points, track.points, atol=1e-6)
    _, (static,) = columns["/p1/body/measured/path"]
    np.testing.assert_allclose(static, track.points[:, 0], atol=1e-6)
    updates = mcap_messages(write_mcap(scene, tmp_path / "a.mcap"))["/p1/body/measured"]
    assert len(updates) == track.t.size
    assert [entity["id"] for entity in updates[0][1]["entities"]][0].endswith("/path")
    (entity,) = updates[-1][1]["entities"]
    drawn = [[point[axis] for axis in "xyz"] for point in entity["lines"][0]["points"]]
    np.testing.assert_allclose(drawn, track.points[-1])


def test_the_axis_of_a_swim_is_where_the_links_are() -> None:
    robot = read_robot(POOL / "robot.toml")
    names = tuple(joint.name for joint in robot.joints)
    angles = np.zeros((3, len(names)))
    angles[2, 1] = np.nan
    pose = dict(zip(POSE, np.array([[1.0] * 3, [2.0] * 3, [0.0] * 3]), strict=True))
    recording = Recording("turned", "pool", names, np.arange(3.0), angles, angles, columns=pose)
    present, points = axis_points(recording, robot)
    assert present.tolist() == [True, True, False]
    lengths = np.array([link.length_m for link in robot.links])
    head = robot.links[0]
    front = 1.0 + (lengths[0] / 2 if head.com_m is None else head.com_m)
    straight = points[0]
    np.testing.assert_allclose(straight[:, 0], front - np.concatenate([[0], np.cumsum(lengths)]))
    assert not straight[:, 2].any()
    np.testing.assert_allclose(straight[:, 1], 2.0)


def test_scenes_add_up(bench: Recording) -> None:
    both = recorded(bench) + with_prediction(bench, "j2", bench.command[:, 1])
    signals = {group.path[1:]: tuple(group.signals) for group in both.groups}
    assert signals["j1", "position"] == ("command", "measured")
    assert signals["j2", "position"] == ("command", "measured", "predicted")
    later = Scene((SignalGroup(("a b/c", "j1", "position"), "rad", bench.t + 1, {"x": bench.t}),))
    with pytest.raises(ValueError, match="two time axes"):
        recorded(bench) + later


@pytest.mark.parametrize("name", ["rerun", "mcap"])
def test_a_missing_library_is_named(name, bench, tmp_path, monkeypatch) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == name]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)
    writer = getattr(importlib.import_module("sim2real.viewers"), f"write_{name}")
    wanted = "pip install 'sim2real[view]'"
    message(lambda: writer(recorded(bench), tmp_path / "a.file"), f"--{name}: found no", wanted)
    assert not list(tmp_path.iterdir())


def test_a_file_with_another_ending_is_refused(tmp_path, capsys) -> None:
    out = ("--out", str(tmp_path / "p.csv"), "--mcap", str(tmp_path / "p.json"))
    model = ROOT / "reports" / "servo_steps" / "model.json"
    status = main(["predict", str(model), str(DATA / "chirp.csv"), *out])
    refused(capsys, status, "--mcap: found the ending '.json', expected .mcap")
    assert not list(tmp_path.iterdir())


def test_predict_shows_what_was_measured_too(short: Path, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra 'view' is not installed")
    model = ROOT / "reports" / "servo_steps" / "model.json"
    chirp = short / "datasets" / "servo_steps" / "chirp.csv"
    out = ("--out", str(tmp_path / "p.csv"), "--mcap", str(tmp_path / "p.mcap"))
    assert main(["predict", str(model), str(chirp), *out]) == 0
    measured = read_recording(chirp).position[:, 0]
    predicted = read_recording(tmp_path / "p.csv").position[:, 0]
    topics = mcap_messages(tmp_path / "p.mcap")
    contents = [content for _, content in topics["/chirp/j1/residual"]]
    residual = measured - predicted
    shown = [content["predicted"] for content in contents]
    np.testing.assert_allclose(shown, residual[np.isfinite(residual)], atol=1e-8)


def test_a_diagnosis_shows_the_swims_of_both_models() -> None:
    robot, plain = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
    recording = read_recording(POOL / "p1.csv").between(0, 150)
    swim = swim_of(recording, robot)
    slower = {
        name: replace(joint, kp_Nm_per_rad=0.3 * joint.kp_Nm_per_rad)
        for name, joint in plain.joints.items()
    }
    enriched = replace(plain, joints=slower)
    found = Diagnosis("explained", (), (), (), {}, {}, {}, enriched, baseline=plain)
    simulate = by_followed_twin(robot)
    scene = swims_scene(found, [recording], [swim], simulate, robot)
    assert [track.path for track in scene.tracks] == [
        ("p1", "body", "measured"),
        ("p1", "body", "plain"),
        ("p1", "body", "enriched"),
    ]
    measured, before, after = scene.tracks
    np.testing.assert_array_equal(before.t, recording.t)
    np.testing.assert_allclose(before.points[0, 0], measured.points[0, 0], atol=0.02)
    assert np.abs(before.points - after.points).max() > 0.02
    groups = {group.path: group for group in scene.groups}
    simulated = groups["p1", "j1", "position"].signals
    assert list(simulated) == ["command", "measured", "plain", "enriched"]
    assert np.ptp(simulated["enriched"]) < np.ptp(simulated["plain"])
    alone = swims_scene(found, [recording], [swim], None, robot)
    assert len(alone.tracks) == 1
