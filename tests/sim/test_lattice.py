from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from sim.lattice.velocities import D2Q9, D3Q19, Lattice

BOTH = pytest.mark.parametrize("lattice", [D2Q9, D3Q19], ids=lambda one: one.name)


def axes(lattice: Lattice) -> range:
    return range(lattice.dimensions)


@BOTH
def test_directions_come_in_opposite_pairs(lattice):
    c = np.array(lattice.velocities)
    assert not c[0].any()
    assert np.array_equal(c[1::2], -c[2::2])
    assert lattice.weights[1::2] == lattice.weights[2::2]


@BOTH
def test_weights_give_the_moments_of_a_gas_up_to_fourth_order(lattice):
    c, w = np.array(lattice.velocities, dtype=float), np.array(lattice.weights)
    same = np.eye(3)
    assert w.sum() == pytest.approx(1)
    assert np.allclose(w @ c, 0)
    for i, j in product(axes(lattice), repeat=2):
        assert w @ (c[:, i] * c[:, j]) == pytest.approx(same[i, j] / 3)
    for i, j, k in product(axes(lattice), repeat=3):
        assert w @ (c[:, i] * c[:, j] * c[:, k]) == pytest.approx(0)
    for i, j, k, m in product(axes(lattice), repeat=4):
        pairs = same[i, j] * same[k, m] + same[i, k] * same[j, m] + same[i, m] * same[j, k]
        assert w @ (c[:, i] * c[:, j] * c[:, k] * c[:, m]) == pytest.approx(pairs / 9)
