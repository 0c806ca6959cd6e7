"""Errors on data that a fit has not seen: what is held out never touches what is fitted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import KD, KP, LATENCY, NOISE, traced

from sim2real.diagnose.baseline import baselines
from sim2real.diagnose.calibrated_odds import _add_errors
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.rival_sets import StatedSet
from sim2real.identification.held_out import folds, held_out
from sim2real.servo.batch import Batch

BASE: frozenset[str] = frozenset()


@pytest.fixture(scope="module")
def three():
    return [traced(seed, name) for seed, name in enumerate("abc")]


@pytest.fixture(scope="module")
def start(three):
    return baselines(Batch([three])).servos


def spoiled(trace, since=0.0):
    rng = np.random.default_rng(9)
    return replace(
        trace, position=trace.position + (trace.t >= since) * rng.normal(0, 0.1, trace.t.size)
    )


def test_of_a_lone_recording_the_end_is_held_out(three):
    (((fitted,), (scored,)),) = folds(three[:1])
    assert not (fitted.used & scored.used).any()
    assert fitted.t[fitted.used].max() < scored.t[scored.used].min()
    assert scored.used.mean() == pytest.approx(0.25, abs=0.01)


def test_of_several_recordings_the_end_of_each_may_be_held_out(three):
    for whole, (fitted, (scored,)) in zip(three, folds(three, ends=True), strict=True):
        rest = {one.name: one for one in fitted}
        assert scored.used.mean() == pytest.approx(0.25, abs=0.01)
        assert not (rest.pop(whole.name).used & scored.used).any()
        assert len(rest) == 2
        assert all(one.used.all() for one in rest.values())


@pytest.mark.parametrize("white", [True, False])
def test_parameters_never_see_the_recording_they_are_scored_on(three, start, white):
    other = [spoiled(three[0]), *three[1:]]
    (clean,), (dirty,) = (held_out([x], [start], white=white) for x in (three, other))
    np.testing.assert_array_equal(clean.theta[0], dirty.theta[0])
    assert np.std(dirty.residuals[0]) > 0.05, "it is scored there"
    assert np.abs(clean.theta[1:] - dirty.theta[1:]).max() > 1e-6, "the other folds do see it"


@pytest.mark.parametrize("count", [1, 3])
def test_parameters_never_see_the_end_they_are_scored_on(three, start, count):
    traces = [three[:count], [spoiled(three[0], since=9.5), *three[1:count]]]
    clean, dirty = (held_out([x], [start], ends=[True])[0] for x in traces)
    np.testing.assert_array_equal(clean.theta[0], dirty.theta[0])
    assert len(clean.theta) == count
    assert dirty.rmse > 10 * clean.rmse


def test_the_right_servo_leaves_noise(three, start):
    (found,) = held_out([three], [start])
    assert found.rmse == pytest.approx(NOISE, rel=0.05)
    np.testing.assert_allclose(found.theta[:, :3], np.tile([KP, KD, LATENCY], (3, 1)), rtol=0.03)
    assert [x.size for x in found.residuals] == [x.used.sum() for x in three]


def test_nothing_to_hold_out(three, start):
    """The command moves at the very end only."""
    trace = three[0]
    late = trace.t >= 11.0
    lone = replace(trace, command=0.3 * late, position=np.where(late, 0.3, 0.0))
    assert held_out([[lone]], [start]) == [None]


@pytest.mark.parametrize("designed", [False, True])
def test_of_a_recording_that_was_designed_only_the_end_is_held_out(three, start, designed):
    stated = [StatedSet(frozenset({"deadband"}), start.theta[0])] if designed else []
    joint = JointCase("j1", three, NOISE, None, stated=stated)
    plain = SimpleNamespace(fit=SimpleNamespace(servos=start))
    finding = SimpleNamespace(tried=SimpleNamespace(base=BASE, tried={BASE: plain}))
    errors = [{}]
    _add_errors(errors, [joint], [finding], [[BASE]], "cpu")
    share = np.mean([x.size for x in errors[0][BASE].residuals]) / three[0].t.size
    assert share == pytest.approx(0.25 if designed else 1.0, abs=0.01)


def test_missing_samples_are_not_scored(three, start):
    used = np.arange(three[0].t.size) % 10 != 0
    gappy = replace(three[0], used=used, position=np.where(used, three[0].position, np.nan))
    (found,) = held_out([[gappy, *three[1:]]], [start])
    assert found.residuals[0].size == used.sum()
    assert np.isfinite(found.rmse)
