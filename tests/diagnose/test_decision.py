"""Every number that decides: complete, with what it was read from; and the reading recovers it."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import calibrate_decisions as script
from benchmarks.decision_curves import logistic
from sim2real.diagnose.calibrated_odds import judged, judged_together, offer, scaled, simpler
from sim2real.diagnose.decision import CURVES, DECISION, FILE, ODDS, Odds, read_decision, read_odds
from sim2real.diagnose.effect_probabilities import EffectPosterior, posterior
from sim2real.diagnose.investigate import _on_all
from sim2real.diagnose.link_effect import IrregularTiming
from sim2real.errors import InputError
from sim2real.identification.held_out import Unseen


def test_every_number_is_read_and_says_what_it_is_and_why():
    text = "".join(file.read_text() for file in FILE.parents[1].rglob("*.py"))
    read = set(re.findall(r"DECISION\.((?:(?:change|link|report)\.)?\w+)", text)) - {"change"}
    read |= {f"change.{name}" for name in re.findall(r"\bnumbers\.(\w+)", text)}
    values = json.loads(FILE.read_text())["values"]
    assert set(values) == read
    assert all(entry["what"] and entry["from"] for entry in values.values())
    with pytest.raises(AttributeError, match="no number 'other'"):
        read_decision().change.other  # noqa: B018


def test_a_number_of_a_group_is_read_or_refused(tmp_path):
    content = json.loads(FILE.read_text())
    content["values"]["change.same_command"]["value"] = 0.125
    file = tmp_path / "decision.json"
    file.write_text(json.dumps(content))
    assert read_decision(file).change.same_command == 0.125
    content["values"]["link.min_gain"]["value"] = "x"
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"values\.link\.min_gain\.value"):
        read_decision(file)


def row(**more):
    usual = {
        "case": "a", "set": "own", "kind": "null", "joint": "j1", "truth": [], "outside": False,
        "nuisances": {}, "excess_plain": 1.0, "excess": 1.0, "step": 1.0, "groups": [],
        "whole": {"intercept": 1.0, "own": 0.0}, "link": None,
    }  # fmt: skip
    return usual | more


def test_a_logistic_curve_comes_back():
    rng = np.random.default_rng(0)
    x = np.stack([np.ones(4000), rng.normal(0, 2, 4000)], axis=1)
    y = (rng.random(4000) < 1 / (1 + np.exp(-(-1 + 0.8 * x[:, 1])))).astype(float)
    assert logistic(x, y, 2.4) == pytest.approx([-1, 0.8], abs=0.15)


def test_few_cases_change_nothing(tmp_path, monkeypatch):
    (tmp_path / "sim2real" / "diagnose").mkdir(parents=True)
    (tmp_path / "reports").mkdir()
    target = tmp_path / "sim2real" / "diagnose" / "decision.json"
    target.write_text(FILE.read_text())
    monkeypatch.setattr(script, "ROOT", tmp_path)
    script.write([row()], dry=False, measures=True)
    assert json.loads(target.read_text())["values"] == json.loads(FILE.read_text())["values"]
    assert read_odds(target) == read_odds()
    script.write([row(case=str(k), excess_plain=1.2) for k in range(60)], dry=False, measures=True)
    assert read_decision(target).structured_excess == pytest.approx(1.2)
    report = json.loads((tmp_path / "reports" / "decisions.json").read_text())
    assert report["values"]["structured_excess"]["count"] == 60
    assert set(report["odds"]) == set(CURVES)


def test_the_detection_gain_is_that_from_which_most_are_named():
    """An eighth of those below are named by chance, and as many of those above are not."""
    rows = []
    for k in range(200):
        gain = 0.2 * k
        named = (gain > 15) != (k % 8 == 0)
        said = [[["backlash"], 0.9 if named else 0.1]]
        more = {"kind": "single", "truth": ["backlash"], "said": said, "alone": {"backlash": gain}}
        rows.append(row(case=str(k), **more))
    assert script.values_of(rows)["detection_gain"][0] == pytest.approx(15, abs=1.0)


EFFECT = {"probability": 0.9, "evidence": 40.0, "error_change": 0.3, "groups": 0, "excess": 1.0,
          "uncatalogued_lead": -20.0}  # fmt: skip
JOINT = {"joint excess_plain": 0.0, "joint error_plain": 0.0, "joint error": 0.0}
WHOLE = {"excess_plain": 1.0, "excess": 1.0, "explained_share": 0.5, "smooth_evidence": -5.0,
         "windows_evidence": -np.inf, "uncatalogued_lead": -5.0, "named_evidence": 0.0,
         "remaining_gain": 0.5, "groups": 0, "error_plain": 1.0, "error": 1.0}  # fmt: skip
BASE = frozenset()
SMALL, BOTH = frozenset({"coulomb_friction"}), frozenset({"coulomb_friction", "deadband"})
NEGLIGIBLE = 0.5 * DECISION.negligible


def test_features_and_weights_must_have_the_same_names():
    """A renamed feature whose weight keeps the old name would silently count as 0."""
    odds = Odds({"intercept": 1.0, "gain": -2.0})
    half = odds.probability({"intercept": 1.0, "gain": 0.25})
    assert half == pytest.approx(1 / (1 + np.exp(-0.5)))
    for features in ({"intercept": 1.0, "gains": 2.0}, {"intercept": 1.0, "gain": 0.0, "x": 1.0}):
        with pytest.raises(ValueError, match="features and weights differ"):
            odds.probability(features)


@pytest.mark.parametrize("extreme", [np.inf, -np.inf, 1e12, 0.0])
def test_all_features_are_finite_whatever_was_measured(extreme):
    """Also where nothing was held out, nothing tried, or nothing is left."""
    names = ("error_change", "evidence", "remaining_gain", "excess", "uncatalogued_lead", "gain",
             "irregularity", "windows_evidence")  # fmt: skip
    assert np.isfinite(list(scaled(**dict.fromkeys(names, extreme)).values())).all()


def test_the_curves_that_ship_call_a_servo_that_fits_well():
    assert set(ODDS) == set(CURVES)
    assert ODDS["mismatch"].probability(scaled(**WHOLE)) < 0.2
    assert ODDS["uncatalogued"].probability(scaled(**WHOLE)) < 0.2


def test_a_large_error_on_left_out_data_that_nothing_lowers_has_no_name():
    """A horn that slips late in one of two recordings: little beyond the noise, but elsewhere."""
    slipped = {"excess_plain": 1.4, "excess": 1.37, "windows_evidence": 400.0,
               "smooth_evidence": 110.0, "named_evidence": 4.0}  # fmt: skip
    there = {"error_plain": 11.0, "error": 30.0, "groups": 1}
    late, early = (scaled(**{**WHOLE, **slipped, **more}) for more in (there, {}))
    assert ODDS["mismatch"].probability(late) > 0.9 > ODDS["mismatch"].probability(early)
    unknown = ODDS["uncatalogued"].probability
    assert unknown(late) > 10 * unknown(early)


def test_the_effect_that_explains_all_of_a_large_error_is_probable():
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


def finding(*sets, **changes):
    """What was tried, and by what share each effect lowers the held-out error."""
    tried = {members: SimpleNamespace(members=members) for members in (BASE, *sets)}
    return SimpleNamespace(
        tried=SimpleNamespace(base=BASE, tried=tried),
        changes=lambda unseen, effect: changes[effect],
    )


@pytest.mark.parametrize(
    ("sets", "friction", "deadband", "expected"),
    [
        ((SMALL, BOTH), 0.5, NEGLIGIBLE, SMALL),
        ((SMALL, BOTH), 0.5, 2 * DECISION.negligible, BOTH),
        ((SMALL, BOTH), NEGLIGIBLE, NEGLIGIBLE, BASE),
        ((BOTH,), 0.5, NEGLIGIBLE, BOTH),  # without the dead band it was not tried
    ],
)
def test_negligible_effects_are_what_is_taken_off(sets, friction, deadband, expected):
    result = finding(*sets, coulomb_friction=friction, deadband=deadband)
    assert simpler(result, result.tried.tried[BOTH], {}) == expected


@pytest.mark.parametrize(("more", "expected"), [(1.0, SMALL), (0.995, SMALL), (0.97, BOTH)])
def test_a_negligible_effect_stays_where_it_lowers_the_held_out_error(more, expected):
    result = finding(SMALL, BOTH, coulomb_friction=0.5, deadband=NEGLIGIBLE)
    held_out = {
        s: Unseen((np.full(4, x),), np.zeros((1, 1))) for s, x in ((SMALL, 1.0), (BOTH, more))
    }
    assert offer(result, result.tried.tried[BOTH], SMALL, held_out).members == expected
    assert offer(result, result.tried.tried[BOTH], SMALL, {}).members == BOTH


def on_all(gain, *shares):
    """Whether joints of which each but the last misses something else share this link."""
    link = IrregularTiming({"packet_loss": (0.05, 0.01)}, gain, shares=shares)
    findings = [SimpleNamespace(mismatch=True) for _ in shares[:-1]]
    return _on_all(link, link, [*findings, SimpleNamespace(mismatch=False)])


def test_a_link_is_of_all_joints_unless_some_contradict_it():
    assert not on_all(150.0, 190.0, 0.0, 0.0)
    assert not on_all(0.0, 0.0, 0.0)
    assert on_all(188.0, 190.0, 0.0), "a joint that hardly moves contradicts nothing"
    assert on_all(740.0, 90.0, 30.0, 625.0)


@pytest.fixture
def shared(explained_joint):
    """Findings of two joints on one link, the second with structure that stays."""
    _, (joint,) = explained_joint
    base = joint.finding.tried.plain
    link = IrregularTiming({"packet_loss": (0.02, 0.002)}, 700.0, shares=(650.0, 50.0))
    without = replace(joint.finding.unmodelled, windows_evidence=300.0, excess=6.0)
    first = replace(joint.finding, best=base, groups=(), link=link, excess=1.0, unmodelled=without)
    return [first, replace(first, place=1, excess=2.2)], joint.unseen


def of_link(finding):
    return max(g.probability for g in finding.groups if g.members == ("packet_loss",))


def test_a_link_is_as_likely_on_all_joints_that_share_it(shared):
    findings, unseen = shared
    alone = judged(findings[1], unseen)
    together = judged_together(findings, [unseen, unseen])
    assert of_link(alone) < of_link(together[1])
    assert all(of_link(f) >= DECISION.max_uncertain_probability for f in together)


def test_events_that_nobody_foretells_are_nothing_outside_the_catalogue(shared):
    findings, unseen = shared
    regular = judged(replace(findings[0], link=None), unseen)
    lossy = judged(findings[0], unseen)
    assert regular.unknown > lossy.unknown and lossy.unknown < 0.1
    assert not lossy.unexplained and lossy.mismatch


SETS = (frozenset({"a", "x"}), frozenset({"b", "x"}), frozenset({"a"}), frozenset())


def drawn(searched, **more):
    return posterior(searched.tried, np.random.default_rng(0), **more)


@pytest.mark.parametrize("case", ["nothing", "rubbing", "filtered"])
def test_probabilities_add_up_to_one(case, request):
    result = drawn(request.getfixturevalue(case))
    assert result.probability.sum() == pytest.approx(1.0)
    assert (np.diff(result.probability) <= 0).all(), "likeliest first"
    assert (result.probability >= 0).all()


def test_two_filters_stand_in_one_group(filtered):
    (group,) = drawn(filtered).groups(frozenset())
    assert set(group.members) == {"command_filter", "sensor_filter"}
    assert group.probability > 0.9


def test_what_else_is_known_moves_the_odds(filtered):
    before = drawn(filtered).inclusion("sensor_filter")
    after = drawn(filtered, log_odds={"sensor_filter": 3.0}).inclusion("sensor_filter")
    never = drawn(filtered, log_odds={"sensor_filter": -50.0}).inclusion("sensor_filter")
    assert after > before > never
    assert never < 1e-6


def test_groups_are_swaps_of_one_member():
    result = EffectPosterior(SETS, np.array([0.4, 0.3, 0.2, 0.1]))
    first, second = result.groups(frozenset())
    assert (first.members, first.probability) == (("x",), pytest.approx(0.7))
    assert (second.members, second.probability) == (("a", "b"), pytest.approx(0.9))


def test_an_unlikely_rival_is_no_member():
    result = EffectPosterior(SETS, np.array([0.79, 0.01, 0.15, 0.05]))
    assert all("b" not in group.members for group in result.groups(frozenset()))
