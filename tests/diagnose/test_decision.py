"""Every number that decides: complete, with what it was read from; and the reading recovers it."""

import importlib
import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from sim2real.diagnose.decision import CURVES, FILE, read_decision, read_odds
from sim2real.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.calibrate_decisions")


@pytest.fixture
def curves(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.decision_curves")


def names_of(decision, group=""):
    for field in fields(decision):
        value, name = getattr(decision, field.name), group + field.name
        yield from names_of(value, f"{name}.") if is_dataclass(value) else [name]


def test_every_number_says_what_it_was_read_from():
    values = json.loads(FILE.read_text())["values"]
    assert set(values) == set(names_of(read_decision()))
    assert all(entry["from"] for entry in values.values())


def test_a_number_of_a_group_is_read_and_has_its_type(tmp_path):
    content = json.loads(FILE.read_text())
    content["values"]["change.same_command"]["value"] = 0.125
    content["values"]["report.most_rivals"]["value"] = 3
    file = tmp_path / "decision.json"
    file.write_text(json.dumps(content))
    found = read_decision(file)
    assert found.change.same_command == 0.125
    assert [*range(9)][: found.report.most_rivals] == [0, 1, 2]
    del content["values"]["link.min_gain"]
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


def test_a_logistic_curve_comes_back(curves):
    rng = np.random.default_rng(0)
    x = np.stack([np.ones(4000), rng.normal(0, 2, 4000)], axis=1)
    y = (rng.random(4000) < 1 / (1 + np.exp(-(-1 + 0.8 * x[:, 1])))).astype(float)
    assert curves.logistic(x, y, 2.4) == pytest.approx([-1, 0.8], abs=0.15)


def test_few_cases_change_nothing(script, tmp_path, monkeypatch):
    (tmp_path / "sim2real" / "diagnose").mkdir(parents=True)
    (tmp_path / "reports").mkdir()
    target = tmp_path / "sim2real" / "diagnose" / "decision.json"
    target.write_text(FILE.read_text())
    monkeypatch.setattr(script, "ROOT", tmp_path)
    script.write([row()], dry=False, measures=True)
    assert read_decision(target) == read_decision()
    assert read_odds(target) == read_odds()
    script.write([row(case=str(k), excess_plain=1.2) for k in range(60)], dry=False, measures=True)
    assert read_decision(target).structured_excess == pytest.approx(1.2)
    report = json.loads((tmp_path / "reports" / "decisions.json").read_text())
    assert report["values"]["structured_excess"]["count"] == 60
    assert set(report["odds"]) == set(CURVES)


def test_the_detection_gain_is_that_from_which_most_are_named(script):
    """An eighth of those below are named by chance, and as many of those above are not."""
    rows = []
    for k in range(200):
        gain = 0.2 * k
        named = (gain > 15) != (k % 8 == 0)
        said = [[["backlash"], 0.9 if named else 0.1]]
        more = {"kind": "single", "truth": ["backlash"], "said": said, "alone": {"backlash": gain}}
        rows.append(row(case=str(k), **more))
    assert script.values_of(rows)["detection_gain"][0] == pytest.approx(15, abs=1.0)
