"""The grader's numbers, checked on cases made by hand."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim2real.model import FittedEffect, JointModel, Model, write_model
from sim2real.recording import Load, Recording, write_recording
from sim2real.servo.prediction import predict

FOLDER = Path(__file__).parents[2] / "datasets" / "sealed"
MODULES = ("grade", "measures", "bars", "page")
LOADS = {joint: Load(0.002, 0.1, 0.1) for joint in ("j1", "j2", "j3")}
NOISE = {"step_rad": 0.0, "white_rad": 0.001, "wander_rad": 0.0, "wander_s": 1.0}
FRICTION = ("coulomb_friction", "j2", {"torque_Nm": 0.05})


@pytest.fixture(scope="module")
def code(scripts):
    with scripts(FOLDER, names=MODULES) as modules:
        yield modules


def servos(*effects):
    """Three servos with (effect, joint, parameters) in them."""

    def fitted(joint):
        return tuple(FittedEffect(e, p) for e, j, p in effects if j == joint)

    return Model({j: JointModel(2.0, 0.08, 0.04, 0.002, effects=fitted(j)) for j in LOADS})


def hidden(effect, component, parameters=None, strength=1.0):
    named = {"effect": effect, "component": component}
    return named | {"parameters": parameters or {}, "strength": strength}


def entry(effect, component, probability, group=(), **means):
    parameters = {
        name: {"mean": m, "sd": 0.1 * m, "q05": 0.9 * m, "q95": 1.1 * m}
        for name, m in means.items()
    }
    named = {"effect": effect, "component": component, "probability": probability}
    return named | {"group": [effect, *group], "parameters": parameters}


class Challenge:
    """A set and its verdicts, case by case."""

    def __init__(self, folder):
        self.set, self.verdicts, self.answers = folder / "set", folder / "verdicts", []
        self.set.mkdir()

    def add(self, kind, effects=(), verdict="consistent", said=(), mismatch=(), **more):
        """A case with no recording held out."""
        name = f"case_{len(self.answers) + 1:04d}"
        joints = {joint: {"noise": NOISE} for joint in LOADS}
        self.answers.append(
            {"case": name, "kind": kind, "trap": "", "effects": list(effects), "joints": joints}
            | {"windows_s": {}, "oracle": {}}
            | more
        )
        folder = self.verdicts / name
        folder.mkdir(parents=True)
        content = {"verdict": verdict, "effects": list(said), "mismatch": list(mismatch)}
        (folder / "diagnosis.json").write_text(json.dumps(content))
        return name

    def hold_out(self, name, true, baseline, enriched, noise=0.0):
        """The motion of one model, and two others that were fitted."""
        t = np.arange(0.0, 4.0, 0.02)
        command = np.stack([0.4 * np.sign(np.sin(3 * t)), 0.3 * np.sin(4 * t), 0.0 * t], axis=1)
        sent = dict(zip(LOADS, command.T, strict=True))
        angles = predict(true, t, sent, LOADS)
        position = np.stack([angles[joint] for joint in LOADS], axis=1)
        position += np.random.default_rng(0).normal(0, 1e-9 + noise, position.shape)
        recording = Recording("c", "servo", tuple(LOADS), t, command, position, loads=LOADS)
        (self.set / "heldout" / name).mkdir(parents=True)
        write_recording(recording, self.set / "heldout" / name / "c.csv")
        write_model(baseline, self.verdicts / name / "baseline.json")
        write_model(enriched, self.verdicts / name / "enriched.json")

    def results(self, code, **options):
        (self.set / "answers.json").write_text(json.dumps(self.answers))
        return code["grade"].grade(self.set, self.verdicts, **options)

    def metrics(self, code):
        return self.results(code)["tiers"]["T1"]["metrics"]


@pytest.fixture
def challenge(tmp_path):
    return Challenge(tmp_path)


def counted(metric):
    return metric["count"], metric["of"]


def test_false_alarms_are_names_at_nine_tenths(code, challenge):
    challenge.add("null")
    challenge.add("null", verdict="explained", said=[entry("backlash", "j1", 0.9)])
    challenge.add("trap", verdict="explained", said=[entry("backlash", "j1", 0.89)], trap="clock")
    metrics = challenge.metrics(code)
    assert counted(metrics["false_alarm"]) == (1, 3)
    assert counted(metrics["nulls_flagged"]) == (2, 3)
    assert counted(metrics["confident_wrong"]) == (1, 1)


def test_only_detectable_effects_must_be_noticed(code, challenge):
    for llr, verdict in ((9.9, "consistent"), (10.0, "consistent"), (11.0, "unexplained")):
        oracle = {"llr": {"j1": llr - 1.0, "j2": 1.0}}
        challenge.add("single", [hidden("backlash", "link")], verdict, oracle=oracle)
    challenge.add("double", [hidden("backlash", "j1"), hidden("deadband", "j2")], "explained")
    metrics = challenge.metrics(code)
    assert counted(metrics["detection"]) == (2, 3)
    assert counted(metrics["detection_all"]) == (2, 4)


def test_what_hardly_moves_the_held_out_error_need_not_be_noticed(code, challenge):
    floor = {"j1": 0.002, "j2": 0.002}
    for plain in ({"j1": 0.00209, "j2": 0.002}, {"j1": 0.002, "j2": 0.00211}):
        oracle = {"llr_total": 50.0, "heldout_floor_rad": floor, "heldout_plain_rad": plain}
        challenge.add("single", [hidden("backlash", "link")], "consistent", oracle=oracle)
    metrics = challenge.metrics(code)
    assert counted(metrics["detection"]) == (0, 1)
    assert counted(metrics["detection_all"]) == (0, 2)


def test_first_group_exact_name_and_oracles_group(code, challenge):
    true, oracle = [hidden("backlash", "j1")], {"llr_total": 50.0, "group": ["backlash", "cogging"]}

    def answer(*said):
        challenge.add("single", true, "explained", said, oracle=oracle)

    answer(entry("backlash", "j1", 0.9))  # all right
    answer(entry("cogging", "j1", 0.9, ["backlash"]))  # in the group, and in the oracle's
    answer(entry("deadband", "j1", 0.9, ["backlash"]))  # in the group, not in the oracle's
    answer(entry("backlash", "j2", 0.9))  # wrong joint
    answer(entry("cogging", "j1", 0.9), entry("backlash", "j1", 0.8))  # second
    metrics = challenge.metrics(code)
    assert counted(metrics["group_first"]) == (3, 5)
    assert counted(metrics["exact_first"]) == (1, 5)
    assert counted(metrics["first_in_oracle_group"]) == (3, 5)
    assert counted(metrics["component"]) == (4, 5)
    assert counted(metrics["confident_wrong"]) == (2, 5)
    assert metrics["group_size"]["value"] == pytest.approx(7 / 5)


def test_calibration_of_two_bins(code, challenge):
    true = [hidden("backlash", "j1")]
    for _ in range(3):
        challenge.add("single", true, "explained", [entry("backlash", "j1", 0.85)])
    challenge.add("single", true, "explained", [entry("cogging", "j1", 0.25)])
    challenge.add("single", true, "explained", [entry("cogging", "j1", 0.04)])  # not counted
    results = challenge.results(code)["tiers"]["T1"]
    assert results["metrics"]["ece"]["value"] == pytest.approx((3 * 0.15 + 0.25) / 4)
    assert results["metrics"]["brier"]["value"] == pytest.approx((3 * 0.15**2 + 0.25**2) / 4)
    assert [b["of"] for b in results["reliability"]] == [0, 0, 1, 0, 0, 0, 0, 0, 3, 0]


def test_abstaining_is_a_flag_without_a_name(code, challenge):
    true = [hidden("jam", "j1")]
    name = entry("deadband", "j1", 0.5)
    challenge.add("outside", true, "unexplained")
    challenge.add("outside", true, "partly_explained", [entry("deadband", "j1", 0.49)])
    challenge.add("outside", true, "partly_explained", [name])
    challenge.add("outside", true, "consistent")
    challenge.add("outside", true, "explained", [entry("jam", "j1", 0.95)])  # no name is right
    metrics = challenge.metrics(code)
    assert counted(metrics["outside_abstains"]) == (2, 5)
    assert counted(metrics["outside_flagged"]) == (4, 5)
    assert counted(metrics["outside_confident_wrong"]) == (1, 5)
    assert counted(metrics["confident_wrong"]) == (1, 1)


def test_windows_on_the_right_joint_of_the_right_recording(code, challenge):
    stated = {"a": [[1.0, 2.0], [1.5, 3.0]], "b": []}
    mismatch = [
        {"component": "j1", "windows_by_recording": stated},
        {"component": "j2", "windows_by_recording": {"b": [[0, 4]]}},
    ]
    true = {"a": [[2.0, 4.0]], "b": [[0.0, 4.0]], "c": [[0.0, 9.0]]}
    name = challenge.add(
        "outside", [hidden("jam", "j1")], "unexplained", (), mismatch, windows_s=true
    )
    challenge.hold_out(name, servos(), servos(), servos())
    row = challenge.results(code)["cases"][0]
    assert row["iou"] == pytest.approx([1 / 3, 0.0])
    assert "windows" in row["failures"]


def test_two_effects_need_an_entry_each(code, challenge):
    true = [hidden("backlash", "j1"), hidden("deadband", "j1")]
    both = entry("backlash", "j1", 0.9, ["deadband"])
    faint = entry("deadband", "j1", 0.4)
    challenge.add("double", true, "explained", [both])
    challenge.add("double", true, "explained", [both, entry("deadband", "j1", 0.5)])
    challenge.add("double", true, "explained", [both, faint])
    challenge.add("double", true, "explained", [both, entry("cogging", "j2", 0.7)])
    each = {"llr_total": 99.0, "llr_of_each": {"backlash@j1": 90.0, "deadband@j1": 9.0}}
    challenge.add("double", true, "explained", [both], oracle=each)
    metrics = challenge.metrics(code)
    assert counted(metrics["doubles_both"]) == (1, 4)
    assert counted(metrics["doubles_both_all"]) == (1, 5)
    assert metrics["doubles_f1"]["value"] == pytest.approx(6 / (6 + (4 + 1) / 2))


def test_held_out_error_of_truth_and_of_nothing(code, challenge):
    true, plain = servos(FRICTION), servos()
    effect = [hidden(*FRICTION)]
    said = [entry("coulomb_friction", "j2", 0.9, torque_Nm=0.055)]
    faint = servos(("coulomb_friction", "j2", {"torque_Nm": 0.002}))
    for enriched in (true, faint, plain):
        name = challenge.add("single", effect, "explained", said, oracle={"llr_total": 99.0})
        challenge.hold_out(name, true, plain, enriched, noise=0.001)
    first, second, third = challenge.results(code)["cases"]
    assert first["heldout"]["eta"] == pytest.approx(1.0, abs=0.02)
    assert first["heldout"]["floor"] == pytest.approx(0.001)
    assert 0.0 < second["heldout"]["eta"] < 0.2
    assert third["heldout"]["eta"] == 0.0 == third["heldout"]["drop"]
    assert "error left" in second["failures"] and "error left" not in first["failures"]
    metrics = challenge.metrics(code)
    assert metrics["recovered_median"]["value"] == pytest.approx(second["heldout"]["eta"])
    assert metrics["parameter_error_median"]["value"] == pytest.approx(0.1)
    assert counted(metrics["parameter_covered"]) == (3, 3)


def test_harm_where_nothing_is_missing(code, challenge):
    for enriched in (servos(), servos(FRICTION)):
        name = challenge.add("null")
        challenge.hold_out(name, servos(), servos(), enriched, noise=0.001)
    metrics = challenge.metrics(code)
    assert counted(metrics["harm"]) == (1, 2)
    assert metrics["harm_mean"]["value"] > 0.01


def test_clopper_pearson_and_quantile(code):
    share, quantile = code["measures"].share, code["measures"].quantile
    assert share([False] * 300)["interval"][1] == pytest.approx(0.0122, abs=1e-4)
    assert share([True] * 380 + [False] * 20)["interval"] == pytest.approx([0.924, 0.969], abs=1e-3)
    assert share([])["value"] is None
    low, high = quantile(list(range(100)), 0.5)["interval"]
    assert low == 39 and high == 60


def test_missing_verdict_is_an_error_unless_left_out(code, challenge):
    challenge.add("null")
    (challenge.verdicts / challenge.add("null") / "diagnosis.json").unlink()
    with pytest.raises(FileNotFoundError):
        challenge.results(code)
    assert len(challenge.results(code, answered=True)["cases"]) == 1


def test_tiers_apart_and_answers_checked(code, challenge):
    challenge.add("null")
    challenge.add("null", tier="T2")
    (challenge.set / "hashes.json").write_text(json.dumps({"answers.json": "0" * 64}))
    results = challenge.results(code)
    assert list(results["tiers"]) == ["T1", "T2"]
    assert results["answers_as_published"] is False


def test_bars_side_by_side(code):
    grade, bars = code["measures"], code["bars"]
    metrics = grade.summarize([])["metrics"]
    third = metrics | {
        "false_alarm": grade.share([True] + [False] * 7),
        "heldout_drop_median": {"value": 0.4, "of": 9, "interval": [-0.1, 0.6]},
    }
    sets = [("T1", metrics), ("T3", third)]
    found = [
        {"set": name, "tiers": {name: {"counts": {"null": 8}, "metrics": each}}}
        for name, each in sets
    ]
    section = bars.done(found)
    assert section.lead == "1 of 2 bars are met, 1 missed."
    rows = {row[0]: row[1:] for row in section.blocks[0].rows}
    assert rows["False positives at probability 0.9"][1].startswith("met, 12.5 %\n")
    assert rows["Held-out error removed, median"][1].startswith("MISSED, 40.0 %\n")
    assert rows["Detectable effects flagged"][0] == "–\nbar ≥ 98 %; not measured"


def test_curves_and_page(code, challenge, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    true = [hidden("backlash", "j1", strength=2.0)]
    oracle = {"llr_total": 50.0, "group": ["backlash", "cogging"]}
    right, wrong = entry("backlash", "j1", 0.9), entry("cogging", "j1", 0.6)
    challenge.add("single", true, "explained", [right], oracle=oracle)
    challenge.add("single", true, "explained", [wrong], oracle=oracle)
    challenge.add("single", true, "consistent", oracle=oracle)
    challenge.add("outside", [hidden("jam", "j1")], "unexplained")
    challenge.add("null")
    results = challenge.results(code)
    page, rows = code["page"], results["cases"]
    assert page.confusion(rows)["backlash"] == {"backlash": 1, "cogging": 1, "nothing": 1}
    assert page.confusion(rows)["outside"] == {"unlisted": 1}
    assert page.risk_coverage(rows[:4]) == [(0.25, 1.0), (0.5, 0.5)]
    source, out = tmp_path / "results.json", tmp_path / "page.html"
    source.write_text(json.dumps(results))
    page.main([str(source), "--out", str(out)])
    text = out.read_text()
    assert "MISSED" in text and "not first" in text and "https://" not in text


def test_a_sensor_gain_is_stated_as_its_difference_from_one(code):
    stated = {"parameters": {"gain": {"mean": 0.021, "q05": 0.019, "q95": 0.023}}}
    (found,) = code["grade"]._parameters(stated, {"gain": 1.02})
    assert found["error"] == pytest.approx(0.05) and found["covered"]


def test_of_swims_a_group_of_one_needs_its_component(code, challenge, monkeypatch):
    monkeypatch.setattr(code["grade"], "_swim_held_out", lambda *_: None)
    true = [hidden("skin_damping", "rubber", {"value": 1.0})]
    for said in (
        entry("skin_damping", "abs", 0.95, value=1.0),
        entry("skin_damping", "abs", 0.95, ["form_drag"], value=1.0),
        entry("skin_damping", "rubber", 0.95, value=1.05),
    ):
        challenge.add("single", true, "explained", [said], tier="T4", oracle={"llr_total": 50.0})
    metrics = challenge.results(code)["tiers"]["T4"]["metrics"]
    assert counted(metrics["group_first"]) == (2, 3)
    assert counted(metrics["exact_first"]) == (1, 3)
    assert counted(metrics["parameter_covered"]) == (1, 1)
