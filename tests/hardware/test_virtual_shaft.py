"""The virtual servo moves as the library's servo law says."""

import numpy as np
import pytest
from simulated import row, steps

from sim2real.hardware.virtual_shaft import Law, Shaft
from sim2real.servo.rollout import rollout

LAW = Law(kp_Nm_per_rad=2.2, kd_Nms_per_rad=0.06, latency_s=0.05, inertia_kgm2=0.002)


def powered():
    shaft = Shaft(LAW, 0.0)
    shaft.powered = True
    return shaft


def test_the_one_law():
    rng = np.random.default_rng(5)
    t = 0.02 * np.arange(400) + rng.normal(0, 5e-4, 400)
    sent = steps(t, rng)
    shaft, angle = powered(), np.empty(t.size)
    for k in range(t.size):
        shaft.command(t[k], sent[k])
        angle[k] = shaft.angle(t[k])
    expected = rollout(row()[None], t, sent)[0]
    assert np.ptp(expected) > 0.5
    assert np.abs(angle - expected).max() < 1e-4


def test_a_timed_move_is_even():
    shaft = powered()
    shaft.command(0.0, 0.4, 2.0)
    lag = LAW.latency_s + LAW.kd_Nms_per_rad / LAW.kp_Nm_per_rad  # of a PD servo on a ramp
    for time in (0.5, 1.0, 1.5):
        assert shaft.angle(time) == pytest.approx(0.2 * (time - lag), abs=1e-4)
    assert shaft.angle(4.0) == pytest.approx(0.4, abs=1e-6)


def test_without_torque_it_comes_to_rest_and_stays():
    shaft = powered()
    shaft.command(0.0, 0.6)
    moving = shaft.angle(0.1)
    shaft.hold(0.1)
    shaft.powered = False
    rest = shaft.angle(3.0)
    assert 0.01 < moving < rest < 1.2
    assert shaft.angle(10.0) == pytest.approx(rest, abs=1e-9)
