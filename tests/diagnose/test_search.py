"""The search names what is there, nothing where nothing is, and never one mechanism twice."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from searching import searched
from simulated import INERTIA, KD, KP, LATENCY, NOISE, PERIOD, column, traced
from strange import position_damping, strange

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.effect_search import search_again
from sim2real.diagnose.investigate import investigate
from sim2real.diagnose.screening import FITTED, Screen, _scores, candidate, screen
from sim2real.diagnose.servo_search import baselines, plain_sets
from sim2real.effects import named
from sim2real.identification.servo_problem import residual_angles
from sim2real.inference.selection import Breadth
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.batch import Batch
from sim2real.servo.trace import trace


def test_what_a_search_has_missed_is_found_again(rubbing):
    ledger = replace(rubbing.tried, tried={frozenset(): rubbing.tried.plain})
    search_again(rubbing.search, [ledger])
    assert ledger.best.members == {"coulomb_friction"}
    assert not rubbing.search.fixed


def test_nothing_is_found_where_nothing_is_missing(nothing):
    assert nothing.tried.best.members == frozenset()
    assert not nothing.search.remains(nothing.tried, frozenset())


@pytest.mark.parametrize("case", ["nothing", "rubbing", "filtered"])
def test_no_set_has_two_effects_that_exclude_each_other(case, request):
    for effects in request.getfixturevalue(case).tried.tried:
        pairs = itertools.combinations(map(named, effects), 2)
        assert not any(one.excludes(other) for one, other in pairs)
        assert len(effects) <= Breadth().most


def test_every_effect_that_would_show_is_tried_where_something_is_missing(rubbing):
    """Those that a linear look gives no gain, too: the plain servo's gains may have hidden them."""
    seen, given = rubbing.seen
    shows = seen.visible > rubbing.search.least_visible
    expected = {given[k].effect.name for k in np.unique(seen.candidate[shows])}
    hidden = {
        name
        for k, name in enumerate(option.effect.name for option in given)
        if seen.gain[seen.candidate == k].max() <= rubbing.search.hopeless_gain
    }
    expected -= {effect.name for effect in FITTED if effect.everywhere}
    assert expected & hidden, "the plain servo hides some"
    assert {frozenset({name}) for name in expected} <= set(rubbing.tried.tried)


def test_a_model_that_is_given_is_a_start_as_well():
    batch = Batch([[traced(1, "a")]])
    rubbing = FittedEffect("coulomb_friction", {"torque_Nm": 0.02})
    model = JointModel(KP, KD, LATENCY, 0.002, effects=(rubbing,))
    fit = baselines(batch, [model])
    assert fit.servos.theta[0, column("coulomb_friction.torque_Nm")] == 0.02
    nobody = baselines(batch, [None])
    np.testing.assert_allclose(nobody.servos.theta[0, :3], [KP, KD, LATENCY], rtol=0.03)


@pytest.mark.parametrize("effect", FITTED, ids=lambda effect: effect.name)
def test_candidates_start_within_their_bounds(effect):
    for kp, inertia in ((2.2, 0.002), (60.0, 1.0), (4e4, 1.0)):
        given = candidate(effect, kp, inertia)
        assert given.starts.shape[1] == len(effect.parameters)
        assert (given.starts >= given.low).all()
        assert (given.starts <= given.high).all()
        assert given.starts.any(axis=1).all(), "no start is without the effect"
        assert (given.unit > 0).all()


def test_the_plain_servo_does_not_ring_faster_than_samples_can_tell():
    lagging = {"command_filter": {"time_constant_s": 0.03}}
    batch = Batch([[traced(1, "a", **lagging), traced(2, "b", **lagging)]])
    kp = baselines(batch).servos.theta[0, 0]
    assert np.sqrt(kp / INERTIA) < np.pi / PERIOD


def test_a_search_out_of_budget_tries_no_combinations_and_says_so(monkeypatch):
    two = {"coulomb_friction": {"torque_Nm": 0.05}, "command_filter": {"time_constant_s": 0.06}}
    given = [traced(1, "a", seconds=6.0, **two), traced(2, "b", seconds=6.0, **two)]

    def tried(most):
        monkeypatch.setattr(DECISION, "search_substeps", most)
        found = searched(traces=given)
        return found.tried, found.search.unfinished, found.batch.substeps[0]

    short, ended, spent = tried(1.0)
    assert ended == {0} and max(map(len, short.tried)) == 1
    whole, ended, more = tried(100 * spent)
    assert ended == set() and more > spent
    assert "coulomb_friction" in whole.best.members and len(whole.best.members) > 1


def test_a_joint_that_is_looked_at_again_keeps_its_place():
    """The second look is at some joints only, which are numbered anew there."""
    clean = [traced(k, f"c{k}", seconds=8.0) for k in (1, 2)]
    odd = [trace(strange(k, f"s{k}", position_damping, seconds=8.0), "j1") for k in (3, 4)]
    batch = Batch([clean, odd])
    rng = np.random.default_rng(0)
    joints = [JointCase("clean", clean, NOISE, None), JointCase("odd", odd, NOISE, None)]
    _, found = investigate(batch, joints, plain_sets(baselines(batch)), rng=rng)
    assert found[0].excess < DECISION.structured_excess < found[1].excess
    for finding, noise in zip(found, (NOISE, 3 * NOISE), strict=True):
        left = residual_angles(batch, finding.tried.plain.fit)
        assert np.sqrt(np.mean(left**2)) == pytest.approx(noise, rel=0.7)


BLOCK_COUNT, STARTS, COUNT = 40, 30, 1e6


def of_noise(rng):
    """A screen of white noise by starts that overlap, as those of one effect do."""
    own, shared = rng.standard_normal((2, BLOCK_COUNT, STARTS)), 0.8
    pieces = np.sqrt(1 - shared) * own[0] + np.sqrt(shared) * own[1, :, :1]
    blocks = pieces / np.sqrt(BLOCK_COUNT)
    index = np.arange(STARTS)
    return Screen(index, index, blocks.sum(axis=0), blocks, np.ones(STARTS), COUNT)


@pytest.mark.parametrize("level", [0.05, 0.2])
def test_the_threshold_keeps_its_level_on_white_noise(level):
    rng = np.random.default_rng(0)
    screens = [of_noise(rng) for _ in range(400)]
    alarms = np.mean([s.gain.max() > s.threshold(level, rng, draws=199) for s in screens])
    assert 0.4 * level < alarms < 1.4 * level


def test_gain_counts_positive_scores_only():
    result = of_noise(np.random.default_rng(0))
    assert (result.gain[result.score <= 0] == 0).all()
    positive = result.score > 0
    np.testing.assert_allclose(result.gain[positive], 0.5 * result.score[positive] ** 2, rtol=1e-4)


def test_an_effect_of_a_start_s_strength_scores_what_is_visible_of_it():
    weak = {"coulomb_friction": {"torque_Nm": 0.004}}
    batch = Batch([[traced(seed, str(seed), **weak)] for seed in range(6)])
    plain = baselines(batch)
    option = candidate(named("coulomb_friction"), 2.2, 0.002)
    option.starts[:] = 0.004
    scores = screen(batch, plain, [[option]] * 6)
    expected = np.mean([s.visible[0] for s in scores])
    assert expected > 5
    assert np.mean([s.score[0] for s in scores]) == pytest.approx(expected, abs=4 / np.sqrt(6))


def test_an_effect_whose_simulation_diverges_scores_nothing():
    rng = np.random.default_rng(3)
    differences = rng.normal(size=(50, 6))  # residual, two free parameters, three starts
    differences[:, 5] = 1e200
    with np.errstate(over="ignore"):
        gram = (differences.T @ differences)[None]
    score, _, seen = _scores(gram, np.diag(gram[0])[3:], 50.0, 3, np.s_[3:6])
    assert score[2] == seen[2] == 0.0
    assert np.all(seen[:2] > 0)
