import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated

from sim2real.errors import InputError
from sim2real.ranges.entry import Ranges, normal, read_ranges, uniform, write_ranges
from sim2real.ranges.sources import camera_noise, joint_noise, labelled, listed

RANGES = Ranges(
    (
        uniform("command_latency_s", 0.048, 0.088, "s", "forty swims"),
        normal("body.position_noise_m", 0.0, 0.05, "m", "forty swims", "step"),
    ),
    "posterior.npz",
    ("a note",),
    {"seed": 0},
)


@pytest.fixture
def file(tmp_path):
    write_ranges(RANGES, tmp_path / "ranges.json")
    return tmp_path / "ranges.json"


def test_the_file_is_as_the_interface_says_and_is_read(file):
    assert read_ranges(file) == RANGES
    content = json.loads(file.read_text())
    assert content["schema"] == "sim2real.ranges/1"
    assert content["ranges"][0] == {
        "parameter": "command_latency_s", "distribution": "uniform", "low": 0.048, "high": 0.088,
        "unit": "s", "period": "episode", "source": "forty swims",
    }  # fmt: skip
    assert {"mean", "sd"} < content["ranges"][1].keys()


@pytest.mark.parametrize(
    ("field", "value"),
    [("distribution", "cauchy"), ("period", "day"), ("high", 0.01), ("low", None)],
)
def test_a_spoilt_file(file, field, value):
    content = json.loads(file.read_text())
    content["ranges"][0][field] = value
    file.write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        read_ranges(file)
    assert error.value.where == f"ranges[0].{field}"


def test_two_different_ends_never_read_the_same():
    near = uniform("j1.kp_Nm_per_rad", 2.1, 2.1 * (1 + 1e-9), "N m/rad", "a fit")
    low, high = near.numbers(4).split(" to ")
    assert low != high and float(low) == pytest.approx(2.1)
    assert uniform("a", 0.0676, 0.0679, "s", "").numbers(4) == "0.0676 to 0.0679"
    assert normal("a", 0.0, 0.00199, "m", "").numbers(3) == "0 ± 0.00199"


def test_a_range_of_no_width_is_a_fixed_number():
    fixed = uniform("j1.kp_Nm_per_rad", 2.1, 2.1, "N m/rad", "the model")
    assert fixed.constant and fixed.numbers(4) == "2.1"
    assert "fixed" in str(Ranges([fixed])) and "2.1 to" not in str(Ranges([fixed]))
    assert not normal("a", 2.1, 2.1, "", "").constant


def filmed(seed, place=0.05, direction=0.05, **columns):
    recording = simulated.recording(seed, f"r{seed}", seconds=30.0)
    rng, t = np.random.default_rng(seed), recording.t
    yaw = 3.0 + 0.2 * t + 0.1 * np.sin(6 * t) + direction * rng.standard_normal(t.size)
    seen = {
        "body.x_m": 0.1 * t + place * rng.standard_normal(t.size),
        "body.y_m": 0.02 * np.sin(6 * t) + place * rng.standard_normal(t.size),
        "body.yaw_rad": (yaw + np.pi) % (2 * np.pi) - np.pi,
    }
    return replace(recording, columns=seen | columns)


def test_camera():
    place, heading = camera_noise([filmed(k) for k in range(4)])
    assert (place.parameter, place.unit, place.period) == ("body.position_noise_m", "m", "step")
    assert place.first == 0 and place.second == pytest.approx(0.05, rel=0.06)
    assert heading.second == pytest.approx(0.05, rel=0.06)
    assert "r0, r1, r2, r3" in heading.source
    assert camera_noise([simulated.recording()]) == [], "without a camera"


def test_repeated_frames_and_lost_ones():
    recording = filmed(1)
    columns = {}
    for name, values in recording.columns.items():
        held = values[np.arange(values.size) // 2 * 2].copy()  # 25 frames a second
        held[100:200] = np.nan
        columns[name] = held
    place, _ = camera_noise([replace(recording, columns=columns)])
    assert place.second == pytest.approx(0.05, rel=0.15)


def test_joint():
    given = [simulated.recording(k, noise=0.035, seconds=30.0) for k in range(3)]
    found = joint_noise(given, "j1")
    assert found.second == pytest.approx(0.035, rel=0.06) and found.unit == "rad"
    assert joint_noise(given, "j2") is None


def test_many_recordings_are_counted():
    assert listed(["a", "b"]) == "a, b"
    assert listed([f"r{k}" for k in range(9)]) == "r0 to r8 (9 recordings)"


def test_recordings_of_one_name_stay_apart():
    a, b = (replace(simulated.recording(), path=Path(day) / "r.csv") for day in ("mon", "tue"))
    assert labelled([a, b]) == {"mon/r.csv": "mon/r.csv", "tue/r.csv": "tue/r.csv"}
    assert labelled([a]) == {"mon/r.csv": "steps"}
