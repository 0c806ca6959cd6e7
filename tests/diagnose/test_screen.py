"""The linear look at all effects: right about the one that is there, quiet where there is none."""

import numpy as np
import pytest
from simulated import traced

from sim2real.diagnose.screening import Screen, candidate, screen
from sim2real.diagnose.servo_search import baselines
from sim2real.effects import named
from sim2real.servo.batch import Batch

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
