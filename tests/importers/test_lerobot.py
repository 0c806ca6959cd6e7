import json
import math

import numpy as np
import pytest
from good_input import message

from sim2real.cli import main
from sim2real.importers.lerobot import read_lerobot
from sim2real.importers.options import conversion

pytest.importorskip("pyarrow", reason="LeRobot datasets are read with pyarrow")

from lerobot_files import FPS, MOTORS, calibration, dataset

VERSIONS = ("v2.1", "v3.0")
RNG = np.random.default_rng(5)
EPISODES = [(RNG.uniform(-40, 40, (n, 3)), RNG.uniform(-40, 40, (n, 3))) for n in (20, 35)]
DEGREES = conversion(["deg"])


@pytest.mark.parametrize("version", VERSIONS)
def test_an_episode_in_degrees(tmp_path, version):
    root = dataset(tmp_path / "arm", version, EPISODES)
    for number, (state, action) in enumerate(EPISODES):
        recording = read_lerobot(root, DEGREES, episode=number)
        assert recording.joints == tuple(MOTORS)
        assert recording.t == pytest.approx(np.arange(len(state)) / FPS, abs=1e-6)
        assert recording.position == pytest.approx(np.radians(state), abs=1e-5)
        assert recording.command == pytest.approx(np.radians(action), abs=1e-5)
        assert not recording.loads
        assert recording.metadata["robot_type"] == "so101_follower"


def test_normalised_units_by_the_calibration_file(tmp_path):
    state = np.array([[-100, 0, 0], [100, 50, 100.0], [0, 0, 50]])
    root = dataset(tmp_path / "arm", "v3.0", [(state, state)])
    file = calibration(tmp_path / "follower_arm.json")
    units = conversion(["range_m100_100", "gripper=range_0_100"], 4096, None, file)
    counts = np.array([[-1238, 0, -616], [1238, 548, 616], [0, 0, 0]])
    expected = pytest.approx(counts * 2 * math.pi / 4096, abs=1e-6)
    assert read_lerobot(root, units).position == expected


def test_joints_chosen_and_joints_named(tmp_path):
    root = dataset(tmp_path / "arm", "v3.0", EPISODES)
    some = read_lerobot(root, DEGREES, episode=0, joints=["gripper", "shoulder_pan"])
    assert some.joints == ("gripper", "shoulder_pan")
    assert some.position == pytest.approx(np.radians(EPISODES[0][0][:, [2, 0]]), abs=1e-5)
    bare = dataset(tmp_path / "bare", "v3.0", EPISODES, names=None)
    named = read_lerobot(bare, DEGREES, episode=0, joints=["a", "b", "c"])
    assert named.position[:, 1] == pytest.approx(np.radians(EPISODES[0][0][:, 1]), abs=1e-5)
    message(lambda: read_lerobot(bare, DEGREES, episode=0), "--joints", "3 names")


def test_what_is_not_read_is_named(tmp_path, capsys):
    root = dataset(tmp_path / "arm", "v3.0", EPISODES[:1])
    file = root / "meta" / "info.json"
    features = json.loads(file.read_text())["features"]
    features["action"] = features["action"] | {"names": ["shoulder_pan", "elbow_flex", "wrist"]}
    features["observation.current"] = {"dtype": "float32", "shape": [3], "names": None}
    spoiled(root, features=features)
    out = tmp_path / "out.csv"
    assert main(["import", str(root), "--units", "deg", "--out", str(out)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("! ")]
    lines = [line for line in lines if not line.startswith("! warning: ")]  # of these angles
    assert lines == [
        "! observation.state of gripper is not read.",
        "! action of wrist is not read.",
        "! observation.current: not read.",
    ]
    units = conversion(["deg", "elbow_flex.command=rad"])
    message(lambda: read_lerobot(root, units), "elbow_flex, command", "if angles are rad")


def spoiled(root, **fields):
    file = root / "meta" / "info.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | fields))
    return root


@pytest.mark.parametrize("version", VERSIONS)
def test_bad_input(tmp_path, version):
    root = dataset(tmp_path / "arm", version, EPISODES)

    def read(units=DEGREES, episode=0, joints=None):
        return lambda: read_lerobot(root, units, episode=episode, joints=joints)

    message(read(episode=None), "--episode", "one of the 2")
    message(read(episode=2), "--episode", "0 to 1")
    message(read(joints=["wrist"]), "no wrist", "shoulder_pan")
    message(read(joints=["gripper", "gripper"]), "--joints", "each joint once")
    message(read(conversion(["elbow_flex=deg"])), "--units", "none for shoulder_pan")
    message(read(conversion(["rad"])), "if angles are rad", "at most 12.6 rad")
    file = calibration(tmp_path / "c.json")
    bad = json.loads(file.read_text())
    bad["shoulder_pan"]["range_max"] = 754
    file.write_text(json.dumps(bad))
    message(read(conversion(["range_m100_100"], 4096, None, file)), "shoulder_pan.range_max", "754")
    data = min((root / "data").rglob("*.parquet"))
    data.write_bytes(data.read_bytes()[:200])
    message(read(), data.name, "no Parquet")
    data.unlink()
    message(read(), data.name, "no such file")
    spoiled(root, codebase_version="v1.6")
    message(read(), "codebase_version", "v2.0, v2.1 or v3.0")
    spoiled(root, codebase_version=version, data_path="data/{nothing}.parquet")
    message(read(), "data_path")


def test_units_are_asked_for(tmp_path, capsys):
    root = dataset(tmp_path / "arm", "v3.0", EPISODES[:1])
    assert main(["import", str(root), "--out", str(tmp_path / "x.csv")]) == 2
    assert "found no --units, expected --units rad|deg" in capsys.readouterr().err
    assert not (tmp_path / "x.csv").exists()
    message(lambda: conversion(["range_m100_100"], 4096), "--calibration")
    message(lambda: conversion(["range_0_100"], None, None, "c.json"), "--counts-per-turn")
    message(lambda: conversion(["counts"], 4096), "--zero-count")
    message(lambda: conversion(["counts"], None, 2048), "--counts-per-turn")
    message(lambda: conversion(["degrees"]), "--units", "'degrees'", "deg")
    message(lambda: conversion(["deg", "rad"]), "--units", "two for all joints")
