import numpy as np
import pytest
import simulated
from scipy.signal import lfilter

from sim2real.recording import Load
from sim2real.servo.rollout import WhitenedServo, rollout
from sim2real.servo.trace import trace

CRITICAL = 2 * np.sqrt(simulated.KP * simulated.INERTIA)


@pytest.fixture(scope="module")
def jittered():
    """A recording whose samples come unevenly, some of them missing."""
    recording = simulated.recording(3, seconds=6.0)
    rng = np.random.default_rng(3)
    recording.t[:] += rng.uniform(-0.004, 0.004, recording.t.size)
    recording.position[rng.random(recording.t.size) < 0.02] = np.nan
    return trace(recording, "j1")


WHITE = np.zeros(0)


def whitened(given, lags=WHITE, substep_s=np.inf):
    counts = [one.used.copy() for one in given]
    for one in counts:
        one[: lags.size] = False
    return WhitenedServo(given, counts, lags, substep_s)


def rows(*servos, **effects):
    theta = np.tile(simulated.row(**effects), (len(servos), 1))
    theta[:, :3] = servos
    return theta


@pytest.mark.parametrize("kd", [0.01, 0.06, CRITICAL, 1.00001 * CRITICAL, 0.4])
def test_closed_form_is_a_fine_rollout(jittered, kd):
    theta = rows((simulated.KP, kd, 0.0), (simulated.KP, kd, 0.0513))
    fine = rollout(theta, jittered.t, jittered.command, steps_per_radian=800.0)
    np.testing.assert_allclose(whitened([jittered]).angles(theta, np.inf)[0], fine, atol=1e-6)


def test_substeps_are_those_of_a_rollout(jittered):
    heavy = simulated.traced(load=Load(0.003, 0.1, 0.1), seconds=2.0)
    theta = rows((2.0, 0.05, 0.04), (2.3, 0.07, 0.06), backlash={"gap_rad": 0.03})
    every = whitened([jittered, heavy], substep_s=0.001).angles(theta, 0.001)
    for one, angles in zip([jittered, heavy], every, strict=True):
        theta[:, 3:5] = one.load.inertia_kgm2, one.load.gravity_Nm
        expected = rollout(theta, one.t, one.command, substep_s=0.001)
        assert np.array_equal(angles, expected)


@pytest.mark.parametrize("lags", [[], [0.5], [0.4, -0.1, 0.2, 0.05, 0.1]])
def test_energy_is_that_of_the_filtered_residual(jittered, lags):
    lags = np.array(lags)
    other = simulated.traced(5, seconds=4.0)
    theta = rows((2.0, 0.05, 0.04), (2.3, 0.07, 0.06), (2.2, 0.06, 0.05))
    found = whitened([jittered, other], lags)
    expected = np.zeros(3)
    for one, angles in zip([jittered, other], found.angles(theta, np.inf), strict=True):
        left = np.where(one.used, angles - one.position, 0.0)
        white = lfilter(np.concatenate([[1.0], -lags]), [1.0], left, axis=1)
        counted = one.used.copy()
        counted[: lags.size] = False
        expected += (white[:, counted] ** 2).sum(axis=1)
    np.testing.assert_allclose(found.energy(theta), expected, rtol=1e-10)


def test_a_row_does_not_depend_on_its_neighbours(jittered):
    servos = np.random.default_rng(0).uniform([1.5, 0.03, 0.0], [3.0, 0.1, 0.1], (7, 3))
    for substep_s in (np.inf, 0.002):
        found = whitened([jittered], substep_s=substep_s)
        alone = np.concatenate([found.energy(one[None]) for one in rows(*servos)])
        assert np.array_equal(found.energy(rows(*servos)), alone)
