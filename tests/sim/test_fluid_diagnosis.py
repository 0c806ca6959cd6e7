"""The search of the fluid, with the twin in its place: what was concealed is named."""

import json
from dataclasses import replace

import pytest
from swimming_robots import FISH, servos
from test_calibrate import swum
from test_fluid_calibration import NOISE

import sim.inference.fluid_diagnosis as rooms
from sim.inference.parameters import effect_parameters, water_parameters
from sim.inference.swims import by_twin, with_values
from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.inference.parameters import Gaussian

WATER = water_parameters(FISH, 0.01)
USUAL = Gaussian.of(WATER)
KNOWN = Gaussian(USUAL.mean, 0.01 * USUAL.covariance)
START = with_values(servos(), {p.name: p.nominal for p in WATER})


@pytest.fixture
def few(monkeypatch):
    """A few candidates, so that the test takes seconds."""
    listed = [("camera_latency", "camera", tuple(effect_parameters("camera_latency")))]
    for name in ("skin_elasticity", "pool_current", "linear_drag"):
        listed.append((name, "body", tuple(effect_parameters(name))))
    monkeypatch.setattr(rooms, "candidates", lambda robot: listed)
    return {one.name: one for one in rooms.effects_of(FISH)}


def diagnosed(truth, claimed=(), start=START):
    swim, twin = replace(swum(truth), noise=NOISE), by_twin(FISH)
    batches = rooms.swim_batches(swim, start, FISH, twin, WATER, claimed, count=40)
    return rooms.diagnose_in_fluid([batches], start, FISH, twin, WATER, KNOWN, claimed)


def test_what_was_concealed_is_named(few):
    found = diagnosed({"pool_current.u_m_s": 0.04, "pool_current.v_m_s": -0.03})
    assert [one.effect for one in found.effects] == ["pool_current"]
    (named,) = found.effects
    assert named.probability > 0.9
    assert named.parameters["u_m_s"].mean == pytest.approx(0.04, abs=0.01)
    assert named.heldout["rmse_after"] < 0.6 * named.heldout["rmse_before"]
    assert found.verdict == "explained"


def test_a_swim_with_nothing_missing_is_consistent(few):
    found = diagnosed({})
    assert found.verdict == "consistent"
    assert not found.effects
    assert found.enriched_fit == found.baseline_fit


def test_what_the_twin_named_stands_or_falls(few):
    skin = few["skin_elasticity"]
    centre = with_values(START, {skin.free[0].name: 0.5})
    stands = diagnosed({skin.free[0].name: 0.6}, [skin], centre)
    assert [one.effect for one in stands.effects] == ["skin_elasticity"]
    assert stands.effects[0].parameters["stiffness_Nm_per_rad"].mean == pytest.approx(0.6, rel=0.1)
    falls = diagnosed({}, [skin], with_values(START, {skin.free[0].name: 0.15}))
    assert not falls.effects


def test_more_of_what_the_water_has_is_told_against_the_swim_without(few):
    found = diagnosed({"linear_drag.coefficient": 1.0})
    (named,) = found.effects
    assert named.effect == "linear_drag"
    assert named.parameters["coefficient"].mean == pytest.approx(1.0, rel=0.3)


def test_the_water_comes_from_a_calibration_in_the_fluid(tmp_path, capsys):
    path = tmp_path / "plain.json"
    path.write_text('{"schema": "sim2real.model/1", "joints": {}}')
    with pytest.raises(
        InputError, match="body.posterior: found none, expected .* calibrate --fluid"
    ):
        rooms.read_water(path, FISH, 0.01)
    posterior = {
        "cell_m": 0.01, "names": [p.name for p in WATER], "mean": list(KNOWN.mean),
        "covariance": [list(row) for row in KNOWN.covariance],
    }  # fmt: skip
    content = {"schema": "sim2real.model/1", "joints": {}, "body": {"posterior": posterior}}
    path.write_text(json.dumps(content))
    _, prior = rooms.read_water(path, FISH, 0.01)
    assert prior.mean == pytest.approx(KNOWN.mean)
    with pytest.raises(InputError, match="cell_m: found 0.01 m, expected 0.02 m"):
        posterior["names"][-1] = WATER[-1].name
        rooms.read_water(path, FISH, 0.02)
    given = ["datasets/pool/p1.csv", "--robot", "datasets/pool/robot.toml"]
    given += ["--model", "datasets/pool/model.json", "--out", str(tmp_path / "d.json")]
    assert main(["diagnose", *given, "--water", "datasets/pool/model.json"]) == 2
    assert "as calibrate --fluid finds it" in capsys.readouterr().err
    bench = ["datasets/servo_steps/steps.csv", *given[1:]]
    assert main(["diagnose", *bench, "--water", str(path)]) == 2
    assert "recordings of a bench, expected swims in a pool" in capsys.readouterr().err
    assert not (tmp_path / "d.json").exists()


def test_the_fluids_water_is_written_by_the_command(tmp_path, capsys):
    """In cells too coarse to mean anything, for a second of swimming."""
    short = tmp_path / "short.csv"
    with open("datasets/pool/clean.csv") as whole:
        short.write_text("".join(line for line, _ in zip(whole, range(41), strict=False)))
    with open("datasets/pool/clean.json") as beside:
        (tmp_path / "short.json").write_text(beside.read())
    given = [str(short), "--robot", "datasets/pool/robot.toml", "--cell-m", "0.04"]
    given += ["--model", "datasets/pool/model.json", "--rollouts", "14"]
    water = tmp_path / "water.json"
    assert main(["calibrate", *given, "--fluid", "--no-plots", "--out", str(water)]) == 0
    posterior = json.loads(water.read_text())["body"]["posterior"]
    assert posterior["cell_m"] == 0.04
    assert "water.viscosity_m2_s" in posterior["names"]
    assert "beyond the noise of" in capsys.readouterr().out
