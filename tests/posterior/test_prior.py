import numpy as np
import pytest
import simulated
from scipy.integrate import quad

from sim2real.model import FittedEffect, JointModel
from sim2real.posterior.prior import Prior, Priors, servo_priors, unit_of
from sim2real.servo.parameters import COLUMNS

PRIORS = Priors((Prior("kp_Nm_per_rad", "N m/rad", 0.5, 8.0, log=True), Prior("x", "", -1.0, 3.0)))


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


def test_priors_of_a_servo_and_its_effects():
    effects = (FittedEffect("backlash", {"gap_rad": 0.03}),
               FittedEffect("latency_jitter", {"halfwidth_s": 0.01}))  # fmt: skip
    joint = JointModel(simulated.KP, simulated.KD, simulated.LATENCY, simulated.INERTIA,
                       effects=effects)  # fmt: skip
    priors = servo_priors(joint)
    assert priors.names[3:] == ("backlash.gap_rad",)  # what is random is held
    assert set(priors.names) <= set(COLUMNS)
    truth = np.array([simulated.KP, simulated.KD, simulated.LATENCY, 0.03])
    low, high = np.array([[p.low, p.high] for p in priors.each]).T
    assert ((low < truth) & (truth < high)).all()
    assert priors.each[3].unit == "rad" and "log-uniform" in str(priors.each[0])


@pytest.mark.parametrize(
    "name, unit",
    [("gap_rad", "rad"), ("limit_rad_s2", "rad/s²"), ("ki_Nm_per_rad_s", "N m/(rad s)"),
     ("coefficient_Nms2", "N m s²"), ("s_per_s", "s/s"), ("ratio", "")],
)  # fmt: skip
def test_units(name, unit):
    assert unit_of(name) == unit
