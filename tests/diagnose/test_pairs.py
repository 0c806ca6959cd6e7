"""Two effects of one family are named together where recordings can tell them apart."""

import numpy as np
import pytest
from simulated import LATENCY, recording, robot, row, traced

from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.exchangeable import distinctness, exchangeable_ends, partner
from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.missing.servo_search import ServoSearch, ledgers_of
from sim2real.servo.batch import Batch

FILTERS = ("command_filter", "sensor_filter")


def filtered(command_s, sensor_s):
    sizes = zip(FILTERS, (command_s, sensor_s), strict=True)
    return {name: {"time_constant_s": size} for name, size in sizes if size}


@pytest.mark.parametrize(("command_s", "sensor_s"), [(0.03, 0.06), (0.05, 0.05)])
def test_filters_before_and_behind_are_named_together(command_s, sensor_s):
    """Compliance alone is likelier than either filter alone."""
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
    assert exchangeable_ends(*sizes[::-1], 20.0) == pytest.approx((low, high))


@pytest.mark.parametrize("size", [0.0, 0.04])
def test_a_second_filter_is_distinct_where_there_is_one(size):
    batch = Batch([[traced(1, "a", **filtered(0.04, size))]])
    (tried,) = ledgers_of(baselines(batch))
    problem = ServoSearch(batch, 0.01, np.random.default_rng(0))
    start = row(**filtered(0.04, 0.04))
    sets = [frozenset(FILTERS), *(frozenset({name}) for name in FILTERS)]
    for hypothesis in problem.refit([(tried, members, start) for members in sets]):
        tried.keep(hypothesis)
    found = distinctness(tried, tried.tried[sets[0]], *FILTERS)
    assert found > 10 if size else found < 3
