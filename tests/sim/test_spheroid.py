"""Water that slips along a spheroid, against the closed forms of ideal fluid."""

import pytest

from sim.cases import spheroid


def test_the_references_are_the_published_ones():
    end_on, broadside = spheroid.carried(6.01)
    assert end_on == pytest.approx(spheroid.CARRIED[0], abs=1e-3)
    assert broadside == pytest.approx(spheroid.CARRIED[1], abs=1e-3)
    assert spheroid.slipping() == pytest.approx(1.0572, abs=1e-4)
    assert spheroid.slipping(1e3) == pytest.approx(1.0, abs=1e-3)  # a needle is a plate
    assert spheroid.plate(1e7) == pytest.approx(0.003, rel=1e-9)


def test_a_slipping_spheroid_carries_the_water_that_lamb_says(monkeypatch):
    """After one period of shaking; towed a tenth of its length, as friction has no bar."""
    monkeypatch.setattr(spheroid, "_PERIODS", 1)
    monkeypatch.setattr(spheroid, "_LENGTHS", 0.1)
    case = spheroid.run(quick=True)
    mass = case.figures[0]
    assert mass.reference == pytest.approx(1.0452, abs=1e-4)
    assert mass.met, mass
    assert [figure.bar for figure in case.figures[1:]] == [None, None]
