"""What every servo has a little of belongs to the plain servo, and is no finding."""

import numpy as np
import pytest
from simulated import NOISE, traced

from sim2real.diagnose.nuisances import size_in_noise
from sim2real.diagnose.search import search
from sim2real.effects import named
from sim2real.residuals.plain import baselines
from sim2real.residuals.screen import FITTED, NUISANCES
from sim2real.servo.batch import Batch

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
