"""A formula for what is in no catalogue: the planted one comes back, of noise there is none."""

import re

import numpy as np
import pytest
from strange import position_damping, shaking, strange

from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.page.formula import formula, what_is_left
from sim2real.identification.servo_problem import residual_angles
from sim2real.servo.batch import Batch
from sim2real.servo.trace import traces

PLANTED = {
    "position² · speed": (position_damping, -0.15, "N m s/rad³"),
    "position · speed": (lambda q, v, t: -0.04 * q * v, -0.04, "N m s/rad²"),
    "position³": (lambda q, v, t: -0.5 * q**3, -0.5, "N m/rad³"),
    "|speed| speed": (lambda q, v, t: -0.01 * abs(v) * v, -0.01, "N m s²/rad²"),
}


def guessed(torque, seeds=(1, 2), unit="N m"):
    given = traces([strange(seed, str(seed), torque) for seed in seeds], "j1")
    batch = Batch([given], bounded=False)
    fit = baselines(batch)
    residual = residual_angles(batch, fit)[0]
    theta = fit.servos.theta[0]
    left = [what_is_left(t, r, theta, {}) for t, r in zip(given, residual, strict=True)]
    return formula(left, unit, 0.1)


def factor(text):
    sign, size = re.match(r"(−?)([\d.e-]+)", text).groups()
    return -float(size) if sign else float(size)


@pytest.mark.parametrize("words", PLANTED)
def test_a_planted_torque_comes_back(words):
    torque, size, unit = PLANTED[words]
    text = guessed(torque)
    assert text.endswith(f" {unit} · {words}"), text
    assert factor(text) == pytest.approx(size, rel=0.4)


def test_friction_has_the_sign_of_a_brake():
    text = guessed(lambda q, v, t: -0.03 * np.tanh(v / 0.02))
    assert re.fullmatch(r"−0\.0\d+ N m · sgn\(speed\)", text), text


@pytest.mark.parametrize("seed", range(5))
def test_of_white_noise_there_is_no_formula(seed):
    assert guessed(lambda q, v, t: 0.0, (2 * seed, 2 * seed + 1)) == ""


def test_a_lone_recording_is_enough():
    assert "position² · speed" in guessed(position_damping, (1,))
    assert guessed(lambda q, v, t: 0.0, (1,)) == ""


def test_what_does_not_depend_on_the_motion_has_no_formula():
    """A measured motion satisfies its own equation: that alone must not pass for a finding."""
    assert guessed(shaking) == ""
    assert guessed(lambda q, v, t: 0.1 * (3.0 < t < 3.5)) == ""


def test_the_unit_is_that_of_the_load():
    assert "N m/(kg m²) s/rad³ · " in guessed(position_damping, unit="N m/(kg m²)")
