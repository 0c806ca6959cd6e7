import numpy as np
import pytest

from sim2real.posterior.laplace import Laplace, sharpened

MEAN = np.array([0.3, -1.0, 2.0])
COVARIANCE = np.array([[1e-4, 8e-5, 0.0], [8e-5, 1e-4, 2e-4], [0.0, 2e-4, 4e-3]])


def normal(z):
    """Log-density of a normal distribution, and a ripple as rough rollouts leave."""
    residual = z - MEAN
    square = np.einsum("bi,ij,bj->b", residual, np.linalg.inv(COVARIANCE), residual)
    return -0.5 * square + 0.02 * np.sin(1e5 * z.sum(axis=1))


def start(off, scale):
    factor = np.linalg.cholesky(COVARIANCE * scale)
    centre = MEAN + np.linalg.cholesky(COVARIANCE) @ np.array(off)
    return Laplace(centre, factor, np.zeros(1), 1e-3)


@pytest.mark.parametrize("off", [(0, 0, 0), (3, -4, 2), (-8, 5, 8)])
@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])
def test_it_moves_to_the_optimum_and_takes_its_curvature(off, scale):
    result = sharpened(start(off, scale), normal)
    sd = np.sqrt(np.diag(COVARIANCE))
    assert (np.abs(result.centre - MEAN) < 0.15 * sd).all()
    covariance = result.factor @ result.factor.T
    np.testing.assert_allclose(covariance, COVARIANCE, atol=0.15 * sd.max() ** 2, rtol=0.15)


def test_a_density_that_breaks_down_leaves_it_as_it_was():
    initial = start((1, 0, 0), 1.0)

    def broken(z):
        return np.where(z[:, 0] > initial.centre[0] + 1e-9, -np.inf, normal(z))

    result = sharpened(initial, broken)
    assert np.array_equal(result.centre, initial.centre)
    assert np.array_equal(result.factor, initial.factor)


def test_a_flat_direction_does_not_run_away():
    result = sharpened(start((0, 0, 0), 1.0), lambda z: normal(np.where([1, 1, 0], z, MEAN)))
    assert np.isfinite(result.factor).all() and np.abs(result.centre - MEAN).max() < 1.0
