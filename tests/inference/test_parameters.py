"""What a parameter says of itself, and priors in unbounded coordinates."""

import numpy as np
import pytest
from scipy.integrate import quad

from sim2real.inference.parameters import Gaussian, Parameter, Priors
from sim2real.units import unit_of

PRIORS = Priors(
    (Parameter("kp_Nm_per_rad", 0.5, 8.0, 2.0, log=True), Parameter("x", -1.0, 3.0, 1.0))
)


def test_coordinates_and_back():
    values = PRIORS.draw(np.random.default_rng(0), 500)
    assert (values > [0.5, -1.0]).all() and (values < [8.0, 3.0]).all()
    np.testing.assert_allclose(PRIORS.values(PRIORS.coordinates(values)), values, rtol=1e-3)


def test_draws_are_even_between_the_limits():
    values = PRIORS.draw(np.random.default_rng(1), 20000)
    assert np.log(values[:, 0]).mean() == pytest.approx(np.log(2.0), abs=0.02)
    assert values.mean(axis=0)[1] == pytest.approx(1.0, abs=0.03)


def test_slope_is_the_derivative():
    z, h = np.array([[0.3, -1.2]]), 1e-6
    for k in range(2):
        step = h * np.eye(2)[k]
        slope = (PRIORS.values(z + step) - PRIORS.values(z - step))[0, k] / (2 * h)
        assert PRIORS.slope(z)[0, k] == pytest.approx(slope, rel=1e-6)


def test_density_of_a_coordinate_integrates_to_one():
    one = Priors(PRIORS.each[:1])
    total, _ = quad(lambda z: float(np.exp(one.log_density(np.array([z])))), -40, 40)
    assert total == pytest.approx(1.0)


def test_a_value_beyond_a_limit_is_taken_inside():
    assert np.isfinite(PRIORS.coordinates(np.array([0.0, 99.0]))).all()


def test_curvature_is_that_of_the_density():
    z, h = np.array([0.4, -2.0]), 1e-4
    for k in range(2):
        step = h * np.eye(2)[k]
        ends = PRIORS.log_density(z + step) + PRIORS.log_density(z - step)
        curved = (ends - 2 * PRIORS.log_density(z)) / h**2
        assert PRIORS.curvature(z)[k] == pytest.approx(-curved, rel=1e-4)


def test_a_parameter_says_its_prior_and_its_unit():
    assert str(PRIORS.each[0]) == "log-uniform 0.5 to 8 N m/rad"
    assert str(Parameter("latency_s", 0.0, 0.5, 0.05)) == "uniform 0 to 0.5 s"
    assert str(Parameter("u_m_s", -1, 1, 0.1, 0.02, 0.3)) == "normal 0.02 ± 0.3 m/s"
    assert Parameter("kp_Nm_per_rad", 1, 2, 1, unit="1/s²").unit == "1/s²"


def test_root_of_a_normal_prior_whitens_it():
    covariance = np.array([[4.0, 1.0], [1.0, 0.5]])
    root = Gaussian(np.zeros(2), covariance).root
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(2), atol=1e-12)
    own = Gaussian.of([Parameter("a", -9, 9, 1, 2.0, 3.0), Parameter("b", -9, 9, 1, 0.0, 0.1)])
    np.testing.assert_allclose(own.covariance, np.diag([9.0, 0.01]))
    np.testing.assert_allclose(own.mean, [2.0, 0.0])


@pytest.mark.parametrize(
    "name, unit",
    [("gap_rad", "rad"), ("limit_rad_s2", "rad/s²"), ("ki_Nm_per_rad_s", "N m/(rad s)"),
     ("coefficient_Nms2", "N m s²"), ("s_per_s", "s/s"), ("ratio", "")],
)  # fmt: skip
def test_units(name, unit):
    assert unit_of(name) == unit
