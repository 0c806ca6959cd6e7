"""Foreign plants: reproducible, no answer in the inputs, and each moves as a servo does."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim2real.recording import read_recording
from sim2real.robot import match_joints, read_robot

pytest.importorskip("numba", reason="generating cases needs numba")
pytest.importorskip("mujoco", reason="one of the plants is MuJoCo's")

ROOT = Path(__file__).parents[2] / "datasets"
FOLDERS = [ROOT / "foreign", ROOT / "concealed"]


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    names = ("make_foreign", "foreign_cases", "foreign_servos", "foreign_world")
    with scripts(*FOLDERS, names=names) as modules:
        yield modules


@pytest.fixture(scope="module")
def challenge(code, tmp_path_factory):
    out = tmp_path_factory.mktemp("foreign") / "out"
    counts = {"null": 3, "single": 3, "double": 0, "outside": 0}
    plan = code["make_foreign"].plan(counts, np.random.default_rng(5))
    answers = [code["make_foreign"].make((out, 5, k, case, False)) for k, case in enumerate(plan)]
    return out, answers


def test_every_plant_is_there(challenge):
    _, answers = challenge
    assert {one["plant"] for one in answers} == {"mujoco", "voltage", "own"}


def test_the_recordings_can_be_read_and_the_inputs_do_not_tell(challenge):
    out, answers = challenge
    for one in answers:
        folder = out / "inputs" / one["case"]
        robot = read_robot(folder / "robot.toml")
        for name in ("a", "b"):
            match_joints(read_recording(folder / f"{name}.csv"), robot)
        assert {path.stem for path in folder.iterdir()} <= {"a", "b", "robot", "model"}
        text = "".join(path.read_text() for path in folder.glob("*.json"))
        assert one["plant"] not in text
        assert not any(effect["effect"] in text for effect in one["effects"])


def test_the_same_seed_gives_the_same_case(challenge, code, tmp_path):
    out, answers = challenge
    one = answers[0]
    case = code["foreign_cases"].draw_case(*one["drawn"], np.random.default_rng(one["seed"]))
    seen = read_recording(out / "inputs" / one["case"] / "a.csv")
    assert seen.position == pytest.approx(case.takes["a"].measured, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("plant", ["mujoco", "voltage", "own"])
def test_a_plant_without_nuisances_is_a_proportional_servo(code, plant):
    """It starts late by its latency, is no faster than its motor, rests where torques balance."""
    rng = np.random.default_rng(3)
    servo = code["foreign_servos"].draw_servos(plant, rng)[0]
    servo.nuisances["ripple_Nm"] = 0.0
    t = np.arange(0.0, 4.0, 0.01)
    command = np.where(t < 1.0, 0.0, 0.4)[:, None]
    take = code["foreign_world"].Take(t, command, np.full((2, t.size), 0.5), 0.0)
    cases = code["foreign_cases"]
    case = cases.ForeignCase(plant, "null", [servo], [], {"a": take})
    q = case.readings("a", bent=False)[:, 0]
    rest, weight = q[-1], servo.loads["a"].gravity_Nm
    pull = servo.kp * (0.4 - rest)
    assert pull == pytest.approx(weight * np.sin(rest), abs=0.008 * servo.kp)
    assert np.abs(q[t < 1.0 + servo.latency_s - servo.read_s]).max() < 1e-6
    assert np.gradient(q, t).max() < 1.05 * servo.no_load_speed_rad_s


def test_a_sensor_is_calibrated_over_its_range(code):
    servo = code["foreign_servos"].draw_servos("voltage", np.random.default_rng(1))[0]
    q = np.linspace(-0.8, 0.8, 161)
    assert np.polyfit(q, servo.bent(q), 1) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.abs(servo.bent(q)).max() < 3 * max(servo.eccentric[0], 1e-12)


def test_answers_say_what_is_always_on(challenge):
    _, answers = challenge
    for one in answers:
        cogging = [n for n in one["nuisances"] if n["effect"] == "cogging"]
        assert len(cogging) == len(one["servos"])
    assert json.dumps(answers)
