"""Expected precision: against derivatives of another integrator, and against the spread of fits."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated import robot

from sim2real.design.information import Information, ServoPrior, prior_of
from sim2real.design.limits import limits_of
from sim2real.design.search import draw
from sim2real.identification.joint_fit import refitted
from sim2real.identification.problem import plain_row
from sim2real.model import JointModel, Model
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import Trace

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "servo"))
import integrator  # noqa: E402

LOAD, GAINS = Load(0.002), (2.2, 0.06, 0.05)
ROBOT = robot("j1", servo=Servo("s", 1.67, 5.24, 0.00153), limits=(-0.8, 0.8))
LIMITS = limits_of(ROBOT)


def plain(noise=1e-3, load=LOAD, lost=0.0025):
    """A prior of one linear servo."""
    row = plain_row(*GAINS)
    row[3:5] = load.inertia_kgm2, load.gravity_Nm
    names = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
    return ServoPrior(names, row[None], np.full(3, np.inf), load, noise, 0.0, lost)


@pytest.fixture(scope="module")
def commands():
    return draw(np.random.default_rng(0), 4, LIMITS, 6.0)


@pytest.mark.parametrize("load", [LOAD, Load(0.004, 0.4, 0.1)])
def test_derivatives_are_those_of_another_integrator(commands, load):
    information = Information(plain(load=load), LIMITS)
    _, slopes = information.sensitivities(commands[:2])
    t = LIMITS.times(6.0)
    for command, found in zip(commands[:2], slopes[:, 0], strict=True):
        exact = GAINS * integrator.slopes(GAINS, load, t, command)
        assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()


def test_expected_widths_are_those_of_fits(commands):
    noise, t = 2e-3, LIMITS.times(6.0)
    information = Information(plain(noise, lost=0.0), LIMITS)
    sd = information.precision(commands[:1])[0][0, 0] / 1.645
    row, rng, used = information.prior.rows[0], np.random.default_rng(3), np.ones(t.size, bool)
    clean = rollout(row[None], t, commands[0])[0]
    fits = []
    for _ in range(40):
        measured = clean + noise * rng.normal(size=t.size)
        trace = Trace("a", "a", t, commands[0], measured, LOAD, used)
        fits.append(refitted([trace], row).values / GAINS)
    spread = np.std(fits, axis=0)
    assert np.abs(np.mean(fits, axis=0) - 1).max() < 1e-2
    np.testing.assert_allclose(spread, sd, rtol=0.35)  # 40 fits: 11 %, one standard deviation


def test_lost_set_points_cost_commands_that_change_all_the_time_most(commands):
    def ratio(command):
        safe, lossy = (
            Information(plain(lost=lost), LIMITS).precision(command[None])[0]
            for lost in (0.0, 0.02)
        )
        return (lossy / safe).max()

    steps = LIMITS.within(0.5 * (np.arange(300)[None] // 75 % 2))[0]
    assert ratio(commands[0]) > 1.2 * ratio(steps) > 1.2


def test_torque_beyond_the_budget_is_penalised():
    shake = 0.8 * np.sign(np.sin(2 * np.pi * 3 * LIMITS.times(6.0)))[None]
    prior = plain(load=Load(0.02))
    free = Information(prior, replace(LIMITS, rms_torque_Nm=np.inf))
    rms = free.precision(shake)[1][0, 0]
    strict = Information(prior, replace(LIMITS, rms_torque_Nm=rms / 2))
    assert free(shake)[0] - strict(shake)[0] == pytest.approx(10 * (2 - 1), rel=0.1)


def test_a_model_is_believed_within_its_intervals():
    interval = {
        "kp_Nm_per_rad": (2.0, 2.4), "kd_Nms_per_rad": (0.05, 0.07), "latency_s": (0.04, 0.06)
    }  # fmt: skip
    correlation = {"kp_Nm_per_rad, kd_Nms_per_rad": 0.9}
    joint = JointModel(*GAINS, 0.002, load=LOAD, interval=interval, correlation=correlation)
    prior = prior_of(ROBOT, Model({"j1": joint}), LIMITS, draws=400)
    logs = np.log(prior.rows[1:, :3])
    expected = np.array([0.2 / 2.2, 0.01 / 0.06, 0.01 / 0.05]) / 1.645
    np.testing.assert_allclose(logs.std(axis=0), expected, rtol=0.15)
    assert np.corrcoef(logs.T)[0, 1] == pytest.approx(0.9, abs=0.05)
    assert prior.load == LOAD
