"""Plates and foils along which water slips: their references, geometry and quick figures."""

import numpy as np
import pytest

from sim.cases import foil, plate
from sim.cases.walls import WALLS


@pytest.mark.parametrize(
    ("k", "thrust", "power"), [(2.0, 0.047, 0.123), (3.0, 0.124, 0.277), (4.0, 0.232, 0.493)]
)
def test_a_thin_foil_has_garricks_thrust_and_power(k, thrust, power):
    assert foil.garrick(k) == pytest.approx((thrust, power), abs=5e-4)


def test_the_wake_takes_some_of_the_foils_power():
    for k in np.geomspace(0.05, 50, 20):
        thrust, power = foil.garrick(k)
        assert thrust < power


def test_a_section_is_as_thick_as_its_digits_say():
    hull, nose = foil.section(0.4, 0.21)
    assert 2 * hull.half_width.max() == pytest.approx(0.21 * 0.4, rel=0.01)
    assert nose + hull.length.sum() == pytest.approx(0.995 * 0.4)
    assert hull.half_width[1:, 0] == pytest.approx(hull.half_width[:-1, 2])


def test_a_pitching_foil_has_thrust_and_takes_power():
    where = {"lengths": 1.0, "threads": 1}
    rest, _ = foil.coefficients(12, 0.12, WALLS["ghost cells"], **where)
    drag, _ = foil.coefficients(12, 0.12, WALLS["ghost cells"], k=3.0, **where)
    thrust, _ = foil.garrick(3.0)
    assert 0.4 * thrust < rest - drag < 1.2 * thrust
    small = {"k": 3.0, "pitch_rad": 0.04}  # the power of larger amplitudes is not linear theory's
    _, power = foil.coefficients(12, 0.12, WALLS["ghost cells"], **small, **where)
    _, needed = foil.garrick(small["k"], small["pitch_rad"])
    assert power == pytest.approx(needed, rel=0.3)


def test_quick_cases_have_both_walls_and_no_bars():
    for case in (foil.run(quick=True), plate.run(quick=True)):
        assert all(np.isfinite(figure.ours) for figure in case.figures)
        assert all(figure.bar is None for figure in case.figures)
        names = [figure.quantity for figure in case.figures]
        assert [sum(wall in name for name in names) for wall in WALLS] == [len(names) // 2] * 2


def test_a_plate_that_moves_on_has_the_pressure_drag_of_a_blunt_body():
    """Three sides of way: far above that of a streamlined body, of the order of Hoerner's."""
    moved, found = plate.drag(6, WALLS["ghost cells"], lengths=3.0)
    assert found[moved > 1.5].mean() == pytest.approx(plate.SQUARE, rel=0.5)


def test_on_a_gpu_only_ghost_cells_are_judged(monkeypatch):
    monkeypatch.setattr(foil, "coefficients", lambda *_, **__: (0.0, 0.0))
    monkeypatch.setattr(plate, "drag", lambda *_, **__: (np.linspace(0, 10, 300), np.ones(300)))
    judged = [f for f in foil.run(device="cuda:0").figures if f.bar is not None]
    assert [f.bar for f in judged] == [0.3] * 3 + [0.15] * 3
    assert all(f.quantity.startswith("thrust") and "ghost cells" in f.quantity for f in judged)
    squares = [f for f in plate.run(device="cuda:0").figures if f.bar is not None]
    assert [f.bar for f in squares] == [0.1] * 6
    assert all("square" in f.quantity and "ghost cells" in f.quantity for f in squares)
