"""Effects that mean nothing: where nothing is missing they do as well as real ones, else not."""

import numpy as np
import pytest
from simulated import traced

from sim2real.inference.knockoffs import contest, false_discovery_rate, meaningless
from sim2real.residuals.knockoffs import directions
from sim2real.residuals.plain import baselines
from sim2real.residuals.screen import FITTED, candidate
from sim2real.servo.batch import Batch

T = 0.02 * np.arange(1500)


def competed(searched):
    given = [c for c in searched.seen[1] if not c.effect.everywhere]
    fit = searched.tried.plain.fit
    moved = directions(searched.traces, fit.servos, given)
    rng = np.random.default_rng(0)
    return contest(moved, fit.autoregression[0], rng), given


def rate_of_the_best(searched):
    result, given = competed(searched)
    best = int(result.real.argmax())
    return false_discovery_rate([result.chance([best])], len(given))


def test_where_nothing_is_missing_the_best_effect_is_a_false_one(nothing):
    assert rate_of_the_best(nothing) > 0.5


def test_an_effect_that_is_there_beats_every_knockoff(rubbing, filtered):
    assert rate_of_the_best(rubbing) < 0.02
    assert rate_of_the_best(filtered) < 0.02


def test_the_terms_are_those_of_the_screen(rubbing):
    result, given = competed(rubbing)
    seen, options = rubbing.seen
    names = [c.effect.name for c in options]
    for k, option in enumerate(given):
        mine = seen.candidate == names.index(option.effect.name)
        assert result.real[k] == pytest.approx(seen.gain[mine].max(), rel=0.02, abs=0.1)


def test_of_real_effects_that_are_not_there_no_more_win_than_of_knockoffs():
    joints = [[traced(10 * k, "a"), traced(10 * k + 1, "b")] for k in range(10)]
    batch = Batch(joints)
    fits = baselines(batch)
    given = [candidate(e, 2.2, 0.002) for e in FITTED if not e.everywhere]
    rng = np.random.default_rng(0)
    ahead = []
    for k, traces in enumerate(joints):
        fit = fits[np.array([k])]
        moved = directions(traces, fit.servos, given)
        result = contest(moved, fit.autoregression[0], rng, copies=30)
        ahead.append(np.mean(result.real > np.quantile(result.knockoffs, 0.8)))
    assert 0.1 < np.mean(ahead) < 0.3


def test_knockoffs_keep_size_and_smoothness_and_lose_the_rest():
    rng = np.random.default_rng(0)
    wave = np.sin(2 * np.pi * T / 2.0)[:, None]
    drawn = [meaningless(wave, T, rng)[:, 0] for _ in range(60)]
    sizes = [np.std(x) / np.std(wave) for x in drawn]
    assert 0.85 < np.mean(sizes) < 1.0
    assert max(np.abs(np.diff(x)).max() for x in drawn) < 0.2, "no jumps"
    alike = [np.corrcoef(x, wave[:, 0])[0, 1] for x in drawn]
    assert np.abs(np.mean(alike)) < 0.15
    assert np.quantile(np.abs(alike), 0.9) < 0.6, "even where the command repeats itself"


def test_the_rate_is_what_chance_would_add():
    assert false_discovery_rate([0.001, 0.004], 50) == pytest.approx(0.1)
    assert false_discovery_rate([0.001] * 2, 50) == pytest.approx(0.025)
    assert false_discovery_rate([0.9], 50) == 1.0
    assert false_discovery_rate([], 50) == 0.0
