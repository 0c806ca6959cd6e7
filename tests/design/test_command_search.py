"""Commands that tell more than the usual ones, within the limits of a joint."""

import numpy as np
import pytest
from simulated import robot
from violations import violations

from sim2real.design.information import Information, prior_of
from sim2real.design.limits import holding, limits_of
from sim2real.design.plan import design
from sim2real.design.search import FAMILIES, best, draw
from sim2real.errors import InputError
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.signals import UNIT, excitation

ROBOT = robot("j1", servo=Servo("s", 1.67, 5.24, 0.00153), limits=(-0.8, 0.8))
LIMITS = limits_of(ROBOT)
LIGHT = Load(0.002)
SMALL = {"drawn": 32, "rounds": 10}


def test_a_design_is_expected_to_tell_twice_as_much_as_any_usual_signal():
    information = Information(prior_of(ROBOT, None, LIMITS, load=Load(0.002), draws=3), LIMITS)
    usual = [
        excitation(name, ROBOT.joints, seconds=8, rate_hz=50, rng=np.random.default_rng(0)).command
        for name in UNIT
    ]
    found = best(information, LIMITS, 8.0, rng=np.random.default_rng(1), **SMALL)
    assert violations(found.command[None], LIMITS) == [[]]
    assert found.score == information(found.command[None])[0]
    width, _ = information.precision(np.array([found.command, *(u[:, 0] for u in usual)]))
    widest = width[:, :, :3].max(axis=2).mean(axis=1)
    assert widest[0] < 0.5 * widest[1:].min()


def test_any_objective_can_be_searched():
    def reversals(commands):
        return np.abs(np.diff(commands, 2, axis=1)).sum(axis=1)

    found = best(reversals, LIMITS, 6.0, rng=np.random.default_rng(2), **SMALL)
    assert found.score > reversals(draw(np.random.default_rng(2), 32, LIMITS, 6.0)).max()
    assert violations(found.command[None], LIMITS) == [[]]


@pytest.fixture(scope="module")
def plan():
    return planned()


def planned(load=LIGHT):
    return design(ROBOT, seconds=6.0, loads={"j1": load}, seed=4, drawn=12, rounds=1)


def test_a_plan_states_what_it_promises(plan):
    content = plan.recording().metadata["design"]["j1"]
    joint = plan.joints["j1"]
    assert content["expected"]["kp_Nm_per_rad"]["relative_half_width"] == joint.expected[
        "kp_Nm_per_rad"
    ]  # fmt: skip
    widths = joint.over_time(6)
    np.testing.assert_allclose(widths[-1], list(joint.expected.values()), rtol=0.05)
    assert (np.diff(widths[:, 2]) < 0.02 * widths[:-1, 2]).all()
    assert "kp" in str(plan)
    assert "latency" in plan._repr_html_() and plan.plot().axes


def test_a_heavy_pendulum_is_moved_where_it_can_be_held(plan):
    heavy = Load(0.042, 1.0, 0.2)
    narrow = planned(heavy)
    reached = np.abs(narrow.joints["j1"].found.command).max()
    assert reached > 0.1 and heavy.gravity_Nm * np.sin(reached) <= LIMITS.rms_torque_Nm
    assert "where its servo can hold the load" in str(narrow)
    assert "hold" not in str(plan)


@pytest.mark.parametrize("limits", [(-0.8, 0.8), (0.1, 0.9), (-0.3, 1.2)])
def test_any_signal_is_brought_within_the_limits_and_then_left_alone(limits):
    bounds = limits_of(robot("j1", limits=limits))
    wild = 3 * np.random.default_rng(0).normal(size=(6, 400))
    commands = bounds.within(wild)
    assert any(violations(wild, bounds))
    assert violations(commands, bounds) == [[]] * 6
    np.testing.assert_array_equal(bounds.within(commands), commands)


def test_random_commands_are_within_the_limits_and_differ():
    bounds = limits_of(robot("j1", limits=(-0.2, 0.9)))
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
    bench = robot("j1", limits=(-0.8, 0.2))
    limits, heavy = limits_of(bench), Load(0.05, 1.0, 0.2)
    assert holding(limits, Load(0.05, 0.5, 0.1), bench) is limits
    low, high = holding(limits, heavy, bench).position_rad
    assert high == 0.2
    assert heavy.gravity_Nm * np.sin(-low) == pytest.approx(limits.rms_torque_Nm)


def test_a_load_that_the_servo_cannot_hold():
    bench = robot("j1", limits=(0.6, 0.9))
    with pytest.raises(InputError, match=r"max_torque_Nm: found 1.11 N m or more to hold the load"):
        holding(limits_of(bench), Load(0.05, 1.0, 0.2), bench)
