import json
import pickle
import re
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
from good_input import ROBOT, message, refused

from sim2real.appendages import Appendage, Sides, area_error
from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.robot import Link, Servo, normalised_density, read_robot, with_density

MORE = """
[[links]]
name = "fin"
com_m = 0
[[joints]]
name = "j2"
servo = "small"
limits_rad = [0, 1]
[servos.small]
max_torque_Nm = 0.5
no_load_speed_rad_s = 9
position_step_rad = 0
"""


def test_fields_of_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    head = 'name = "head"\nmaterial = "abs"\ncom_m = 0.10\ninertia_kgm2 = 0.002'
    path.write_text(ROBOT.replace('name = "head"', head) + MORE)
    robot = read_robot(path)
    assert (robot.name, robot.path) == ("fish", path)
    tail, fin = robot.links[1:]
    assert robot.links[0] == Link("head", 0.5, 0.2, 0.1, 0.1, "abs", 0.1, 0.002)
    assert (tail, fin.name, fin.com_m) == (Link("tail", 0.5, 0.2, 0.1, 0.1), "fin", 0)
    assert [joint.name for joint in robot.joints] == ["j1", "j2"]
    assert robot.joints[0].servo == Servo("lx824", 1.67, 5.24, 0.00419)
    assert robot.joints[1].servo == Servo("small", 0.5, 9, 0)
    assert robot.joints[1].limits_rad == (0, 1)
    assert robot.joint("j2") is robot.joints[1]
    assert robot.joint("j3") is None


BENCH = """
[[joints]]
name = "j1"
servo = "small"
[servos.small]
max_torque_Nm = 0.5
"""


def test_a_bench_states_only_what_is_used(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    assert robot.joints[0].servo.max_torque_Nm == 0.5
    assert robot.name == "robot"  # none is stated
    assert [link.name for link in robot.links] == ["link0", "link1"]
    for use, place in (
        (lambda: robot.links[1].mass_kg, "links[1].mass_kg: found nothing, expected a number"),
        (lambda: robot.joints[0].limits_rad, "joints[0].limits_rad: found nothing, expected two"),
        (lambda: robot.joints[0].servo.position_step_rad, "servos.small.position_step_rad: found"),
    ):
        with pytest.raises(InputError, match=re.escape(f"{path}: {place}")):
            use()


def test_the_type_of_a_servo_is_ignored_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    path.write_text(BENCH + 'type = "xl330"\n')
    with pytest.warns(UserWarning, match=re.escape(f"{path}: servos.small.type is ignored")):
        assert read_robot(path).joints == robot.joints


def test_robots_compare_and_travel(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    assert pickle.loads(pickle.dumps(robot)) == robot
    assert Link("a") != robot.links[0] == Link("link0") != Link("link0", mass_kg=1.0)
    assert repr(robot.links[0]) == "Link(name='link0')"
    assert len({*robot.links, Link("link1")}) == 2
    with pytest.raises(FrozenInstanceError):
        robot.links[0].mass_kg = 1.0


BOX = """[[links.appendages]]
name = "box"
shape = "box"
size_m = [0.12, 0.08, 0.06]
at_m = [0.10, 0.01, 0.03]
"""
ROD = """[[links.appendages]]
name = "rod"
shape = "cylinder"
size_m = [0.2, 0.02]
at_m = [0.05, 0.0, 0.0]
axis = "up"
"""


def written(tmp_path: Path, tables: str) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace("[[joints]]", tables + "[[joints]]", 1))
    return path


def test_boxes_and_cylinders_belong_to_the_link_above(tmp_path: Path) -> None:
    robot = read_robot(written(tmp_path, BOX + ROD))
    box, rod = robot.links[1].appendages
    assert robot.appendages == (box, rod)
    assert (box.size_m, box.at_m) == ((0.12, 0.08, 0.06), (0.10, 0.01, 0.03))
    assert rod.size_m == (0.02, 0.02, 0.2)
    assert "appendages" not in repr(robot.links[0])


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('"box"\nsize', '"ball"\nsize', (".shape", "'ball'", "one of box, cylinder")),
        ("0.08, 0.06", "0.08", (".size_m", "[0.12, 0.08]", "3 lengths in m above 0")),
        ("0.08, 0.06", "0.08, 0", (".size_m", "3 lengths in m above 0: along, across, up")),
        ("0.12, 0.08, 0.06", "120, 80, 60", (".size_m", "millimetres?")),
        ("[0.10, 0.01, 0.03]", "0.1", (".at_m", "0.1", "3 distances in m")),
        ("size_m", "submerged = 1.5\nsize_m", (".submerged", "1.5", "a share from 0 to 1")),
        ("size_m", "drag_coefficient = 1\nsize_m", (".drag_coefficient", "standard deviation")),
        ("size_m", 'axis = "up"\nsize_m', (".axis", "'up'", "no axis of a box")),
        ("size_m", "in_hull = 1\nsize_m", (".in_hull", "1", "true or false")),
        ('name = "box"\n', "", (".name", "nothing", "text")),
        ("size_m", "size_mm", (".size_mm", "mean size_m?")),
    ],
)
def test_a_bad_field_is_one_line(tmp_path, old, new, parts) -> None:
    path = written(tmp_path, BOX.replace(old, new, 1))
    message(lambda: read_robot(path), str(path), "links[1].appendages[0]", *parts)


@pytest.mark.parametrize(
    ("size", "axis", "handbook", "within"),
    [
        ((1e-4, 1.0, 1.0), None, 1.18, 0.01),  # square plate
        ((1e-4, 20.0, 1.0), None, 1.5, 0.01),  # long plate
        ((1.0, 1.0, 1.0), None, 1.05, 0.11),  # cube, Hoerner
        ((4.0, 1.0, 1.0), None, 0.95, 0.01),  # square rod
        ((7.0, 1.0, 1.0), 0, 0.99, 0.01),  # cylinder along the flow
        ((1.0, 1.0, 5.0), 2, 0.74, 0.01),  # cylinder across
    ],
)
def test_drag_coefficients_are_those_of_handbooks(size, axis, handbook, within) -> None:
    value, sd = Sides(size, axis).drag_coefficient(0)
    assert value == pytest.approx(handbook, rel=within)
    assert 0.1 * value < sd < 0.2 * value


@pytest.mark.parametrize(("sides", "handbook"), [(1.0, 0.68), (2.0, 0.36), (5.0, 0.15)])
def test_added_mass_of_square_prisms(sides: float, handbook: float) -> None:
    """The table of DNV-RP-C205 that the factors were not taken from."""
    assert Sides((sides, 1.0, 1.0)).added_mass_m3(0) / sides == pytest.approx(handbook, abs=0.035)


def test_added_mass_of_long_and_flat_bodies() -> None:
    wide = Sides((1.0, 1.0, 1000.0)).added_mass_m3(1)
    assert wide == pytest.approx(1.51 * np.pi / 4 * 1000, rel=0.01)
    disc = Sides((1e-6, 1.0, 1.0), 0).added_mass_m3(0)
    assert disc == pytest.approx(8 / 3 * 0.5**3, rel=0.01)
    assert Sides((1.0, 1.0, 100.0), 2).added_mass_m3(0) == pytest.approx(np.pi / 4 * 100, rel=0.01)


def test_only_what_is_under_water_counts() -> None:
    box = Appendage("box", "box", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    deep, half, dry = (box.wetted(height) for height in (1.0, 0.0, -0.05))
    assert half.volume_m3 == pytest.approx(0.5 * deep.volume_m3)
    assert half.area_m2 == pytest.approx(tuple(a / 2 for a in deep.area_m2))  # mirrored: the cube
    assert half.added_mass_m3 == pytest.approx(tuple(m / 2 for m in deep.added_mass_m3))
    assert dry.volume_m3 == dry.area_m2[0] == dry.added_mass_m3[1] == 0.0


def test_what_the_hull_includes_adds_drag_along_only() -> None:
    line = Appendage("line", "box", (0.3, 0.03, 0.1), (0.0, 0.0, 0.0), in_hull=True)
    wetted = line.wetted(1.0)
    assert wetted.area_m2[0] == pytest.approx(0.95 * 0.003, rel=0.01)
    assert wetted.area_m2[1] == wetted.volume_m3 == sum(wetted.added_mass_m3) == 0.0


def test_the_areas_share_one_error() -> None:
    given = Appendage("box", "box", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), drag=(1.0, 0.1))
    rough = Appendage("plate", "box", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), drag=(1.0, 0.5))
    assert area_error([given.wetted(1.0), rough.wetted(1.0)]) == pytest.approx(0.3)
    assert area_error([]) == 0.0


FISH = Path(__file__).parents[1] / "datasets" / "servo_steps" / "robot.toml"


@pytest.fixture(scope="module")
def robot():
    return read_robot(FISH)


@pytest.fixture
def weighed(tmp_path):
    """The robot's file, two of its links with errors."""
    text = FISH.read_text()
    text = text.replace("mass_kg = 0.52", "mass_kg = 0.52\nmass_sd_kg = 0.01")
    text = text.replace("length_m = 0.10", "length_m = 0.10\nlength_sd_m = 0.002", 1)
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def test_units_do_not_matter(robot):
    scaled = replace(
        robot,
        links=tuple(
            replace(x, mass_kg=3 * x.mass_kg, length_m=0.1 * x.length_m) for x in robot.links
        ),
    )
    a, b = normalised_density(robot).value, normalised_density(scaled).value
    np.testing.assert_allclose(a, b)
    assert normalised_density(robot).sd is normalised_density(robot).interval is None


def test_uncertainty_is_that_of_weighing_again(weighed):
    robot = read_robot(weighed)
    rng = np.random.default_rng(0)
    values = []
    for _ in range(4000):
        links = []
        for x in robot.links:
            mass = x.mass_kg + (x.mass_sd_kg or 0) * rng.standard_normal()
            length = x.length_m + (x.length_sd_m or 0) * rng.standard_normal()
            links.append(replace(x, mass_kg=mass, length_m=length))
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
    refused(capsys, main(["density", str(FISH), "--model", "model.json"]), "--out")
    refused(capsys, main(["density", str(FISH), "--out", str(tmp_path / "x.json")]), "--model")
    assert not list(tmp_path.iterdir())


def test_an_error_below_nothing_is_refused(tmp_path, capsys):
    path = tmp_path / "robot.toml"
    path.write_text(FISH.read_text().replace("mass_kg = 0.52", "mass_kg = 0.52\nmass_sd_kg = -1"))
    refused(capsys, main(["density", str(path)]), "links[0].mass_sd_kg")
