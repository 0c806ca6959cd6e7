"""Diagnosis of swims that the twin itself made: what was concealed is named, and nothing else."""

import json

import numpy as np
import pytest
from swimming_robots import FISH, servos
from test_calibrate import swum

import sim.inference.diagnose_swims as rooms
from sim.inference.parameters import effect_parameters
from sim.inference.problem import seen
from sim.inference.swims import by_twin
from sim2real.cli import main


@pytest.fixture
def few(monkeypatch):
    """A few candidates, so that the test takes seconds."""
    names = ("camera_latency", "skin_elasticity", "pool_current")
    listed = [(name, "body", tuple(effect_parameters(name))) for name in names]
    monkeypatch.setattr(rooms, "candidates", lambda robot: listed)
    monkeypatch.setattr(rooms, "MOST", 1)


def test_what_was_concealed_is_named(few):
    swims = [swum({"skin_elasticity.stiffness_Nm_per_rad": 0.6})]
    found = rooms.diagnose_swims(swims, servos(), FISH, by_twin(FISH))
    assert [one.effect for one in found.effects] == ["skin_elasticity"]
    (named,) = found.effects
    assert named.probability > 0.9
    assert named.parameters["stiffness_Nm_per_rad"].mean == pytest.approx(0.6, rel=0.05)
    assert named.heldout["rmse_after"] < named.heldout["rmse_before"]
    assert "spring" in named.statement


def test_a_swim_with_nothing_missing_is_consistent(few):
    found = rooms.diagnose_swims([swum({})], servos(), FISH, by_twin(FISH))
    assert found.verdict == "consistent"
    assert not found.effects
    assert all(np.isfinite(rival.probability) for rival in found.rivals)


def test_what_a_reference_shows_too_is_not_named(few):
    swim, other = ({"skin_elasticity.stiffness_Nm_per_rad": 0.6} for _ in range(2))
    given = [swum(swim)], servos(), FISH, by_twin(FISH)
    found = rooms.diagnose_swims(*given, references=[swum(other, seed=1)])
    assert found.verdict == "consistent"
    assert rooms.diagnose_swims(*given, references=[swum({}, seed=1)]).verdict == "explained"


def test_a_mean_over_two_seconds_stands_beside_the_signals():
    t = np.arange(600) * 0.02
    signals = np.stack([np.sin(2 * np.pi * t), 0.01 * t, 0 * t, t, t, t], axis=1)
    both = seen(signals[None])[0]
    assert both.shape == (600, 9)
    assert (both[:, :6] == signals).all()
    assert np.abs(both[50:-50, 6]).max() < 0.02
    assert both[50:-50, 7] == pytest.approx(signals[50:-50, 1], abs=2e-4)


def test_swims_need_a_model_and_no_bench_beside_them(tmp_path, capsys):
    robot = ["--robot", "datasets/pool/robot.toml", "--out", str(tmp_path / "d.json")]
    assert main(["diagnose", "datasets/pool/p1.csv", *robot]) == 2
    assert "MODEL.json of the servos" in capsys.readouterr().err
    model = ["--model", "datasets/pool/model.json"]
    both = ["datasets/pool/p1.csv", "datasets/servo_steps/steps.csv"]
    assert main(["diagnose", *both, *robot, *model]) == 2
    assert "swims alone, or servos alone" in capsys.readouterr().err
    assert not (tmp_path / "d.json").exists()


def test_the_command_writes_what_the_format_says(few, tmp_path):
    out = tmp_path / "d.json"
    given = ["datasets/pool/p1.csv", "--robot", "datasets/pool/robot.toml"]
    assert main(["diagnose", *given, "--model", "datasets/pool/model.json", "--out", str(out)]) == 0
    content = json.loads(out.read_text())
    assert content["schema"] == "sim2real.diagnosis/1"
    assert content["effects"][0]["effect"] == "skin_elasticity"  # the nearest of the few
    assert (tmp_path / content["model"]).exists()
    assert content["provenance"]["seed"] is None  # nothing is drawn at random
    page = out.with_suffix(".html")
    assert "skin over the joints is a spring" in page.read_text()
    page.unlink()
    assert main(["diagnose", *given, "--model", "datasets/pool/model.json", "--out", str(out),
                 "--no-page"]) == 0  # fmt: skip
    assert not page.exists()
    assert json.loads(out.read_text())["effects"] == content["effects"]
