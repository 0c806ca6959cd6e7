"""Every number that decides: complete, with what it was read from; and the reading recovers it."""

import importlib.util
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from sim2real.diagnose.decision import FILE, Decision, read_decision
from sim2real.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def script():
    path = ROOT / "benchmarks" / "calibrate_decisions.py"
    spec = importlib.util.spec_from_file_location("calibrate_decisions", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_number_says_what_it_was_read_from():
    values = json.loads(FILE.read_text())["values"]
    assert set(values) == {field.name for field in fields(Decision)}
    assert all(entry["from"] for entry in values.values())


def test_a_number_that_is_missing_is_told(tmp_path):
    content = json.loads(FILE.read_text())
    del content["values"]["structured"]
    file = tmp_path / "decision.json"
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"values\.structured\.value"):
        read_decision(file)


def row(**more):
    usual = {
        "case": 0, "kind": "null", "joint": "j1", "truth": [], "outside": False,
        "excess_plain": 1.0, "excess": 1.0, "lead": -20.0, "own": 0.0, "step": 1.0, "groups": [],
        "link": [{"effect": "packet_loss", "gain": 0.0, "share": 0.0}] * 2,
    }  # fmt: skip
    return usual | more


def test_a_quantile_is_that_of_what_misses_nothing(script):
    rng = np.random.default_rng(0)
    rows = [row(case=k, excess_plain=1 + 0.1 * rng.random()) for k in range(400)]
    rows += [row(case=k, kind="outside", outside=True, excess_plain=50.0) for k in range(50)]
    value, count, _, curve = script.readings(rows)["structured"]
    assert count == 400
    assert value == pytest.approx(1.1, abs=0.003)
    assert np.all(np.diff(curve["value"]) >= 0)


def test_a_threshold_divides_two_kinds(script):
    rng = np.random.default_rng(0)
    value, count, *_ = script.divide(rng.normal(0, 1, 500), rng.normal(4, 1, 300), "")
    assert count == 300
    assert value == pytest.approx(2.0, abs=0.4)


def test_a_logistic_curve_comes_back(script):
    rng = np.random.default_rng(0)
    lead = rng.uniform(-60, 80, 3000)
    outside = rng.random(3000) < 1 / (1 + np.exp(-(lead - 10) / 5))
    cost, softness = script._logistic(lead, outside)
    assert cost[0] == pytest.approx(10, abs=2)
    assert softness[0] == pytest.approx(5, rel=0.2)


def test_frequencies_count_what_was_there(script):
    group = {"members": ["backlash"], "p": 0.99, "size": None}
    rows = [
        row(
            case=k, kind="single", truth=["backlash" if k % 4 else "deadband"], groups=[dict(group)]
        )
        for k in range(200)
    ]
    value, count, *_ = script.readings(rows)["most_certain"]
    assert count == 200
    assert value == pytest.approx(0.75, abs=0.01)


def test_few_cases_change_nothing(script, tmp_path, monkeypatch):
    (tmp_path / "sim2real" / "diagnose").mkdir(parents=True)
    (tmp_path / "reports").mkdir()
    target = tmp_path / "sim2real" / "diagnose" / "decision.json"
    target.write_text(FILE.read_text())
    monkeypatch.setattr(script, "ROOT", tmp_path)
    script.write([row()])
    assert read_decision(target) == read_decision()
    script.write([row(case=k, excess_plain=1.2) for k in range(60)])
    assert read_decision(target).structured == pytest.approx(1.2)
    report = json.loads((tmp_path / "reports" / "decisions.json").read_text())
    assert report["readings"]["structured"]["count"] == 60
