"""Normalised density: the paper's formula, its uncertainty, its command."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim2real.cli import main
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.robot import normalised_density, read_robot, with_density

ROBOT = Path(__file__).parents[1] / "datasets" / "servo_steps" / "robot.toml"


@pytest.fixture(scope="module")
def robot():
    return read_robot(ROBOT)


@pytest.fixture
def weighed(tmp_path):
    """The robot's file, two of its links with errors."""
    text = ROBOT.read_text()
    text = text.replace("mass_kg = 0.52", "mass_kg = 0.52\nmass_sd_kg = 0.01")
    text = text.replace("length_m = 0.10", "length_m = 0.10\nlength_sd_m = 0.002", 1)
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_formula(robot):
    found = normalised_density(robot)
    assert found.value[0] == pytest.approx(0.52 / 0.20 * 0.52 / 1.10)
    assert found.sd is None and found.interval is None


def test_units_do_not_matter(robot):
    scaled = replace(
        robot,
        links=tuple(
            replace(x, mass_kg=3 * x.mass_kg, length_m=0.1 * x.length_m) for x in robot.links
        ),
    )
    a, b = normalised_density(robot).value, normalised_density(scaled).value
    np.testing.assert_allclose(a, b)


def test_uncertainty_is_that_of_weighing_again(weighed):
    robot = read_robot(weighed)
    rng = np.random.default_rng(0)
    values = []
    for _ in range(4000):
        links = [
            replace(
                x,
                mass_kg=x.mass_kg + (x.mass_sd_kg or 0) * rng.standard_normal(),
                length_m=x.length_m + (x.length_sd_m or 0) * rng.standard_normal(),
            )
            for x in robot.links
        ]
        values.append(normalised_density(replace(robot, links=tuple(links))).value)
    np.testing.assert_allclose(normalised_density(robot).sd, np.std(values, axis=0), rtol=0.06)


def test_into_the_model(weighed):
    body = {"effects": [], "normalised_density": [9.0]}
    found = normalised_density(read_robot(weighed))
    model = with_density(Model({}, body), found)
    assert model.body["normalised_density"] == [float(x) for x in found.value]
    assert len(model.body["normalised_density_sd"]) == 4 and model.body["effects"] == []


def test_command(weighed, tmp_path, capsys):
    model, out, png = (tmp_path / name for name in ("model.json", "out.json", "density.png"))
    write_model(Model({"j1": JointModel(2.0, 0.05, 0.06, 0.002)}), model)
    arguments = ["density", str(weighed), "--model", str(model), "--out", str(out)]
    assert main([*arguments, "--plot", str(png)]) == 0
    table = capsys.readouterr().out
    assert "head" in table and "1.229" in table and " to " in table
    assert read_model(out).body["normalised_density"][0] == pytest.approx(1.2291, abs=1e-4)
    assert json.loads(out.read_text())["joints"]["j1"]["kp_Nm_per_rad"] == 2.0
    assert png.read_bytes().startswith(b"\x89PNG")


def test_a_model_needs_a_place_to_go(capsys, tmp_path):
    assert main(["density", str(ROBOT), "--model", "model.json"]) == 2
    assert "--out" in capsys.readouterr().err
    assert main(["density", str(ROBOT), "--out", str(tmp_path / "x.json")]) == 2
    assert not list(tmp_path.iterdir())


def test_an_error_below_nothing_is_refused(tmp_path, capsys):
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.read_text().replace("mass_kg = 0.52", "mass_kg = 0.52\nmass_sd_kg = -1"))
    assert main(["density", str(path)]) == 2
    assert "links[0].mass_sd_kg" in capsys.readouterr().err
