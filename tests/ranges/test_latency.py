from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.ranges.latency import latencies
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
