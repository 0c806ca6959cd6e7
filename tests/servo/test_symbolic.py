"""The CasADi expression: the same law as the Warp functions, with exact derivatives."""

import casadi as ca
import numpy as np
import pytest
import symbolic
import warp as wp

from sim2real.recording import Load
from sim2real.servo import law
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import rollout

PARAMETERS = np.array([2.2, 0.06, 0.0683, 0.0003])
LOADS = [Load(0.002), Load(0.0049, 0.49, 0.1)]


@wp.kernel(enable_backward=False)
def torque_of(x: wp.array2d(dtype=wp.float64), out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    out[i] = law.pd_torque(x[i, 0], x[i, 1], x[i, 2], x[i, 3])


def test_one_law():
    x = np.random.default_rng(0).normal(size=(50, 4))
    out = wp.zeros(50, dtype=wp.float64, device="cpu")
    given = wp.from_numpy(x, dtype=wp.float64, device="cpu")
    wp.launch(torque_of, dim=50, inputs=[given, out], device="cpu")
    symbols = [ca.SX.sym(name) for name in ("kp", "kd", "error", "v")]
    expression = ca.Function("torque", symbols, [symbolic.pd_torque(*symbols)])
    expected = [float(expression(*row)) for row in x]
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-14)


@pytest.fixture
def signal():
    rng = np.random.default_rng(1)
    t = np.sort(0.02 * np.arange(300) + rng.normal(0, 3e-4, 300))
    t[150:] += 0.35  # a gap
    return t, np.repeat(rng.uniform(-0.6, 0.6, 10), 30) * (t > 0.5)


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("sine", [False, True])
def test_same_motion_as_the_rollout(signal, load, sine):
    t, command = signal
    command = 0.5 * np.sin(6 * t) if sine else command
    row = np.zeros((1, len(COLUMNS)))
    inertia = load.inertia_kgm2 + PARAMETERS[3]
    row[0, :5] = [*PARAMETERS[:3], inertia, load.gravity_Nm]
    angle, _ = symbolic.simulate(PARAMETERS, load, t, command)
    fine = rollout(row, t, command, steps_per_radian=300.0)[0]
    assert np.abs(angle - fine).max() < 1e-5
    usual = rollout(row, t, command)[0]
    assert np.abs(angle - usual).max() < 1e-4


@pytest.mark.parametrize("load", LOADS)
def test_derivatives_are_exact(signal, load):
    t, command = signal
    command = np.where(t < 0.5, 0.3, command)  # at rest off the hanging position
    _, slopes = symbolic.simulate(PARAMETERS, load, t, command)
    for k in range(4):
        shift = np.zeros(4)
        shift[k] = 1e-5 * PARAMETERS[k]
        up, down = (symbolic.simulate(PARAMETERS + s, load, t, command)[0] for s in (shift, -shift))
        numeric = (up - down) / (2 * shift[k])
        assert np.abs(numeric - slopes[:, k]).max() < 1e-6 * np.abs(slopes[:, k]).max()


def test_stiff_servo_on_slow_samples_stays_finite():
    t = 0.1 * np.arange(50)
    angle, slopes = symbolic.simulate(
        np.array([9e4, 900.0, 0.05, 0.0]), Load(1.0), t, np.where(t > 1, 0.5, 0.0)
    )
    assert np.isfinite(slopes).all()
    assert angle[-1] == pytest.approx(0.5, abs=1e-6)


def test_clock_counts_every_second_once(signal):
    t, command = signal
    clock = symbolic.clock(t, command, 0.0683)
    np.testing.assert_allclose(np.cumsum(clock.length)[clock.samples], t - t[0], atol=1e-12)
    assert (clock.length >= 0).all()
    fine = clock.refined(0.005)
    assert fine.length.max() < 0.005 + 1e-9
    np.testing.assert_allclose(np.cumsum(fine.length)[fine.samples], t - t[0], atol=1e-12)
