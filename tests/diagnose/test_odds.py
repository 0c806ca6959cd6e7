"""Odds of findings: weights of features, read from the file, and what the features say."""

import numpy as np
import pytest

from sim2real.diagnose.decision import CURVES, ODDS, Odds, read_odds
from sim2real.diagnose.missing.calibrated_odds import scaled
from sim2real.errors import InputError

EFFECT = {
    "probability": 0.9,
    "evidence": 40.0,
    "error_change": 0.3,
    "groups": 0,
    "excess": 1.0,
    "uncatalogued_lead": -20.0,
}
JOINT = {"joint excess_plain": 0.0, "joint error_plain": 0.0, "joint error": 0.0}
WHOLE = {
    "excess_plain": 1.0,
    "excess": 1.0,
    "explained_share": 0.5,
    "smooth_evidence": -5.0,
    "windows_evidence": -np.inf,
    "uncatalogued_lead": -5.0,
    "named_evidence": 0.0,
    "remaining_gain": 0.5,
    "groups": 0,
    "error_plain": 1.0,
    "error": 1.0,
}


def test_odds_are_the_sum_of_weights_times_features():
    odds = Odds({"intercept": 1.0, "gain": -2.0})
    assert odds.probability({"intercept": 1.0, "gain": 0.25}) == pytest.approx(
        1 / (1 + np.exp(-0.5))
    )


def test_features_and_weights_must_have_the_same_names():
    """A renamed feature whose weight keeps the old name would silently count as 0."""
    odds = Odds({"intercept": 0.0, "gain": 1.0})
    with pytest.raises(ValueError, match="gain, gains"):
        odds.probability({"intercept": 1.0, "gains": 2.0})
    with pytest.raises(ValueError, match="extra"):
        odds.probability({"intercept": 1.0, "gain": 0.0, "extra": 1.0})


@pytest.mark.parametrize("extreme", [np.inf, -np.inf, 1e12, 0.0])
def test_all_features_are_finite_whatever_was_measured(extreme):
    """Also where nothing was held out, nothing tried, or nothing is left."""
    names = (
        "error_change",
        "evidence",
        "remaining_gain",
        "excess",
        "uncatalogued_lead",
        "gain",
        "irregularity",
        "windows_evidence",
    )
    assert np.isfinite(list(scaled(**dict.fromkeys(names, extreme)).values())).all()


def test_what_takes_more_of_the_error_away_says_so():
    much, little = (scaled(**{**EFFECT, "error_change": c}) for c in (0.5, 0.05))
    assert much["error_change"] > little["error_change"]


def test_the_curves_that_ship_call_a_servo_that_fits_well():
    assert set(ODDS) == set(CURVES)
    assert ODDS["mismatch"].probability(scaled(**WHOLE)) < 0.2
    assert ODDS["uncatalogued"].probability(scaled(**WHOLE)) < 0.2


def test_a_large_error_on_left_out_data_that_nothing_lowers_has_no_name():
    """A horn that slips late in one of two recordings: little beyond the noise, but elsewhere."""
    slipped = {
        "excess_plain": 1.4,
        "excess": 1.37,
        "windows_evidence": 400.0,
        "smooth_evidence": 110.0,
        "named_evidence": 4.0,
    }
    there = {"error_plain": 11.0, "error": 30.0, "groups": 1}
    assert ODDS["uncatalogued"].probability(scaled(**{**WHOLE, **slipped, **there})) > 0.5
    assert ODDS["uncatalogued"].probability(scaled(**{**WHOLE, **slipped})) < 0.5


def test_the_effect_that_explains_all_of_a_large_error_is_likely():
    sure = {**EFFECT, "probability": 0.99, "evidence": 2000.0, "error_change": 0.9}
    weak = {**EFFECT, "probability": 0.6, "evidence": 6.0, "error_change": 0.02}
    strong, faint = (ODDS["effect"].probability(scaled(**x) | JOINT) for x in (sure, weak))
    assert strong > 0.8
    assert faint < strong


def test_a_weight_that_is_no_number_is_said(tmp_path):
    path = tmp_path / "decision.json"
    path.write_text('{"schema": "sim2real.decision/1", "odds": {"effect": {"intercept": "x"}}}')
    with pytest.raises(InputError, match=r"odds\.effect\.intercept"):
        read_odds(path)
