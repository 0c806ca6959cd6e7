"""Slow errors of laws as noise: innovations by a Kalman filter, and how large they are."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import traced

from sim2real.diagnose.servo_search import baselines
from sim2real.diagnose.torque_speed_line import with_stated_line
from sim2real.inference.correlated_noise import SlowErrors
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS, LINE_COLUMNS
from sim2real.servo.rollout import to_warp
from sim2real.servo.slow_noise import SlowNoise, slow_errors

SLOW = SlowErrors(5e-4, angle_rad=4e-3, delay_s=2e-3, angle_time_s=0.8, delay_time_s=0.2)


@pytest.fixture(scope="module")
def noisy():
    """A recording without some readings, and a residual of it with slow errors and white noise."""
    trace = replace(traced(3), slow=SLOW)
    trace.used[[7, 20, 21]] = False
    trace = replace(trace, spread=1 + np.abs(trace.speed()))
    return trace, np.linalg.cholesky(covariance(trace)) @ np.random.default_rng(1).normal(
        size=trace.t.size
    )


def covariance(trace):
    """Of residuals, by the definition of both processes."""
    apart = trace.period_s * np.abs(np.subtract.outer(*[np.arange(trace.t.size)] * 2))
    moving = SLOW.delay_s**2 * np.outer(trace.speed(), trace.speed())
    angle = SLOW.angle_rad**2 * np.exp(-apart / SLOW.angle_time_s)
    delay = moving * np.exp(-apart / SLOW.delay_time_s)
    return angle + delay + np.diag((SLOW.noise_rad * trace.spread) ** 2)


def test_innovations_have_the_density_of_their_covariance(noisy):
    trace, residual = noisy
    noise = SlowNoise([trace])
    angle = to_warp(np.where(trace.used, residual, 0.0)[None] * noise.weight)
    logarithm = noise.whiten(to_warp(np.zeros(1, dtype=np.int32)), angle).numpy()[0]
    found = np.sum(angle.numpy() ** 2) / SLOW.noise_rad**2 + logarithm
    scale = (SLOW.noise_rad * trace.spread[trace.used]) ** 2
    dense = covariance(trace)[np.ix_(trace.used, trace.used)]
    left = residual[trace.used]
    expected = left @ np.linalg.solve(dense, left) + np.linalg.slogdet(dense)[1]
    assert found == pytest.approx(expected - np.log(scale).sum(), rel=1e-6)


def test_slow_errors_are_found_in_what_a_servo_leaves(noisy):
    trace, residual = noisy
    found = slow_errors([trace], residual[None], SLOW.noise_rad)
    assert found.angle_rad == pytest.approx(SLOW.angle_rad, rel=0.5)
    assert found.delay_s == pytest.approx(SLOW.delay_s, rel=0.5)
    white = SLOW.noise_rad * trace.spread * np.random.default_rng(2).normal(size=residual.size)
    none = slow_errors([trace], white[None], SLOW.noise_rad)
    assert none.angle_rad < 0.1 * SLOW.angle_rad
    assert none.delay_s < 0.5 * SLOW.delay_s


def test_a_hold_that_is_wrong_says_little_of_a_law(noisy):
    """Of an error that lasts, white noise takes each reading for one that speaks for itself."""
    trace, _ = noisy
    wrong = replace(trace, position=trace.position + SLOW.angle_rad)

    def gain(slow):
        problems = Problems(np.zeros(1, dtype=np.int32), theta[:, None], np.zeros((1, 1)))
        both = [Batch([[replace(t, slow=slow)]], white=slow is None) for t in (trace, wrong)]
        right, off = (float(b.evaluate(problems).gram[0, :, 0, 0].sum()) for b in both)
        return (off - right) / SLOW.noise_rad**2

    theta = baselines(Batch([[trace]], white=True)).servos.theta
    assert gain(SLOW) < 0.05 * gain(None)


def test_no_stated_line_beside_a_limit_of_the_set_points_speed(noisy):
    trace = replace(noisy[0], load=Load(0.002))
    servo = Servo("strong", 50.0, 50.0, 0.004)
    row = baselines(Batch([[trace]], white=True)).servos.theta[0]
    assert with_stated_line([trace], servo, row)[LINE_COLUMNS].all()
    row[COLUMNS.index("rate_limit.limit_rad_s")] = 6.0
    assert not with_stated_line([trace], servo, row)[LINE_COLUMNS].any()
