"""Where something stays unexplained, the model is the one that predicts best, and says so."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import FRICTION, KD, NOISE, recording, two

from sim2real.diagnose.missing.best_predictor import predicting
from sim2real.model import FittedEffect
from sim2real.servo.prediction import predict


@pytest.fixture(scope="module")
def puzzled(explained):
    """A diagnosis that named an effect and has no model for it."""
    fit = explained.baseline_fit
    model = replace(explained.model, joints=explained.baseline.joints, fit=fit)
    return replace(explained, verdict="partly_explained", model=model)


@pytest.fixture(scope="module")
def better(puzzled):
    return predicting(puzzled, two(**FRICTION), seed=0)


def rmse(model, one):
    angle = predict(model, one.t, {"j1": one.command[:, 0]}, one.loads)["j1"]
    return np.sqrt(np.mean((angle - one.position[:, 0]) ** 2))


def test_it_predicts_what_no_fit_has_seen(puzzled, better):
    unseen = recording(7, "unseen", noise=0.0, **FRICTION)
    assert rmse(puzzled.model, unseen) > 3 * NOISE
    assert rmse(better.model, unseen) < NOISE / 2


def test_the_model_carries_its_errors_and_says_what_its_effects_are(better):
    figures = better.model.fit["j1.position_rad"]
    assert figures["train"] == pytest.approx(NOISE, rel=0.08)
    assert figures["heldout"] == pytest.approx(NOISE, rel=0.08)
    assert "stand in" in better.model.joints["j1"].notes[-1]


def test_what_is_believed_stays(puzzled, better):
    assert better.verdict == puzzled.verdict
    assert better.unknown == puzzled.unknown
    assert [e.probability for e in better.effects] == [e.probability for e in puzzled.effects]


def test_a_shift_leads_from_the_plain_servo_to_the_model(puzzled, better):
    (before,), (after,) = puzzled.effects, better.effects
    for name, shift in after.baseline_shift.items():
        old, new = (getattr(found.model.joints["j1"], name) for found in (puzzled, better))
        assert new - shift == pytest.approx(old - before.baseline_shift[name], abs=1e-12)
    assert better.model.joints["j1"].kd_Nms_per_rad == pytest.approx(KD, rel=0.03)


def test_the_same_seed_gives_the_same_model(puzzled, better):
    assert predicting(puzzled, two(**FRICTION), seed=0).model == better.model


def test_what_is_explained_is_left_alone(explained):
    assert explained.verdict == "explained"
    assert predicting(explained, two(**FRICTION), seed=0) is explained


def test_effects_of_a_given_model_stay(puzzled):
    friction = tuple(FittedEffect(name, values) for name, values in FRICTION.items())
    joints = {name: replace(j, effects=friction) for name, j in puzzled.baseline.joints.items()}
    found = replace(puzzled, baseline=replace(puzzled.baseline, joints=joints))
    assert predicting(found, two(**FRICTION), seed=0) is found


def test_a_model_that_predicts_no_better_is_not_taken(puzzling):
    given, found = puzzling
    assert found.verdict == "unexplained"
    assert predicting(found, given, seed=0).model == found.model
