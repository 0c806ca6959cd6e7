"""The sealed challenge's generator: an honest plant, reproducible, no answer in the inputs."""

import json
from pathlib import Path

import numpy as np
import pytest

from datasets.servo_steps import make as plant
from sim2real.model import read_model
from sim2real.recording import read_recording
from sim2real.robot import match_joints, read_robot

pytest.importorskip("numba", reason="generating the sealed challenge needs numba")

FOLDER = Path(__file__).parents[2] / "datasets" / "concealed"
COUNTS = ["--null", "3", "--single", "2", "--double", "1", "--outside", "10", "--no-oracle"]
FEW = ["--seed", "4", "--null", "1", "--single", "1", "--double", "1", "--outside", "1"]


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    with scripts(FOLDER) as modules:
        yield modules


@pytest.fixture(scope="module")
def challenge(code, tmp_path_factory):
    out = tmp_path_factory.mktemp("concealed") / "out"
    code["make"].main([str(out), "--seed", "3", *COUNTS])
    return out, json.loads((out / "answers.json").read_text())


@pytest.fixture(scope="module")
def null_case(code):
    return code["cases"].draw_case("null", "", np.random.default_rng(8))


def test_with_nothing_hidden_it_is_a_pd_servo(code):
    case, _ = code["cases"].draw_case("null", "", np.random.default_rng(9))
    take = case.takes["b"]
    for j, servo in enumerate(case.servos):
        servo.loads["b"] = code["bench"].Load(servo.loads["b"].inertia_kgm2)
        world = case.world("b")
        world.joints["ripple_Nm"] = 0
        seen = world.motion(take.t, take.command, take.chance, [j]).seen[0]
        known = plant.Servo(servo.kp, servo.kd, servo.latency_s, servo.loads["b"].inertia_kgm2)
        error = seen - plant.simulate(known, take.t, take.t, take.command[:, j])[:, 0]
        assert np.sqrt(np.mean(error**2)) < 0.1e-3
        assert np.abs(error).max() < 0.6e-3


def test_every_effect_changes_the_reading(code, null_case):
    case, scales = null_case
    take = case.takes["a"]
    cases, catalogue = code["cases"], code["catalogue"]
    plain = case.world("a").seen(take.t, take.command, take.chance, range(3))
    assert len(catalogue.EFFECTS) == 28
    for name, effect in catalogue.EFFECTS.items():
        hidden = cases.make_effect(name, 1, 1.0, scales[1], np.array([0.7, 0.5, 0.5]))
        world = code["world"].build_world(case.servos, "a", [hidden])
        seen = world.seen(take.t, take.command, take.chance, range(3))
        moved = np.sqrt(np.mean((seen - plain) ** 2, axis=1)) > 1e-4
        if name == "encoder_quantization":
            assert world.steps_rad[1] >= 2 * case.servos[1].sensor.step_rad
        elif effect.place == "joint":
            assert moved.tolist() == [False, True, False], name
        else:
            assert moved.all(), name


def test_the_same_seed_gives_the_same_bytes(code, tmp_path):
    for out in ("first", "again"):
        code["make"].main([str(tmp_path / out), *FEW])
    files = sorted(p for p in (tmp_path / "first").rglob("*") if p.is_file())
    assert len(files) >= 4 * 7 + 2
    for path in files:
        again = tmp_path / "again" / path.relative_to(tmp_path / "first")
        assert path.read_bytes() == again.read_bytes()


def test_inputs_are_as_the_interface_says(challenge):
    out, answers = challenge
    for answer in answers:
        folder = out / "inputs" / answer["case"]
        robot = read_robot(folder / "robot.toml")
        for name in ("a", "b"):
            recording = read_recording(folder / f"{name}.csv")
            match_joints(recording, robot)
            assert recording.duration_s == pytest.approx(30, abs=0.05)
            assert set(recording.loads) == {"j1", "j2", "j3"}
            assert np.all(recording.command[0] == 0)
        given = folder / "model.json"
        assert given.exists() == (answer["model_given"] != "none")
        if given.exists():
            read_model(given)


def test_no_answer_leaks_into_the_inputs(code, challenge):
    out, answers = challenge
    words = {*code["catalogue"].EFFECTS, *code["outside"].OUTSIDERS, *code["make"].TRAPS}
    words |= {"null", "trap", "single", "double", "outside", "seed", "strength"}
    sources = set()
    for answer in answers:
        folder = out / "inputs" / answer["case"]
        names = {path.name for path in folder.iterdir()} - {"model.json"}
        assert names == {"robot.toml", "a.csv", "a.json", "b.csv", "b.json"}
        for path in folder.iterdir():
            text = path.read_text()
            assert not any(word in text for word in words), path
        sources.add(json.loads((folder / "a.json").read_text())["source"])
    assert len(sources) == 1


def test_answers_say_what_is_hidden_and_when(code, challenge):
    _, answers = challenge
    expected = {"null": 0, "trap": 0, "single": 1, "double": 2, "outside": 1}
    kinds = [a["kind"] for a in answers]
    assert [kinds.count(k) for k in expected] == [2, 1, 2, 1, 10]
    assert {a["seed"] for a in answers} == {3}
    for answer in answers:
        assert len(answer["effects"]) == expected[answer["kind"]]
        for effect in answer["effects"]:
            assert effect["component"] in ("j1", "j2", "j3", "supply", "link")
            assert (effect["effect"] in code["catalogue"].EFFECTS) == (answer["kind"] != "outside")
        if answer["kind"] != "outside":
            assert answer["windows_s"] == {}
            continue
        lasts = code["outside"].OUTSIDERS[answer["effects"][0]["effect"]].lasts_s
        windows = answer["windows_s"]
        assert bool(windows) == (lasts is not None)
        if lasts is not None:
            assert windows["c"] and (windows["a"] or windows["b"])
            for start, stop in (w for each in windows.values() for w in each):
                assert 0 < start < stop <= 30


def test_strong_effects_are_seen_by_one_who_knows_and_absent_ones_are_not(code, null_case):
    case, scales = code["cases"].draw_case("single", "coulomb_friction", np.random.default_rng(4))
    said = code["oracle"].consult(case, scales, groups=False)
    assert said["llr_total"] > 10
    assert set(said["llr"]) == {case.hidden[0].component}
    sensor = case.servos[case.hidden[0].joint].sensor
    noise = np.hypot(np.hypot(sensor.white_rad, sensor.wander_rad), sensor.step_rad / np.sqrt(12))
    floor = said["heldout_floor_rad"][case.hidden[0].component]
    assert floor == pytest.approx(noise, rel=0.4)
    null, null_scales = null_case
    faint = code["cases"].make_effect("sensor_gain", 0, 1e-6, null_scales[0], np.full(3, 0.5))
    null.hidden = [faint]
    assert abs(code["oracle"].consult(null, null_scales, groups=False)["llr_total"]) < 10
    null.hidden = []


def test_the_noise_is_whitened(code):
    rng = np.random.default_rng(5)
    sensor = code["bench"].Sensor(0.0, 1e-3, 1.5e-3, 2.0)
    t = np.cumsum(rng.uniform(0.01, 0.03, size=20000))
    residual = code["sensor"].noise(sensor, t, rng)
    white, _ = code["likelihood"].whiten(residual, t, sensor, 0.0)
    assert np.std(white) == pytest.approx(1, abs=0.03)
    lagged = np.corrcoef(white[1:], white[:-1])[0, 1]
    assert abs(lagged) < 0.03
