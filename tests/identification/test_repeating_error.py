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
        variances, freedom = variance_components(error, slopes, np.zeros((2, 2)), groups)
        found.append(variances)
        assert np.all((freedom > 25) & (freedom <= 30))
    assert np.mean(found, axis=0) == pytest.approx([0.25, 4.0], rel=0.15)


def test_no_variance_is_found_in_white_noise():
    rng = np.random.default_rng(0)
    group = rng.standard_normal((800, 30))
    slopes = rng.standard_normal((800, 2))
    error = rng.standard_normal(800)
    variances, freedom = variance_components(error, slopes, np.zeros((2, 2)), [group])
    assert variances[0] < 2e-3
    assert freedom[0] < 30
