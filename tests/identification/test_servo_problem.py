"""Many fits in step: known parameters come back, bounds hold, and no fit disturbs another."""

import numpy as np
import pytest
from simulated import INERTIA, KD, KP, LATENCY, column, row, traced

from sim2real.identification.servo_problem import Servos, minimise, variants
from sim2real.servo.batch import Batch

FRICTION = 0.05
TRUTH = np.array([KP, KD, LATENCY, FRICTION])
COLUMNS = np.array([0, 1, 2, column("coulomb_friction.torque_Nm")], dtype=np.int32)
UNIT = np.array([2.0, 0.05, 0.05, 0.05])
LOW, HIGH = np.zeros(4), np.array([50.0, 1.0, 0.3, 1.0])


def servos(*starts, low=LOW, high=HIGH, joint=None):
    """Servos that start from rows of kp, kd, latency and friction."""
    N = len(starts)
    theta = np.repeat(row()[None], N, axis=0)
    theta[:, COLUMNS] = starts
    repeated = (np.repeat(np.asarray(x)[None], N, axis=0) for x in (COLUMNS, UNIT, low, high))
    joint = np.zeros(N) if joint is None else joint
    return Servos(np.asarray(joint, dtype=np.int32), theta, *repeated)


FAR = (1.7, 0.045, 0.06, 0.01)


@pytest.fixture(scope="module")
def batch():
    rubbing = {"coulomb_friction": {"torque_Nm": FRICTION}}
    first, second = (
        [traced(k, "a", **rubbing), traced(k + 1, "b", seconds=10.0, **rubbing)] for k in (1, 3)
    )
    return Batch([first, second])


@pytest.fixture(scope="module")
def fits(batch):
    return minimise(batch, servos(FAR, FAR, joint=[0, 1]), iterations=40, blocks=5)


def spread(fits, n):
    """Standard deviations of the free parameters."""
    normal = fits.gram[n].sum(axis=0)[1:, 1:]
    variance = fits.error2[n] / fits.count[n]
    return np.sqrt(variance * np.diag(np.linalg.inv(normal))) * UNIT


def test_known_parameters_come_back_and_what_is_left_is_noise(fits):
    for n in range(2):
        error = np.abs(fits.servos.theta[n, COLUMNS] - TRUTH)
        assert (error < 4 * spread(fits, n)).all()
        assert (spread(fits, n) < 0.03 * TRUTH).all(), "these recordings are telling"
    np.testing.assert_allclose(np.sqrt(fits.error2 / fits.count), 0.0015, rtol=0.06)
    expected = -0.5 * fits.count * np.log(fits.error2 / fits.count)
    np.testing.assert_allclose(fits.loglikelihood, expected)
    total = fits.gram.sum(axis=1)
    slope, curvature = total[:, 1:, 0], np.diagonal(total[:, 1:, 1:], axis1=1, axis2=2)
    share = slope**2 / (curvature * fits.error2[:, None])
    assert (share.max(axis=1) * fits.count < 0.3).all(), "no step is worth making"


def test_white_noise_can_be_asked_for_and_inertia_comes_from_the_recording(batch):
    """Whatever the row says of the load, the recording knows better."""
    given = servos(FAR)
    given.theta[:, 3] = 7 * INERTIA
    white = minimise(batch, given, iterations=40, white=True)
    assert (white.autoregression == 0).all()
    np.testing.assert_allclose(white.servos.theta[0, COLUMNS], TRUTH, rtol=0.05)


def test_variants_step_towards_the_inside():
    edge = servos(HIGH, LOW)
    shifted = variants(edge)
    moved = shifted.theta[:, 1:, :][:, range(4), COLUMNS]
    assert (moved[0] < HIGH).all()
    assert (moved[1] > LOW).all()
    step = moved - np.stack([HIGH, LOW])
    np.testing.assert_allclose(shifted.scale[:, 1:] * step, np.tile(UNIT, (2, 1)))
