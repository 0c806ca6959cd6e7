"""Appendages in ``robot.toml``: their fields, and the handbook figures that follow from them."""

from pathlib import Path

import numpy as np
import pytest
from good_input import ROBOT, message

from sim2real.appendages import Appendage, Sides, area_error
from sim2real.robot import read_robot

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
