"""The likelihood of held-out recordings: as expected under a right link, below it otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from test_link import LEAST_GAIN, recording

from sim2real.diagnose.link.link_effect import LinkData, LinkScore, link
from sim2real.diagnose.link.link_score import ScoreJob, link_score
from sim2real.inference.correlated_noise import whitened
from sim2real.servo.event_filter import Arrivals, Channel, EventFilter, sampled
from sim2real.servo.linearised import Modes


@pytest.fixture(scope="module", params=[{"loss": 0.03}, {"jitter": 0.008}], ids=str)
def job(request):
    """Two recordings of one joint, and the link that was fitted to both."""
    recordings = tuple(recording(seed, **request.param)[0] for seed in (1, 2))
    data = LinkData((recordings,), 6, LEAST_GAIN)
    return ScoreJob((data, data), link(data))


@pytest.fixture(scope="module")
def score(job):
    return link_score(job)


def test_a_right_link_leaves_noise_on_held_out_recordings(score):
    assert score.at_noise() and score.error_ratio < 1.05
    assert score.loglikelihood - score.without > 100
    assert score.samples > 1000 and score.sd >= np.sqrt(score.samples / 2)


def test_what_the_link_does_not_explain_lowers_the_likelihood(job, score):
    ((first, second),) = job.folds[1].joints
    noisy = second.residual + 0.004 * np.random.default_rng(0).normal(size=second.residual.size)
    other = replace(job.folds[1], joints=((first, replace(second, residual=noisy)),))
    wrong = link_score(replace(job, folds=(job.folds[0], other)))
    assert wrong.loglikelihood < score.loglikelihood - 200
    assert not wrong.at_noise() and wrong.error_ratio > 1.2


def test_one_recording_cannot_be_held_out(job):
    with pytest.raises(ValueError, match="above 1"):
        link_score(replace(job, folds=job.folds[:1]))


def test_the_error_ratio_is_that_of_normal_innovations():
    ratio, samples = 1.3, 200_000
    error = ratio * np.random.default_rng(0).normal(size=samples)
    score = LinkScore(-0.5 * float(np.sum(error**2)), -0.5 * samples, 1.0, 0.0, samples)
    assert score.error_ratio == pytest.approx(ratio, rel=0.01)


def channel(rng, samples=1500):
    t = np.arange(samples) / 50
    command = 0.3 * np.sign(np.sin(2 * t)) + 0.1 * np.sin(7 * t)
    counts = np.ones(samples)
    return Channel(
        t, command, 0.03, Modes(-9 + 20j, -9 - 20j, 481.0), np.zeros(samples), counts,
        np.zeros(samples, dtype=bool), np.array([0.5]), 1e-6,
    )  # fmt: skip


def test_drawn_residuals_are_noise_where_set_points_arrive_regularly():
    rng = np.random.default_rng(1)
    one = channel(rng)
    (drawn,) = sampled([one], Arrivals(), rng, 4)
    for residual in drawn:
        innovation = whitened(residual, one.autoregression)[5:]
        assert np.std(innovation) == pytest.approx(1e-3, rel=0.06)


@pytest.mark.parametrize("truth", [Arrivals(0.05, 0.3), Arrivals(delay_sd_s=0.004)])
def test_the_filter_prefers_the_arrivals_that_residuals_were_drawn_with(truth):
    rng = np.random.default_rng(2)
    one = channel(rng)
    (drawn,) = sampled([one], truth, rng, 3)
    filtered = EventFilter([[replace(one, residual=x)] for x in drawn])
    scales = (0.25, 1.0, 4.0)
    options = [Arrivals(s * truth.loss, truth.repeated_loss, s * truth.delay_sd_s) for s in scales]
    totals = [sum(x.loglikelihood for x in results) for results in filtered.run(options)]
    assert int(np.argmax(totals)) == 1
