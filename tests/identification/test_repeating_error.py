"""Variances of functions of the angle in a residual."""

import numpy as np
import pytest

from sim2real.identification.repeating_error import variance_components


def test_variances_are_recovered_beside_noise_and_fitted_parameters():
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slopes = rng.standard_normal((800, 2))
        groups = [rng.standard_normal((800, 30)) for _ in range(2)]
        of_group = (0.5, 2.0)
        error = rng.standard_normal(800) + slopes @ [3.0, -2.0]
        for sd, group in zip(of_group, groups, strict=True):
            error += group @ (sd * rng.standard_normal(30))
        squares, freedom = variance_components(error, slopes, np.zeros((2, 2)), groups)
        found.append([square.mean() for square in squares])
        assert np.all((freedom > 25) & (freedom <= 30))
    assert np.mean(found, axis=0) == pytest.approx([0.25, 4.0], rel=0.15)


def test_no_variance_is_found_in_white_noise():
    rng = np.random.default_rng(0)
    group = rng.standard_normal((800, 30))
    slopes = rng.standard_normal((800, 2))
    error = rng.standard_normal(800)
    (squares,), freedom = variance_components(error, slopes, np.zeros((2, 2)), [group])
    assert squares.mean() < 2e-3
    assert freedom[0] < 30


def test_a_single_wave_keeps_its_power_and_one_that_the_fit_absorbs_has_that_of_the_others():
    rng = np.random.default_rng(1)
    group = rng.standard_normal((800, 30))
    slopes = group[:, [5]]
    error = rng.standard_normal(800) + 2.0 * group[:, 7]
    (squares,), _ = variance_components(error, slopes, np.zeros((1, 1)), [group])
    others = np.delete(squares, [5, 7])
    assert squares[7] == pytest.approx(4.0, rel=0.15)
    assert squares[5] == pytest.approx(squares.mean(), rel=0.15)
    assert others.max() < 0.2 * squares[5]
