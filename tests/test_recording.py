"""Recordings and models: reading gives back what was written, and old files mean what they did."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from good_input import SIDECAR
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.model import FittedEffect, JointModel, Model, read_model, write_model
from sim2real.recording import Load, Recording, read_commands, read_recording, write_recording
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

ROUNDING = 1e-9  # nine decimals are written

ANGLES = st.floats(-LARGEST_ANGLE_RAD + 1e-6, LARGEST_ANGLE_RAD - 1e-6)
POSITIVE = st.floats(1e-6, 1e3)
NAMES = st.text("abcXYZ019_-é关 ", min_size=1, max_size=6).map(str.strip).filter(bool)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
).filter(lambda value: "Infinity" not in json.dumps(value))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Any recording that the format allows."""
    joints = tuple(draw(st.lists(NAMES, min_size=1, max_size=3, unique=True)))
    samples = draw(st.integers(2, 12))
    steps = st.lists(st.floats(1e-4, 0.4), min_size=samples, max_size=samples)

    def column(values: st.SearchStrategy[float]) -> np.ndarray:
        return np.array(draw(st.lists(values, min_size=samples, max_size=samples)))

    kind = draw(st.sampled_from(["servo", "pool"]))
    command = np.stack([column(ANGLES) for _ in joints], axis=1)
    if kind == "pool" and draw(st.booleans()):
        command[:] = np.nan  # none recorded
    else:
        for j in range(len(joints)):
            command[draw(st.integers(1, samples)) :, j] = np.nan  # torque off
    extra = draw(st.sets(st.sampled_from(["supply_V", "body.x_m", f"{joints[0]}.current_A"])))
    load = st.builds(Load, POSITIVE, st.floats(0, 9), st.floats(0, 9))
    return Recording(
        name="r",
        kind=kind,
        joints=joints,
        t=np.cumsum(draw(steps)),
        command=command,
        position=np.stack([column(ANGLES | st.just(np.nan)) for _ in joints], axis=1),
        loads=draw(st.dictionaries(st.sampled_from(joints), load)),
        medium=draw(st.sampled_from(["air", "water"])),
        source=draw(st.text(max_size=20)),
        columns={name: column(st.floats(-1e6, 1e6) | st.just(np.nan)) for name in sorted(extra)},
        metadata=draw(st.dictionaries(st.sampled_from(["servo", "notes", "gain"]), JSON)),
    )


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(recording=recordings())
def test_reading_gives_back_what_was_written(tmp_path: Path, recording: Recording) -> None:
    path = tmp_path / "r.csv"
    write_recording(recording, path)
    back = read_recording(path)
    for name in ("name", "kind", "joints", "loads", "medium", "source", "metadata"):
        assert getattr(back, name) == getattr(recording, name)
    for name in ("t", "command", "position"):
        written, read = getattr(recording, name), getattr(back, name)
        np.testing.assert_allclose(read, written, rtol=1e-14, atol=ROUNDING, equal_nan=True)
    assert back.columns.keys() == recording.columns.keys()
    for name, values in recording.columns.items():
        np.testing.assert_allclose(back.columns[name], values, rtol=1e-14, atol=ROUNDING)
    assert back.path == path


def example(tmp_path: Path, **change: Any) -> Recording:
    path = tmp_path / "bench.csv"
    path.write_text(
        "t_s, j1.command_rad, j1.position_rad, j2.command_rad, j2.position_rad, supply_V\n"
        "0.00, 0.1, 0.09, 0, 0, 7.4\n"
        "0.02, 0.1, , 0, 0.01, 7.3\n"
        "0.05, , 0.11, 0.3, 0.02,\n"
        "0.06, , 0.12, 0.3, 0.2, 7.2\n"
    )
    loads = SIDECAR["loads"] | {"j2": {"inertia_kgm2": 1, "pendulum_mass_kg": 2}}
    about = {"joints": ["j1", "j2"], "loads": loads, "source": "a bench", "firmware": 3}
    path.with_suffix(".json").write_text(json.dumps(SIDECAR | about | change))
    return read_recording(path)


def test_fields_of_a_recording(tmp_path: Path) -> None:
    recording = example(tmp_path)
    assert (recording.name, recording.kind, recording.medium) == ("bench", "servo", "air")
    assert recording.joints == ("j1", "j2")
    assert recording.loads == {"j1": Load(0.002), "j2": Load(1.0, 2.0, 0.0)}
    assert (recording.source, recording.metadata) == ("a bench", {"firmware": 3})
    assert recording.duration_s == pytest.approx(0.06)
    assert recording.file == str(tmp_path / "bench.csv")
    np.testing.assert_array_equal(recording.t, [0, 0.02, 0.05, 0.06])
    np.testing.assert_array_equal(recording.command[:, 0], [0.1, 0.1, np.nan, np.nan])
    np.testing.assert_array_equal(recording.position[:, 0], [0.09, np.nan, 0.11, 0.12])
    np.testing.assert_array_equal(recording.position[:, 1], [0, 0.01, 0.02, 0.2])
    np.testing.assert_array_equal(recording.columns["supply_V"], [7.4, 7.3, np.nan, 7.2])
    assert list(recording.columns) == ["supply_V"]
    assert [recording.powered(j) for j in (0, 1)] == [2, 4]


def test_commands_alone(tmp_path: Path) -> None:
    path = tmp_path / "commands.csv"
    path.write_text("t_s,j1.command_rad,remark,j1.position_rad\n0,0.1,slow,\n0.02,0.2,fast,\n")
    read = read_commands(path)
    np.testing.assert_array_equal(read.t, [0, 0.02])
    np.testing.assert_array_equal(read.commands["j1"], [0.1, 0.2])
    assert (read.joints, read.loads) == (("j1",), {})
    recording = example(tmp_path)
    read = read_commands(tmp_path / "bench.csv")  # with a sidecar
    assert (read.loads, read.metadata) == (recording.loads, recording.metadata)
    np.testing.assert_array_equal(read.command, recording.command)


def test_line_endings_and_byte_order_mark(tmp_path: Path) -> None:
    expected = example(tmp_path)
    path = tmp_path / "bench.csv"
    text = path.read_text()
    for written in ("\ufeff" + text, text.replace("\n", "\r\n"), text + "\n\n"):
        path.write_bytes(written.encode())
        np.testing.assert_array_equal(read_recording(path).position, expected.position)


TEXTS = st.text(min_size=1, max_size=8)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
ABOVE_0 = st.floats(1e-9, 1e9)
INTERVALS = st.tuples(
    st.floats(allow_nan=False, max_value=0).filter(lambda low: low != math.inf),
    st.floats(allow_nan=False, min_value=0),
)
EFFECTS = st.lists(
    st.builds(FittedEffect, TEXTS, st.dictionaries(TEXTS.map("{}_".format), NUMBERS, max_size=2)),
    max_size=2,
).map(tuple)
JOINTS = st.builds(
    JointModel,
    kp_Nm_per_rad=ABOVE_0,
    kd_Nms_per_rad=st.floats(0, 1e9),
    latency_s=st.floats(0, 1),
    inertia_kgm2=ABOVE_0,
    per_inertia=st.booleans(),
    load=st.none() | st.builds(Load, ABOVE_0, st.floats(0, 9), st.floats(0, 9)),
    interval=st.dictionaries(TEXTS, INTERVALS, max_size=3),
    correlation=st.dictionaries(TEXTS, st.floats(-1, 1), max_size=2),
    effects=EFFECTS,
    notes=st.lists(st.text(), max_size=2).map(tuple),
)
MODELS = st.builds(
    Model,
    joints=st.dictionaries(TEXTS.filter(str.isprintable), JOINTS, max_size=3),
    body=st.dictionaries(TEXTS.map("_{}".format), st.lists(NUMBERS, max_size=3), max_size=2),
    effects=EFFECTS,
    fit=st.dictionaries(TEXTS, st.dictionaries(TEXTS, NUMBERS | st.none()), max_size=2),
    provenance=st.dictionaries(TEXTS, st.text() | st.integers() | st.none(), max_size=2),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(model=MODELS)
def test_reading_a_model_gives_back_what_was_written(tmp_path: Path, model: Model) -> None:
    write_model(model, tmp_path / "model.json")
    assert read_model(tmp_path / "model.json") == model


def test_infinite_ends_are_null(tmp_path: Path) -> None:
    interval = {"kp_Nm_per_rad": (2.1, math.inf), "latency_s": (-math.inf, 0.1)}
    model = Model({"j1": JointModel(2.2, 0.06, 0.068, 0.002, interval=interval)})
    write_model(model, tmp_path / "model.json")
    written = json.loads((tmp_path / "model.json").read_text())["joints"]["j1"]
    assert written["interval"] == {"kp_Nm_per_rad": [2.1, None], "latency_s": [None, 0.1]}
    assert read_model(tmp_path / "model.json").joints["j1"].interval == interval


def test_a_model_by_hand_may_be_short(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    joint = {"kp_Nm_per_rad": 2, "kd_Nms_per_rad": 0, "latency_s": 0, "inertia_kgm2": 1}
    backlash = {"effect": "backlash", "parameters": {"gap_rad": 0.03}}
    content = {
        "schema": "sim2real.model/1",
        "joints": {"j1": joint | {"effects": [backlash], "a later field": 1}},
        "fit": {"j1.position_rad": {"train": 0.004, "heldout": None}},
    }
    path.write_text(json.dumps(content))
    model = read_model(path)
    assert model.joints["j1"].effects == (FittedEffect("backlash", {"gap_rad": 0.03}),)
    assert model.joints["j1"].interval == {}
    assert model.fit == {"j1.position_rad": {"train": 0.004, "heldout": None}}
    assert (model.body, model.effects) == ({}, ())


@pytest.mark.parametrize("effect", ["backlash", "compliance"])
def test_a_file_whose_load_includes_the_rotor_moves_as_it_did(tmp_path: Path, effect: str) -> None:
    """In files of earlier versions a gear train's rotor was taken out of the stated inertia."""
    path, load, rotor, of_law = tmp_path / "model.json", Load(0.003, 0.1, 0.1), 0.0008, 0.0003
    size = {"gap_rad": 0.03} if effect == "backlash" else {"compliance_rad_per_Nm": 0.05}
    train = {"effect": effect, "parameters": size | {"rotor_inertia_kgm2": rotor}}
    joint = {"kp_Nm_per_rad": 2, "kd_Nms_per_rad": 0.1, "latency_s": 0.02, "inertia_kgm2": 0.003}
    joint |= {"load": vars(load), "law": "motor", "motor": {"rotor_inertia_kgm2": of_law}}
    content = {"schema": "sim2real.model/1", "joints": {"j1": joint | {"effects": [train]}}}
    path.write_text(json.dumps(content))
    (read,) = read_model(path).joints.values()
    # the motor's side had the rotor of the train, the output's side all that was left
    output = replace(load, inertia_kgm2=load.inertia_kgm2 + of_law - rotor)
    now = FittedEffect(effect, train["parameters"])
    same = JointModel(2.0, 0.1, 0.02, output.inertia_kgm2, load=output, effects=(now,))
    t = 0.01 * np.arange(200)
    command = 0.4 * np.sign(np.sin(9 * t))
    before, after = (
        rollout(joint_row(one, None)[None], t, command, substep_s=1e-3) for one in (same, read)
    )
    np.testing.assert_allclose(after, before, atol=1e-12)
    write_model(read_model(path), path)
    assert read_model(path).joints["j1"] == read
