"""What every servo has a little of belongs to the plain servo, and is no finding."""

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import NOISE, traced

from sim2real.diagnose.nuisances import _best, size_in_noise
from sim2real.diagnose.search import search
from sim2real.effects import named
from sim2real.residuals.plain import baselines
from sim2real.residuals.problem import Hypothesis
from sim2real.residuals.screen import FITTED, NUISANCES
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS

WAVE = {"amplitude_rad": 4 * NOISE, "period_rad": 0.6, "phase_rad": 0.5}


def plain_servo(**effects):
    traces = [traced(1, "a", **effects), traced(2, "b", **effects)]
    batch = Batch([traces])
    (found,), _ = search(
        batch, baselines(batch), level=0.01, rng=np.random.default_rng(0), noise=[NOISE]
    )
    return found


@pytest.fixture(scope="module")
def wavy():
    return plain_servo(sensor_eccentricity=WAVE)


def test_eccentricity_is_a_nuisance_and_never_named():
    assert named("sensor_eccentricity") in NUISANCES
    assert named("sensor_eccentricity") not in FITTED


def test_a_sensor_that_errs_by_a_little_wave_is_a_plain_servo(wavy):
    assert "sensor_eccentricity" in wavy.base
    assert size_in_noise(wavy.plain, "sensor_eccentricity", NOISE) == pytest.approx(4, rel=0.3)


def test_the_plain_servo_with_its_wave_is_as_good_as_its_noise(wavy):
    error = np.sqrt(wavy.plain.fit.error2[0] / wavy.plain.fit.count[0])
    assert error == pytest.approx(NOISE, rel=0.1)


def test_a_servo_without_a_wave_gets_none():
    assert plain_servo().base == frozenset()


def test_the_wave_is_free_again_when_rivals_are_compared(wavy):
    wave = {COLUMNS.index(f"sensor_eccentricity.{name}") for name in WAVE}
    assert wave <= {*wavy.plain.fit.servos.columns[0].tolist()}
    assert wave <= {*wavy.best.fit.servos.columns[0].tolist()}


def explained(evidence, **waves_rad):
    """A set of nuisances of these sizes on a servo of 2 N m/rad."""
    theta = np.zeros((1, len(COLUMNS)))
    theta[0, 0] = 2.0
    for name, size in waves_rad.items():
        first = named(name).parameters[0].name
        theta[0, COLUMNS.index(f"{name}.{first}")] = size * (2.0 if first == "torque_Nm" else 1.0)
    fit = SimpleNamespace(servos=SimpleNamespace(theta=theta))
    return Hypothesis(frozenset(waves_rad), fit, evidence)


def test_no_small_wave_stands_in_for_a_large_one():
    bare, large = explained(0.0), explained(500.0, cogging=0.03)
    small = explained(60.0, cogging=0.005)
    assert _best(bare, [small], large_rad=0.01) is small
    assert _best(bare, [small, large], large_rad=0.01) is bare


def test_a_small_wave_beside_a_large_one_is_still_a_nuisance():
    bare, alone = explained(0.0), explained(60.0, sensor_eccentricity=0.002)
    both = explained(500.0, cogging=0.03, sensor_eccentricity=0.002)
    assert _best(bare, [alone, both], large_rad=0.01) is alone
