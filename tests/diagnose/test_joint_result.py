"""A joint's results: coarse sensors, gaps, filters that may exchange parameters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import LATENCY, column, recording, robot, row, traced

from sim2real.diagnose.case import coarse_step
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.joint_result import distinctness, exchangeable_ends, law_error, partner
from sim2real.diagnose.result import Estimate
from sim2real.diagnose.servo_search import ServoSearch, baselines, plain_sets
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS

FILTERS = ("command_filter", "sensor_filter")
STATED = 0.00419


def rounded(step, seeds=(1, 2)):
    traces = [traced(seed, str(seed)) for seed in seeds]
    return [replace(x, position=step * np.round(x.position / step)) for x in traces]


@pytest.mark.parametrize(
    ("step", "coarse"), [(0.0087, True), (0.03, True), (0.0005, False), (STATED, False)]
)
def test_only_a_step_above_the_stated_one_is_a_finding(step, coarse):
    expected = pytest.approx(step, rel=1e-3) if coarse else None
    assert coarse_step(rounded(step), STATED) == expected


def test_all_recordings_must_have_the_step_and_missing_samples_do_not_hide_it():
    one, other = rounded(0.0123)[0], rounded(0.03)[1]
    assert coarse_step([one, other], STATED) is None
    assert coarse_step([one, traced(2)], STATED) is None
    used = np.arange(one.t.size) % 7 != 0
    assert coarse_step([replace(one, used=used)], STATED) == pytest.approx(0.0123, rel=1e-3)


@pytest.mark.parametrize(
    ("effects", "output_friction_Nm", "rattles"),
    [
        (("backlash", "coulomb_friction"), 0.0, True),
        (("backlash",), 0.0, False),
        (("backlash", "coulomb_friction"), 0.02, False),
    ],
)
def test_a_gap_is_less_certain_where_friction_holds_the_motor_alone(
    effects, output_friction_Nm, rattles
):
    theta = np.zeros((1, len(COLUMNS)))
    theta[0, column("backlash.output_friction_Nm")] = output_friction_Nm
    fit = SimpleNamespace(servos=SimpleNamespace(theta=theta))
    servo = SimpleNamespace(members=frozenset(effects), fit=fit)
    expected = DECISION.rattling_law_error if rattles else DECISION.law_error
    assert law_error(servo, "backlash") == expected
    assert law_error(servo, "coulomb_friction") == DECISION.law_error
    assert DECISION.rattling_law_error > DECISION.law_error


def filtered(command_s, sensor_s):
    sizes = zip(FILTERS, (command_s, sensor_s), strict=True)
    return {name: {"time_constant_s": size} for name, size in sizes if size}


@pytest.mark.parametrize(("command_s", "sensor_s"), [(0.03, 0.06), (0.05, 0.05)])
def test_filters_before_and_behind_are_named_together(command_s, sensor_s):
    """Compliance alone is more probable than either filter alone."""
    sizes = filtered(command_s, sensor_s)
    given = [recording(k, name, **sizes) for k, name in ((1, "a"), (2, "b"))]
    found = diagnose(given, robot("j1"))
    assert found.verdict == "explained"
    assert {effect.group for effect in found.effects} == {(name,) for name in FILTERS}
    for effect in found.effects:
        estimate = effect.parameters["time_constant_s"]
        for size in (command_s, sensor_s):  # exchanged, a linear servo responds the same
            assert estimate.q05 < size < estimate.q95 < 2 * 0.06
    offered = found.model.joints["j1"]
    assert {effect.effect for effect in offered.effects} == set(FILTERS)
    assert offered.latency_s == pytest.approx(LATENCY, rel=0.03)


def test_filters_can_exchange_their_parameters_and_other_effects_cannot():
    both = frozenset({*FILTERS, "coulomb_friction", "presliding_friction"})
    assert partner(both, "command_filter") == "sensor_filter"
    assert partner(both, "sensor_filter") == "command_filter"
    assert partner(both, "coulomb_friction") is None, "other parameters"
    assert partner(frozenset({"command_filter", "coulomb_friction"}), "command_filter") is None


@pytest.mark.parametrize("sizes", [(0.05, 0.05), (0.03, 0.06), (0.06, 0.03)])
def test_ends_of_exchangeable_parameters(sizes):
    low, high = exchangeable_ends(*sizes, 20.0)
    assert 0 < low < min(sizes) <= max(sizes) < high
    assert low + high == pytest.approx(sum(sizes))
    narrow = exchangeable_ends(*sizes, 1e9)
    np.testing.assert_allclose(narrow, [min(sizes), max(sizes)], rtol=1e-3)
    np.testing.assert_allclose(exchangeable_ends(*sizes, 0.0), [0.0, sum(sizes)])


@pytest.mark.parametrize("size", [0.0, 0.04])
def test_a_second_filter_is_distinct_where_there_is_one(size):
    batch = Batch([[traced(1, "a", **filtered(0.04, size))]])
    (tried,) = plain_sets(baselines(batch))
    problem = ServoSearch(batch, [], 0.01, np.random.default_rng(0))
    start = row(**filtered(0.04, 0.04))
    sets = [frozenset(FILTERS), *(frozenset({name}) for name in FILTERS)]
    problem.try_all([(tried, members, start) for members in sets])
    found = distinctness(tried, tried.tried[sets[0]], *FILTERS)
    assert found > 10 if size else found < 3


def test_intervals_of_another_probability_keep_their_sides():
    wider = Estimate(1.0, 0.4, 0.2, 1.5).widened(2.0)
    assert (wider.q05, wider.q95) == (0.0, 2.0)
    narrower = Estimate(-1.0, 0.4, -1.5, -0.2).widened(0.5)
    assert (narrower.q05, narrower.q95) == (-1.25, -0.6)
