"""Probabilities add up, and what recordings cannot tell apart stands together."""

import numpy as np
import pytest

from sim2real.diagnose.effect_probabilities import EffectPosterior, posterior

SETS = (frozenset({"a", "x"}), frozenset({"b", "x"}), frozenset({"a"}), frozenset())


def drawn(searched, **more):
    return posterior(searched.tried, np.random.default_rng(0), **more)


@pytest.mark.parametrize("case", ["nothing", "rubbing", "filtered"])
def test_probabilities_add_up_to_one(case, request):
    result = drawn(request.getfixturevalue(case))
    assert result.probability.sum() == pytest.approx(1.0)
    assert (np.diff(result.probability) <= 0).all(), "likeliest first"
    assert (result.probability >= 0).all()


def test_two_filters_stand_in_one_group(filtered):
    (group,) = drawn(filtered).groups(frozenset())
    assert set(group.members) == {"command_filter", "sensor_filter"}
    assert group.probability > 0.9


def test_what_else_is_known_moves_the_odds(filtered):
    before = drawn(filtered).inclusion("sensor_filter")
    after = drawn(filtered, log_odds={"sensor_filter": 3.0}).inclusion("sensor_filter")
    never = drawn(filtered, log_odds={"sensor_filter": -50.0}).inclusion("sensor_filter")
    assert after > before > never
    assert never < 1e-6


def test_groups_are_swaps_of_one_member():
    result = EffectPosterior(SETS, np.array([0.4, 0.3, 0.2, 0.1]))
    first, second = result.groups(frozenset())
    assert (first.members, first.probability) == (("x",), pytest.approx(0.7))
    assert (second.members, second.probability) == (("a", "b"), pytest.approx(0.9))


def test_an_unlikely_rival_is_no_member():
    result = EffectPosterior(SETS, np.array([0.79, 0.01, 0.15, 0.05]))
    assert all("b" not in group.members for group in result.groups(frozenset()))
