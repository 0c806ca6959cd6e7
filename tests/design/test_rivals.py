"""Rival sets: distances and entropy against brute force, and recordings that tell them apart."""

import json
from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from rival_pair import PERIOD, RIVALS, commands
from simulated import robot
from violations import violations

from sim2real.design.limits import AS_IT_IS, Context, limits_of
from sim2real.design.rivals import (
    JointObjective,
    Request,
    design_for_rivals,
    forecast,
    remaining_entropy,
)
from sim2real.diagnose.decision import DECISION
from sim2real.recording import PER_INERTIA, read_recording, write_recording
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import rollout


@pytest.fixture(scope="module")
def objective():
    return JointObjective(RIVALS)


def predicted(one, command):
    """Mean and covariance of a set's whitened prediction, from rollouts and dense matrices."""
    rows = [one.theta]
    sizes = 1e-2 / np.sqrt(np.diag(one.information))
    for column, size in zip(one.columns, sizes, strict=True):
        rows.append(one.theta.copy())
        rows[-1][column] += size
    rows = np.array(rows)
    rows[:, 3] = RIVALS.load.inertia_kgm2
    t = PERIOD * np.arange(command.size)
    angle = rollout(rows, t, command) / RIVALS.noise_rad
    lag = RIVALS.autoregression.size
    slopes = ((angle[1:] - angle[0]) / sizes[:, None]).T[lag:]
    spread = slopes @ np.linalg.inv(one.information) @ slopes.T
    return angle[0, lag:], np.eye(len(slopes)) + spread


def bhattacharyya(first, second, *, fitted_noise=False):
    (a, A), (b, B) = first, second
    mean = (A + B) / 2
    apart = (a - b) @ np.linalg.solve(mean, a - b) / 8
    if fitted_noise:
        apart = 175 * np.log1p(8 * apart / 175) / 8
    logs = [np.linalg.slogdet(x)[1] for x in (mean, A, B)]
    return apart + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2]))


def test_the_distance_is_that_of_two_gaussian_predictions(objective):
    found_all = objective.distances(commands())
    for command, found in zip(commands(), found_all, strict=True):
        sets = [predicted(one, command) for one in RIVALS.sets]
        expected = bhattacharyya(*sets, fitted_noise=True)
        assert found[0, 1] == pytest.approx(expected, rel=0.1)
        assert found[0, 1] == found[1, 0]
        assert found[0, 0] == found[1, 1] == 0


def test_the_trusted_share_follows_from_what_a_refitted_plain_servo_leaves():
    quiet = replace(RIVALS, noise_rad=RIVALS.noise_rad / 5)
    t, step, shares = PERIOD * np.arange(200), 1e-3, []
    for one in RIVALS.sets:
        owner = one.effects[0]
        bare = np.where([name.startswith(owner) for name in COLUMNS], 0.0, one.theta)
        moved = [bare + step * bare * (np.arange(bare.size) == k) for k in one.columns[:2]]
        rows = np.array([one.theta, bare, *moved])
        rows[:, 3] = RIVALS.load.inertia_kgm2
        angle = rollout(rows, t, commands()[0])[:, 25:] / quiet.noise_rad
        # A plain servo whose gains may change by as much as they are: a prior of that width.
        slopes = np.vstack([(angle[2:] - angle[1]).T / step, np.eye(2)])
        effect = np.append(angle[0] - angle[1], [0.0, 0.0])
        left = effect - slopes @ np.linalg.lstsq(slopes, effect, rcond=None)[0]
        energy = one.gain + 87.5 * np.log1p(left @ left / 175)
        shares.append(one.probability / (1 + DECISION.law_error**2 * energy))
    (_, _, trusted), *_ = JointObjective(quiet).predictions(commands()[:1])
    assert trusted == pytest.approx(sum(shares), rel=0.1)
    assert 0.5 < trusted < 0.9


def test_the_remaining_entropy_bounds_that_of_sampled_posteriors():
    rng = np.random.default_rng(1)
    means = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 4.0]])
    p = np.array([0.5, 0.3, 0.2])
    distance = ((means[:, None] - means) ** 2).sum(axis=2) / 8
    bound = remaining_entropy(p, distance[None])[0]
    place = rng.choice(3, size=20_000, p=p)
    y = means[place] + rng.normal(size=(place.size, 2))
    log = np.log(p) - 0.5 * ((y[:, None] - means) ** 2).sum(axis=2)
    post = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None])
    sampled = -(post * np.log(post)).sum(axis=1).mean()
    assert sampled <= bound <= -(p * np.log(p)).sum()
    assert bound < sampled + 0.25


def test_a_simulation_that_diverges_is_never_chosen(objective, monkeypatch):
    assert remaining_entropy(np.array([0.5, 0.5]), np.full((1, 2, 2), np.nan))[0] == np.inf
    mean, spread, _ = next(iter(objective.predictions(commands()[:1])))
    for value in (np.nan, np.inf, 1e200):
        diverged = mean.copy()
        diverged[1, 0] = value
        seen = [(mean, spread, 1.0), (diverged, spread, 1.0)]
        monkeypatch.setattr(objective, "predictions", lambda commands, seen=seen: iter(seen))
        scores = objective(commands()[:2])
        assert np.isfinite(scores[0])
        assert scores[1] == -np.inf


SECONDS = 6.0
ASKED = Request(SECONDS, file="d.json")


def designed(rivals=RIVALS, contexts=(), **given):
    few = {"samples": 6e4} | given
    return design_for_rivals([rivals], robot("j1"), ASKED, contexts, **few)


@pytest.fixture(scope="module")
def plain():
    return designed()


def test_it_keeps_the_limits_and_can_be_played(plain, tmp_path):
    limits = limits_of(robot("j1"))
    command = plain.recording().command[:, 0]
    assert violations(command[None], limits) == [[]]
    assert command.size == round(SECONDS / PERIOD)
    write_recording(plain.recording(), tmp_path / "next.csv")
    again = read_recording(tmp_path / "next.csv")
    np.testing.assert_allclose(again.command[:, 0], command, atol=1e-6)
    assert again.metadata["rivals"] == json.loads(json.dumps([x.content() for x in plain.joints]))
    assert again.loads["j1"] == RIVALS.load


def test_what_is_stated_is_the_forecast_of_its_commands(plain):
    (joint,) = plain.joints
    again = forecast(JointObjective(RIVALS), joint.command)
    assert again.pairs == joint.pairs
    assert 0.5 <= joint.pairs[0].expected <= 1.0
    assert plain.informative
    assert "separate Coulomb friction from" in str(plain)


def test_a_context_is_asked_for_where_it_tells_more():
    # Almost without inertia nothing but the gain shows; a hundredfold noise hides it all.
    loud = replace(RIVALS, noise_rad=0.02)
    soft = Context("a quarter of the gain", gain=0.25)
    same = Context("the same once more", supply=1.0)
    found = designed(loud, [soft])
    assert found.setting == "context: a quarter of the gain"
    assert found.joints[0].remaining < designed(loud).joints[0].remaining
    assert designed(loud, [same]).setting == f"context: {AS_IT_IS.name}"


def test_where_nothing_can_be_told_it_says_so():
    found = designed(replace(RIVALS, noise_rad=5.0), samples=1.0)
    assert not found.informative
    assert str(found).startswith("Nothing more can be distinguished within these limits")


def test_a_load_is_known_of_all_recordings_or_of_none():
    unknown, arm = replace(RIVALS, load=PER_INERTIA), Context("arm", {"j1": RIVALS.load})
    message(lambda: designed(unknown, [arm]), "loads.j1", "one in all or in none")
    elsewhere = Context("arm", {"j7": RIVALS.load})
    message(lambda: designed(RIVALS, [elsewhere]), "'j7'")


def test_no_rivals_left_or_another_robot_is_said_in_one_line():
    message(lambda: design_for_rivals([RIVALS], robot("k1"), ASKED), "'j1'", "k1")
    sure, other = RIVALS.sets
    sets = (replace(sure, probability=0.98), replace(other, probability=0.02))
    known = replace(RIVALS, sets=sets)
    message(lambda: design_for_rivals([known], robot("j1"), ASKED), "d.json", "rival_sets")
