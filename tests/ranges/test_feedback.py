from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated

from sim2real.ranges.sources import camera_noise, joint_noise, labelled, listed


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


def test_repeated_frames_and_lost_ones():
    recording = filmed(1)
    columns = {}
    for name, values in recording.columns.items():
        held = values[np.arange(values.size) // 2 * 2].copy()  # 25 frames a second
        held[100:200] = np.nan
        columns[name] = held
    place, _ = camera_noise([replace(recording, columns=columns)])
    assert place.second == pytest.approx(0.05, rel=0.15)


def test_no_camera():
    assert camera_noise([simulated.recording()]) == []


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
