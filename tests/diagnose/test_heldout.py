"""Errors on data that a fit has not seen: what is held out never touches what is fitted."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import KD, KP, LATENCY, NOISE, traced

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.open_sets import detection_limits
from sim2real.diagnose.screening import Screen, candidate, screen
from sim2real.diagnose.servo_search import baselines
from sim2real.effects import named
from sim2real.identification.held_out import FOLDS, Unseen, folds, held_out
from sim2real.servo.batch import Batch


@pytest.fixture(scope="module")
def three():
    return [traced(seed, name) for seed, name in enumerate("abc")]


@pytest.fixture(scope="module")
def start(three):
    return baselines(Batch([three])).servos


def spoiled(trace, where):
    rng = np.random.default_rng(9)
    return replace(trace, position=trace.position + where * rng.normal(0, 0.1, trace.t.size))


@pytest.mark.parametrize("count", [1, 3])
def test_each_fold_scores_segments_that_it_does_not_fit(three, count):
    pairs = folds(three[:count])
    assert len(pairs) == FOLDS
    for fitted, scored in pairs:
        for whole, one, other in zip(three, fitted, scored, strict=False):
            assert not (one.used & other.used).any()
            np.testing.assert_array_equal(one.used | other.used, whole.used)
            assert other.used.mean() == pytest.approx(1 / FOLDS, abs=0.01)
    np.testing.assert_array_equal(
        sum(scored[0].used.astype(int) for _, scored in pairs), three[0].used
    )


def test_a_recording_is_scored_by_fits_to_the_others(three, start):
    other = [*three[:2], spoiled(three[2], 1.0)]
    (clean,), (dirty,) = (held_out([x], [start], whole=True) for x in (three, other))
    np.testing.assert_array_equal(clean.theta[2], dirty.theta[2])
    assert [x.size for x in dirty.residuals] == [int(t.used.sum()) for t in three]
    assert np.std(dirty.residuals[2]) > 0.05 > np.std(dirty.residuals[0])


@pytest.mark.parametrize("count", [1, 3])
def test_parameters_never_see_what_they_are_scored_on(three, start, count):
    _, scored = folds(three[:count])[0]
    other = [spoiled(t, part.used) for t, part in zip(three, scored, strict=False)]
    (clean,), (dirty,) = (held_out([x], [start]) for x in (three[:count], other))
    np.testing.assert_array_equal(clean.theta[0], dirty.theta[0])
    assert np.std(dirty.residuals[0]) > 0.05, "it is scored there"
    assert np.abs(clean.theta[1:] - dirty.theta[1:]).max() > 1e-6, "the other folds do see it"


@pytest.mark.parametrize(
    "sizes, clearly", [((0.9, 0.8, 0.9), True), ((0.96, 0.97, 0.96), False), ((0.5, 1, 1), False)]
)
def test_a_servo_is_clearly_better_by_more_than_a_little_in_most_folds(sizes, clearly):
    usual, other = (
        Unseen(tuple(np.full(9, float(x)) for x in some), np.zeros(3))
        for some in ((1, 1, 1), sizes)
    )
    assert other.rmse < usual.rmse
    assert other.clearly_better(usual, 0.05) == clearly
    assert not usual.clearly_better(other, 0.05)


def test_the_right_servo_leaves_noise(three, start):
    (found,) = held_out([three], [start])
    assert found.rmse == pytest.approx(NOISE, rel=0.05)
    truth = np.tile([KP, KD, LATENCY], (FOLDS, 1))
    np.testing.assert_allclose(found.theta[:, :3], truth, rtol=0.03)
    assert sum(x.size for x in found.residuals) == sum(x.used.sum() for x in three)


def test_nothing_to_hold_out(three, start):
    """The command moves at the very end only."""
    trace = three[0]
    late = trace.t >= 11.9
    lone = replace(trace, command=0.3 * late, position=0.0 * late)
    assert held_out([[lone]], [start]) == [None]


def test_errors_are_relative_to_the_noise_of_each_reading(three, start):
    spread = np.where(three[0].t > 6, 10.0, 1.0)
    rng = np.random.default_rng(4)
    noisy = [
        replace(
            t, spread=spread, position=t.position + (spread - 1) * rng.normal(0, NOISE, spread.size)
        )
        for t in three
    ]
    (found,) = held_out([noisy], [start])
    assert found.rmse > 5 * NOISE
    assert found.error == pytest.approx(NOISE, rel=0.1)


def test_missing_samples_are_not_scored(three, start):
    used = np.arange(three[0].t.size) % 10 != 0
    gappy = replace(three[0], used=used, position=np.where(used, three[0].position, np.nan))
    (found,) = held_out([[gappy, *three[1:]]], [start])
    assert sum(x.size for x in found.residuals) == used.sum() + sum(t.used.sum() for t in three[1:])
    assert np.isfinite(found.rmse)


NEEDED = np.sqrt(2 * DECISION.detection_gain) + 1.28
EFFECTS = ("coulomb_friction", "sensor_gain", "backlash")


def limits_of(traces):
    batch = Batch([traces])
    given = [candidate(named(name), 2.2, 0.002) for name in EFFECTS]
    (seen,) = screen(batch, baselines(batch), [given])
    found = detection_limits(seen, given, "j1")
    return {limit.effect: next(iter(limit.smallest.values())) for limit in found}


@pytest.fixture(scope="module")
def usual():
    return limits_of([traced(1, "a"), traced(2, "b")])


def test_twice_the_noise_hides_twice_as_much(usual):
    noisy = limits_of([traced(1, "a", noise=2 * NOISE), traced(2, "b", noise=2 * NOISE)])
    for name in EFFECTS:
        assert noisy[name] == pytest.approx(2 * usual[name], rel=0.25)


def noticed(ratio, usual):
    """Of six robots with dry friction of so many limits, those on which it is noticed."""
    size = ratio * usual["coulomb_friction"]
    option = candidate(named("coulomb_friction"), 2.2, 0.002)
    traces = [
        [traced(10 * k + r, str(r), coulomb_friction={"torque_Nm": size}) for r in (1, 2)]
        for k in range(6)
    ]
    batch = Batch(traces)
    return sum(
        s.gain.max() > DECISION.detection_gain
        for s in screen(batch, baselines(batch), [[option]] * 6)
    )


def test_an_effect_well_above_its_limit_is_seen(usual):
    assert noticed(10.0, usual) >= 5


def made_up(strengths, visible):
    """A screen of one candidate whose starts are these strengths."""
    option = candidate(named("coulomb_friction"), 2.2, 0.002)
    object.__setattr__(option, "starts", np.asarray(strengths, dtype=float)[:, None])
    size = len(strengths)
    zero = np.zeros(size, dtype=int)
    seen = Screen(
        zero, np.arange(size), np.zeros(size), np.zeros((1, size)), np.asarray(visible), 1e3
    )
    ((_, value),) = detection_limits(seen, [option], "j1")[0].smallest.items()
    return value


@pytest.mark.parametrize(
    ("truth", "power"),
    [(0.012, 1), (0.03, 1), (0.1, 1), (0.012, 2), (0.03, 2), (0.1, 2), (0.005, 1), (0.05, -1)],
)
def test_between_strengths_it_is_interpolated_and_below_in_proportion(truth, power):
    """A score that falls with the strength is that of a limit."""
    strengths = np.array([0.01, 0.04, 0.16])
    assert made_up(strengths, NEEDED * (strengths / truth) ** power) == pytest.approx(truth)
    assert made_up(strengths, [0.1, 0.1, 0.9 * NEEDED]) is None, "no strength shows"
