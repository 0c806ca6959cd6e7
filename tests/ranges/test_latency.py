from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.ranges.latency import latencies, spread
from sim2real.recording import Load

JOINT = JointModel(
    1.2 * simulated.KP, 0.8 * simulated.KD, 0.03, simulated.INERTIA, load=Load(simulated.INERTIA)
)
MODEL = Model({"j1": JOINT})


def early(recording, by):
    """The recording, its set-points logged ``by`` samples before they were sent."""
    moved = np.concatenate([recording.command[by:], np.repeat(recording.command[-1:], by, axis=0)])
    return replace(recording, command=moved)


@pytest.fixture(scope="module")
def recordings():
    return [early(simulated.recording(k, f"r{k}", seconds=6.0), k % 3) for k in range(6)]


def test_each_recording_has_its_own(recordings):
    """Set-points logged one sample (20 ms) early make the latency so much longer."""
    estimate = latencies(recordings, MODEL)
    expected = simulated.LATENCY + simulated.PERIOD * np.array([0, 1, 2, 0, 1, 2])
    assert estimate.episodes == [f"r{k}" for k in range(6)] and not estimate.windows
    np.testing.assert_allclose(estimate.seconds, expected, atol=1e-3)
    assert (np.abs(estimate.seconds - expected) < 4 * estimate.sd + 1e-4).all()


def test_few_recordings_are_cut_into_windows():
    estimate = latencies([simulated.recording(0, seconds=18.0)], MODEL)
    assert estimate.windows and len(estimate.episodes) == 3
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY, atol=1e-3)


def test_a_load_that_is_not_stated_is_no_hindrance(recordings):
    swimming = [replace(r, kind="pool", loads={}) for r in recordings]
    estimate = latencies(swimming, MODEL)
    np.testing.assert_allclose(estimate.seconds, latencies(recordings, MODEL).seconds, atol=1e-4)


def test_what_the_model_knows_is_not_taken_for_latency():
    gap = {"backlash": {"gap_rad": 0.02}}
    recordings = [simulated.recording(k, f"r{k}", seconds=6.0, **gap) for k in range(5)]
    effect = FittedEffect("backlash", gap["backlash"])
    estimate = latencies(recordings, Model({"j1": replace(JOINT, effects=(effect,))}))
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY, atol=2e-4)


def test_joints_differ():
    a, b = (simulated.recording(k, "both", seconds=18.0) for k in (0, 1))
    b = early(b, 1)
    both = replace(
        a,
        joints=("j1", "j2"),
        command=np.hstack([a.command, b.command]),
        position=np.hstack([a.position, b.position]),
        loads={"j1": Load(simulated.INERTIA), "j2": Load(simulated.INERTIA)},
    )
    estimate = latencies([both], Model({"j1": JOINT, "j2": JOINT}))
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY + 0.01, atol=1e-3)
    assert estimate.offset["j1"][0] == pytest.approx(-0.01, abs=1e-3)
    assert estimate.offset["j2"][0] == pytest.approx(0.01, abs=1e-3)


def test_nothing_moves():
    still = simulated.recording(0, command=np.zeros_like)
    assert latencies([still], MODEL) is None


@pytest.mark.parametrize("error", [1e-4, 5e-3])
def test_errors_are_not_counted_as_spread(error):
    """Over many sets, neither the half-width nor the centre is off on average."""
    half, centre = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 40) + error * rng.standard_normal(40)
        estimate = spread(latencies, np.full(40, error))
        half.append(estimate.half_width)
        centre.append(estimate.centre)
    assert np.mean(half) == pytest.approx(0.020, rel=0.03)
    assert np.mean(centre) == pytest.approx(0.068, rel=0.01)


def test_its_interval_holds_the_truth_as_often_as_it_says():
    inside = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 12) + 5e-4 * rng.standard_normal(12)
        low, high = spread(latencies, np.full(12, 5e-4)).half_width_90
        inside += low <= 0.020 <= high
    assert 83 <= inside <= 97


def test_equal_latencies_have_no_spread():
    rng = np.random.default_rng(0)
    estimate = spread(0.06 + 1e-3 * rng.standard_normal(30), np.full(30, 1e-3))
    assert estimate.half_width < 1e-3 and estimate.centre == pytest.approx(0.06, abs=5e-4)


def test_one_latency_leaves_the_spread_open():
    estimate = spread(np.array([0.06]), np.array([1e-3]))
    assert estimate.centre == pytest.approx(0.06, abs=1e-3)
    assert estimate.half_width_90[1] > 5 * estimate.half_width_90[0]
