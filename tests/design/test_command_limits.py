"""Commands within the limits of a joint, and limits that contradict each other."""

import numpy as np
import pytest
from violations import violations

from sim2real.design.limits import holding, limits_of
from sim2real.design.search import FAMILIES, draw
from sim2real.errors import InputError
from sim2real.recording import Load
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.signals import limited


def robot(speed=5.24, limits=(-0.8, 0.8), step=0.00419, torque=1.67):
    link = Link("link")
    return Robot("bench", (link, link), (Joint("j1", Servo("s", torque, speed, step), limits),))


@pytest.mark.parametrize("limits", [(-0.8, 0.8), (0.1, 0.9), (-0.3, 1.2)])
def test_any_signal_is_brought_within_the_limits_and_then_left_alone(limits):
    bounds = limits_of(robot(limits=limits))
    wild = 3 * np.random.default_rng(0).normal(size=(6, 400))
    commands = bounds.within(wild)
    assert any(violations(wild, bounds))
    assert violations(commands, bounds) == [[]] * 6
    np.testing.assert_array_equal(bounds.within(commands), commands)


def test_the_recorder_plays_the_commands_unchanged():
    bench = robot()
    commands = draw(np.random.default_rng(1), 12, limits_of(bench), 8.0)
    for command in commands:
        np.testing.assert_array_equal(limited(command, bench.joints[0], 50.0), command)


def test_random_commands_are_within_the_limits_and_differ():
    bounds = limits_of(robot(limits=(-0.2, 0.9)))
    commands = draw(np.random.default_rng(2), 4 * len(FAMILIES), bounds, 10.0)
    assert violations(commands, bounds) == [[]] * len(commands)
    assert np.linalg.matrix_rank(commands - bounds.rest_rad) == len(commands)
    assert (np.ptp(commands, axis=1) > 0.2 * np.ptp(bounds.position_rad)).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_families_stay_below_the_highest_frequency(family):
    t = np.arange(1500) * 0.02
    power = np.zeros(751)
    for seed in range(8):
        wave = family(np.random.default_rng(seed), t, 4.0)
        power += np.abs(np.fft.rfft(wave - wave.mean())) ** 2 / np.sum(wave**2)
    frequency = np.fft.rfftfreq(t.size, 0.02)
    assert power[frequency > 4.2].sum() < 0.35 * power.sum()  # edges of steps have more


def test_a_heavy_load_narrows_the_range_to_where_the_servo_can_hold_it():
    bench = robot(limits=(-0.8, 0.2))
    limits, heavy = limits_of(bench), Load(0.05, 1.0, 0.2)
    assert holding(limits, Load(0.05, 0.5, 0.1), bench) is limits
    low, high = holding(limits, heavy, bench).position_rad
    assert high == 0.2
    assert heavy.gravity_Nm * np.sin(-low) == pytest.approx(limits.rms_torque_Nm)


def test_a_load_that_the_servo_cannot_hold():
    bench = robot(limits=(0.6, 0.9))
    with pytest.raises(InputError, match=r"max_torque_Nm: found 1.11 N m or more to hold the load"):
        holding(limits_of(bench), Load(0.05, 1.0, 0.2), bench)
