"""A mackerel with a prescribed wave: its shape, its motion and the balance of its forces."""

import numpy as np
import pytest

from sim.cases import mackerel
from sim.cases.walls import WALLS


def test_the_wave_is_the_published_one():
    s = np.linspace(0, 1, 201)
    sizes = np.max([np.abs(mackerel.deflection(s, 2 + t)) for t in np.linspace(0, 1, 101)], axis=0)
    np.testing.assert_allclose(sizes, 0.02 - 0.08 * s + 0.16 * s**2, atol=2e-4)
    assert not mackerel.deflection(s, 0.0).any()


def test_the_body_has_the_length_of_its_cells():
    hull = mackerel.hull(96)
    assert hull.body_length == pytest.approx(96, rel=0.01)
    assert np.ptp(hull.half_height) > 0.05 * 96


def test_forces_balance_where_the_thrust_changes_sign():
    found = mackerel.Tow(np.array([0.2, 0.3, 0.4]), np.array([-2.0, -1.0, 1.0]))
    assert found.balance == pytest.approx(0.35)
    assert np.isnan(mackerel.Tow(np.array([0.2, 0.3]), np.array([1.0, 2.0])).balance)
    assert np.isnan(mackerel.Tow(np.array([0.2, 0.3]), np.array([np.nan, 2.0])).balance)


def test_a_slower_tow_has_more_thrust():
    found = mackerel.tow(16, WALLS["ghost cells"], strouhal=(0.2, 0.5), cycles=2, threads=1)
    assert found.thrust[0] < 0 < found.thrust[1]
