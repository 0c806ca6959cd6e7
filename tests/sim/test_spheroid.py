"""Water that slips along a spheroid, against the closed forms of ideal fluid."""

import numpy as np
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
    assert all(figure.bar is None for figure in case.figures[1:])


@pytest.mark.parametrize(
    ("wall", "bars"), [("ghost cells", [0.01] * 3 + [0.005]), ("forcing", [None] * 4)]
)
def test_only_ghost_cells_are_judged_in_each_frame(monkeypatch, wall, bars):
    monkeypatch.setattr(
        spheroid,
        "drag",
        lambda length, wall, body, degrees, **_: (np.arange(4), np.full(4, body + degrees)),
    )
    figures = spheroid.frames(24, wall)
    assert [figure.bar for figure in figures] == bars
    assert [figure.ours for figure in figures] == [1.0, 0.0, 21.0, 21.0]


def test_frames_are_compared_at_three_sizes_on_a_gpu(monkeypatch):
    monkeypatch.setattr(spheroid, "masses", lambda *_, **__: np.ones(2))
    monkeypatch.setattr(spheroid, "drag", lambda *_, **__: (np.arange(4), np.zeros(4)))
    bars = [figure.bar for figure in spheroid.run(device="cuda:0").figures[3:]]
    none = [None] * 4
    assert bars == [*none, *[0.01] * 3, 0.005, *(none + [0.004] * 3 + [0.005]) * 2]
