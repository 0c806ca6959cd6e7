"""A policy that samples: its own distribution, correlated in time, the same for one seed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rl.deploy.export import SampledController, read_zip
from rl.deploy.policy import PolicyController
from rl.observer import PAPER
from rl.sac.plan import Settings
from rl.sac.sac import make_sac


@pytest.fixture
def zipped(world_of, tmp_path):
    agent = make_sac(world_of(1), Settings(hidden=(16, 16), memory=10), 0, view=PAPER)
    with torch.no_grad():
        agent.actor.log_std.weight.zero_()
        agent.actor.log_std.bias.fill_(np.log(0.2))
    agent.save(tmp_path / "policy.zip")
    return tmp_path / "policy.zip"


def test_it_acts_about_the_mean_with_the_policys_own_spread(zipped):
    seen = np.random.default_rng(0).normal(0, 0.3, (20_000, 11)).astype(np.float32)
    policy = read_zip(zipped)
    span = (policy.high - policy.low) / 2
    drawn = SampledController(zipped).act(seen)
    mean = PolicyController(policy).act(seen)
    off = np.arctanh(((drawn - policy.low) / span - 1).astype(float)) - np.arctanh(
        ((mean - policy.low) / span - 1).astype(float)
    )
    assert off.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.01)
    assert off.std(axis=0) == pytest.approx(np.full(3, 0.2), rel=0.03)


def test_its_noise_stays_for_a_quarter_of_a_second(zipped):
    seen = np.zeros((4_000, 11), dtype=np.float32)
    controller = SampledController(zipped, seed=1)
    controller.reset(np.ones(4_000, dtype=bool))
    acts = np.array([controller.act(seen)[:, 0] for _ in range(14)])
    correlation = np.corrcoef(acts)[0]
    assert correlation[1] == pytest.approx(np.exp(-0.02 / 0.25), abs=0.02)
    assert correlation[13] == pytest.approx(np.exp(-0.26 / 0.25), abs=0.05)


def test_one_seed_gives_one_swim_and_a_robot_that_begins_anew_gets_new_noise(zipped):
    seen = np.zeros((3, 11), dtype=np.float32)
    one, other = SampledController(zipped, seed=2), SampledController(zipped, seed=2)
    assert np.array_equal(one.act(seen), other.act(seen))
    one.reset(np.array([True, False, False]))
    now, as_before = one.act(seen), other.act(seen)
    assert (now[0] != as_before[0]).any()
    assert np.abs(now[1:] - as_before[1:]).max() < 0.5
