import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim2real.model import FittedEffect, JointModel, Model, read_model, write_model
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

NAMES = st.text(min_size=1, max_size=8)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-9, 1e9)
INTERVALS = st.tuples(
    st.floats(allow_nan=False, max_value=0).filter(lambda low: low != math.inf),
    st.floats(allow_nan=False, min_value=0),
)
EFFECTS = st.lists(
    st.builds(FittedEffect, NAMES, st.dictionaries(NAMES, NUMBERS, max_size=2)), max_size=2
).map(tuple)
JOINTS = st.builds(
    JointModel,
    kp_Nm_per_rad=POSITIVE,
    kd_Nms_per_rad=st.floats(0, 1e9),
    latency_s=st.floats(0, 1),
    inertia_kgm2=POSITIVE,
    per_inertia=st.booleans(),
    load=st.none() | st.builds(Load, POSITIVE, st.floats(0, 9), st.floats(0, 9)),
    interval=st.dictionaries(NAMES, INTERVALS, max_size=3),
    correlation=st.dictionaries(NAMES, st.floats(-1, 1), max_size=2),
    effects=EFFECTS,
    notes=st.lists(st.text(), max_size=2).map(tuple),
)
MODELS = st.builds(
    Model,
    joints=st.dictionaries(NAMES.filter(str.isprintable), JOINTS, max_size=3),
    body=st.dictionaries(NAMES, st.lists(NUMBERS, max_size=3), max_size=2),
    effects=EFFECTS,
    fit=st.dictionaries(NAMES, st.dictionaries(NAMES, NUMBERS | st.none()), max_size=2),
    provenance=st.dictionaries(NAMES, st.text() | st.integers() | st.none(), max_size=2),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(model=MODELS)
def test_reading_gives_back_what_was_written(tmp_path: Path, model: Model) -> None:
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
