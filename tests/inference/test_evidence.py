"""The Occam factor against its closed form for a linear model."""

import numpy as np
import pytest

from sim2real.inference.evidence import occam_factor

RNG = np.random.default_rng(3)
A = RNG.standard_normal((30, 3))


def test_occam_counts_what_nuisances_leave():
    information = A.T @ A
    left = information[2, 2] - information[2, :2] @ np.linalg.solve(
        information[:2, :2], information[:2, 2]
    )
    found = occam_factor(information[None], 2.0, nuisance=2)[0]
    assert found == pytest.approx(0.5 * np.log(1 + 4 * left))
    assert occam_factor(information[None], 2.0, nuisance=3)[0] == 0.0
