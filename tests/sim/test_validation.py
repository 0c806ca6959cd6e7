"""Published cases: their references, geometry and quick figures, and the program that runs them."""

import json

import pytest

from benchmarks.validation import slender, swimmers
from benchmarks.validation.__main__ import main
from benchmarks.validation.case import Where


@pytest.mark.parametrize(
    ("k", "thrust", "power"), [(2.0, 0.047, 0.123), (3.0, 0.124, 0.277), (4.0, 0.232, 0.493)]
)
def test_a_thin_foil_has_garricks_thrust_and_power(k, thrust, power):
    assert swimmers.garrick(k) == pytest.approx((thrust, power), abs=5e-4)


def test_a_section_is_as_thick_as_its_digits_say():
    hull, nose = swimmers.section(0.4, 0.21)
    assert 2 * hull.half_width.max() == pytest.approx(0.21 * 0.4, rel=0.01)
    assert nose + hull.length.sum() == pytest.approx(0.995 * 0.4)
    assert hull.half_width[1:, 0] == pytest.approx(hull.half_width[:-1, 2])


def test_a_pitching_foil_has_thrust_and_takes_power():
    rest, _ = swimmers.coefficients(12, lengths=1.0)
    drag, _ = swimmers.coefficients(12, k=3.0, lengths=1.0)
    thrust, _ = swimmers.garrick(3.0)
    assert 0.4 * thrust < rest - drag < 1.2 * thrust
    small = {"k": 3.0, "pitch_rad": 0.04}  # the power of larger amplitudes is not linear theory's
    _, power = swimmers.coefficients(12, **small, lengths=1.0)
    _, needed = swimmers.garrick(small["k"], small["pitch_rad"])
    assert power == pytest.approx(needed, rel=0.3)


def test_a_plate_that_moves_on_has_the_pressure_drag_of_a_blunt_body():
    """Three sides of way: far above that of a streamlined body, of the order of Hoerner's."""
    moved, found = slender.plate_drag(6, lengths=3.0)
    assert found[moved > 1.5].mean() == pytest.approx(slender.SQUARE, rel=0.5)


def test_references_of_spheroids_are_the_published_ones():
    """Lamb's table for a fineness of 6.01, end-on and broadside."""
    assert slender.carried(6.01) == pytest.approx((0.045, 0.918), abs=1e-3)
    assert slender.slipping() == pytest.approx(1.0572, abs=1e-4)
    assert slender.slipping(1e3) == pytest.approx(1.0, abs=1e-3)  # a needle is a plate
    assert slender.plate_friction(1e7) == pytest.approx(0.003, rel=1e-9)


def test_a_slipping_spheroid_carries_the_water_that_lamb_says(monkeypatch):
    """After one period of shaking; towed a tenth of its length, as friction has no bar."""
    monkeypatch.setattr(slender, "_PERIODS", 1)
    monkeypatch.setattr(slender, "_LENGTHS", 0.1)
    case = slender.spheroid(Where(quick=True))
    mass = case.figures[0]
    assert mass.reference == pytest.approx(1.0452, abs=1e-4)
    assert mass.met, mass
    assert all(figure.bar is None for figure in case.figures[1:])


def test_the_program_prints_figures_and_writes_a_page(tmp_path, capsys):
    page = tmp_path / "validation.html"
    assert main(["--quick", "--only", "taylor_green", "--out", str(page)]) == 0
    printed = capsys.readouterr().out
    assert "order of convergence" in printed and "met" in printed
    assert "order of convergence" in page.read_text()
    case = json.loads(page.with_suffix(".json").read_text())["cases"][0]
    assert case["name"] == "taylor_green"
