"""Memory of more slots than 32 bits can number, put to use at sizes that are small."""

import numpy as np
import pytest
from swimming_robots import FISH, servos

import sim.lattice.populations
from sim.lattice.populations import is_wide
from sim.lattice.velocities import D2Q9, D3Q19
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.view.plane import plane_of

BOTH = pytest.mark.parametrize("lattice", [D2Q9, D3Q19], ids=lambda one: one.name)


@pytest.fixture
def narrow_and_wide(monkeypatch):
    """Do the same in narrow and in wide memory."""

    def twice(work):
        narrow = work()
        monkeypatch.setattr(sim.lattice.populations, "WIDE_FROM", 0)
        return narrow, work()

    return twice


@BOTH
def test_swimmers_are_the_same_bit_for_bit(lattice, narrow_and_wide):
    def swim():
        swimmer = Swimmer(
            FISH, servos(), n_envs=2, dimensions=lattice.dimensions, cell_m=0.04,
            box_m=(0.9, 0.7, 0.32),
        )  # fmt: skip
        for k in range(40):
            if k == 15:
                swimmer.reset(np.array([False, True]))
            wave = np.sin(2 * np.pi * 1.5 * CONTROL_S * k - 1.2 * np.arange(3))
            swimmer.step(np.array([0.3, 0.45, 0.6]) * wave)
        return swimmer

    narrow, wide = narrow_and_wide(swim)
    assert wide.fluid.wide and not narrow.fluid.wide
    assert np.array_equal(narrow.fluid.f.numpy(), wide.fluid.f.numpy().ravel())
    for name, value in vars(wide.state()).items():
        assert np.array_equal(getattr(narrow.state(), name), value), name
    seen = plane_of(wide).vorticity
    assert np.array_equal(plane_of(narrow).vorticity, seen)
    assert np.abs(seen).max() > 0


def test_memory_is_wide_where_32_bits_end():
    most = 2**31 // 19
    assert not is_wide(D3Q19, most)
    assert is_wide(D3Q19, most + 1)
