"""The search finds commands that tell more than the usual ones, within the limits."""

import numpy as np
import pytest
from violations import violations

from sim2real.design.information import Information, prior_of
from sim2real.design.limits import limits_of
from sim2real.design.plan import design
from sim2real.design.search import best, draw
from sim2real.recording import Load
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.signals import UNIT, excitation

_LINK = Link("link")
ROBOT = Robot("b", (_LINK, _LINK), (Joint("j1", Servo("s", 1.67, 5.24, 0.00153), (-0.8, 0.8)),))
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
    width = information.precision(np.array([found.command, *(u[:, 0] for u in usual)])).half_width
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
