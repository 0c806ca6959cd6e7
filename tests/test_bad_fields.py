"""Fields of a robot or a model that can't be used are refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from good_input import MODEL, ROBOT, message

from sim2real.model import read_model
from sim2real.robot import read_robot


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("[[links]]", "[links", ("line 3, column 7", "no TOML")),
        ('name = "tail"', 'name = "tail" "', ("line 10, column 15", "no TOML")),
        ('servo = "lx824"', 'servo = "lx16"', ("joints[0].servo", "'lx16'", "lx824")),
        ('servo = "lx824"', "", ("joints[0].servo", "nothing", "text")),
        ("[-0.8, 0.8]", "[0.8, -0.8]", ("joints[0].limits_rad", "smaller first")),
        ("[-0.8, 0.8]", "[nan, 0.8]", ("joints[0].limits_rad", "[nan, 0.8]", "two angles")),
        ("[-0.8, 0.8]", "[-inf, 0.8]", ("joints[0].limits_rad", "[-inf, 0.8]", "two angles")),
        ("[-0.8, 0.8]", "[false, true]", ("joints[0].limits_rad", "two angles")),
        ("[-0.8, 0.8]", "0.8", ("joints[0].limits_rad", "0.8", "two angles")),
        ("[-0.8, 0.8]", f"[0, {10**400}]", ("joints[0].limits_rad", "two angles")),
        ("[-0.8, 0.8]", f"[0, 1{'0' * 5000}]", ("no TOML", "digits")),
        ("[-0.8, 0.8]", "[" * 100_000, ("no TOML", "nested")),
        ("mass_kg = 0.5", "mass_kg = -0.5", ("links[0].mass_kg", "-0.5", "above 0")),
        ("mass_kg = 0.5", 'mass_kg = "0.5"', ("links[0].mass_kg", "'0.5'", "a number")),
        ("mass_kg = 0.5", "mass_kg = 2026-01-01", ("links[0].mass_kg", "2026", "a number")),
        ("mass_kg = 0.5", "mass_kg = 1e300", ("links[0].mass_kg", "1e+300", "to 1e+06 kg")),
        ("mass_kg = 0.5", "mass_kg = 1e-300", ("links[0].mass_kg", "1e-300", "from 1e-09")),
        ("mass_kg = 0.5", "mass_kg = 0.5\ncom_m = 0.21", ("links[0].com_m", "0.21", "0.2 m")),
        (
            "mass_kg = 0.5",
            "mass_kg = 0.5\ninertia_kgm2 = 1e300",
            ("links[0].inertia_kgm2", "kg m²"),
        ),
        ("= 5.24", "= 1e300", ("servos.lx824.no_load_speed_rad_s", "1e+300", "rad/s")),
        ("max_torque_Nm = 1.67", "max_torque_Nm = 0", ("servos.lx824.max_torque_Nm", "above 0")),
        ("[servos.lx824]", "[[servos.lx824]]", ("servos.lx824", "a table")),
        ("[servos.lx824]", "[servo.lx824]", ("servo", "an unknown key", "did you mean servos?")),
    ],
)
def test_robot_fields(tmp_path: Path, old: str, new: str, parts: tuple[str, ...]) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace(old, new, 1))
    message(lambda: read_robot(path), str(path), *parts)


def test_robot_counts(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    joint = '[[joints]]\nname = "j1"\nservo = "lx824"\nlimits_rad = [-1, 1]\n'
    link = '[[links]]\nname = "fin"\nmass_kg = 1\nlength_m = 1\nwidth_m = 1\nheight_m = 1\n'
    path.write_text(ROBOT + joint)
    message(lambda: read_robot(path), "links", "2 links and 2 joints", "one link more")
    path.write_text(ROBOT + link)
    message(lambda: read_robot(path), "links", "3 links and 1 joints", "one link more")
    path.write_text(ROBOT + joint + link)
    message(lambda: read_robot(path), "joints", "j1, j1", "each name once")
    path.write_text('name = "fish"')
    message(lambda: read_robot(path), "joints", "nothing", "at least one [[joints]]")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"kp_Nm_per_rad": -1}, ("joints.j1.kp_Nm_per_rad", "-1", "at least 0")),
        ({"latency_s": None}, ("joints.j1.latency_s", "None", "a number")),
        ({"latency_s": 1e9}, ("joints.j1.latency_s", "1000000000.0", "s")),
        ({"inertia_kgm2": 1e-300}, ("joints.j1.inertia_kgm2", "1e-300", "from 1e-12")),
        ({"kp_Nm_per_rad": 1e300}, ("joints.j1.kp_Nm_per_rad", "1e+300", "N m/rad")),
        ({"inertia_kgm2": 0}, ("joints.j1.inertia_kgm2", "0", "above 0")),
        ({"interval": {"kp": [1, 2, 3]}}, ("joints.j1.interval.kp", "two numbers")),
        ({"interval": {"kp": [2, 1]}}, ("joints.j1.interval.kp", "smaller first")),
        ({"interval": {"kp": [True, "x"]}}, ("joints.j1.interval.kp", "two numbers")),
        ({"interval": 3}, ("joints.j1.interval", "3", "a table")),
        ({"effects": "backlash"}, ("joints.j1.effects", "'backlash'")),
        ({"effects": [{"effect": 3}]}, ("joints.j1.effects[0].effect", "3", "text")),
        (
            {"effects": [{"effect": "backlash", "parameters": {"gap_rad": "wide"}}]},
            ("joints.j1.effects[0].parameters.gap_rad", "'wide'", "a number"),
        ),
        (
            {"effects": [{"effect": "backlash", "parameters": {"gap_rad": 1e300}}]},
            ("joints.j1.effects[0].parameters.gap_rad", "1e+300", "rad"),
        ),
        (
            {"law": "motor", "motor": {"loop_period_s": 1e-9}},
            ("joints.j1.motor.loop_period_s", "1e-09", "0 or at least 2e-05 s"),
        ),
        ({"notes": 5}, ("joints.j1.notes", "5", "a list")),
        ({"correlation": {"kp, kd": "high"}}, ("joints.j1.correlation.kp, kd", "'high'")),
        ({"per_inertia": "yes"}, ("joints.j1.per_inertia", "'yes'", "true or false")),
        ({"load": {"inertia_kgm2": -1}}, ("joints.j1.load.inertia_kgm2", "-1", "above 0")),
    ],
)
def test_model_joint(tmp_path: Path, change: dict[str, Any], parts: tuple[str, ...]) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(MODEL | {"joints": {"j1": MODEL["joints"]["j1"] | change}}))
    message(lambda: read_model(path), str(path), *parts)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"schema": "sim2real.recording/1"}, ("schema", "recording/1'", "model/1'")),
        ({"joints": []}, ("joints", "[]", "a table")),
        ({"fit": {"j1.position_rad": 3}}, ("fit.j1.position_rad", "3", "a table")),
        ({"fit": {"j1.position_rad": {"train": "low"}}}, ("fit.j1.position_rad.train", "'low'")),
        ({"body": {"twin": 3}}, ("body.twin", "3", "a table")),
        ({"body": {"twin": {"across": 10**400}}}, ("body.twin.across", "a number")),
        ({"body": {"water": {"viscosity_m2_s": "thick"}}}, ("body.water.viscosity_m2_s", "thick")),
        ({"body": {"seems": {"error.surge_0": None}}}, ("body.seems.error.surge_0", "None")),
        ({"body": {"normalised_density": [1.0, 0]}}, ("body.normalised_density", "one for each")),
        ({"body": {"normalised_density_sd": 0.1}}, ("body.normalised_density_sd", "0.1")),
        ({"body": {"interval": {"twin.across": [1]}}}, ("body.interval.twin.across", "two")),
        ({"body": {"effects": [3]}}, ("body.effects[0]", "3", "a table")),
        ({"body": {"posterior": {"names": ["a"], "mean": []}}}, ("body.posterior.mean", "1 num")),
        (
            {"body": {"posterior": {"names": ["a"], "mean": [1], "covariance": [[1, 2]]}}},
            ("body.posterior.covariance", "1 rows"),
        ),
    ],
)
def test_model_fields(tmp_path: Path, change: dict[str, Any], parts: tuple[str, ...]) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(MODEL | change))
    message(lambda: read_model(path), str(path), *parts)
