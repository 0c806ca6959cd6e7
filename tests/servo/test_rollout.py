"""The servo's dynamics: accuracy, latency, batches, closed forms, another integrator."""

import integrator
import numpy as np
import pytest
import warp as wp
from good_input import message

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.servo import law
from sim2real.servo.parameters import BASE, COLUMNS, joint_row
from sim2real.servo.prediction import predict
from sim2real.servo.rollout import SHORTEST_SUBSTEP_S, longest_substep, rollout

KP, KD, LATENCY, INERTIA = 2.2, 0.06, 0.0683, 0.002


def theta(**values):
    row = dict(zip(BASE, (KP, KD, LATENCY, INERTIA, 0.0), strict=True)) | values
    unknown = set(row) - set(COLUMNS)
    assert not unknown, unknown
    return np.array([[row.get(name, 0.0) for name in COLUMNS]])


@pytest.fixture
def clock():
    t = 0.02 * np.arange(250) + np.random.default_rng(3).normal(0, 3e-4, 250)
    return t - t[0]


def square(t):
    return np.where((t > 0.3) & (t % 2 < 1), 0.5, -0.5) * (t > 0.3)


def test_latency_is_any_real_number(clock):
    command = square(clock)
    rows = np.vstack([theta(latency_s=0.068 + 1e-5 * k) for k in range(200)])
    angle = rollout(rows, clock, command)
    steps = np.abs(np.diff(angle, axis=0)).max(axis=1)
    assert steps.max() < 20 * 1e-5, "no jump: speed never exceeds 20 rad/s here"
    assert steps.min() > 0


def test_rows_do_not_mix(clock):
    rows = np.vstack([theta(kp_Nm_per_rad=k) for k in np.random.default_rng(0).uniform(1, 4, 5)])
    together = rollout(rows, clock, square(clock))
    assert together.shape == (5, clock.size)
    for k, row in enumerate(rows):
        np.testing.assert_array_equal(together[k], rollout(row[None], clock, square(clock))[0])


def test_starts_in_balance_with_a_pendulum():
    t = 0.02 * np.arange(100)
    angle = rollout(theta(gravity_Nm=0.48), t, np.full(100, 0.8))[0]
    assert np.ptp(angle) < 1e-9
    assert KP * (0.8 - angle[0]) == pytest.approx(0.48 * np.sin(angle[0]), abs=1e-9)


def test_starts_where_friction_is_seen_to_hold_the_joint(clock):
    command, held = square(clock), np.where(clock < 0.3, 0.02, np.nan)
    friction = {"coulomb_friction.torque_Nm": 0.1}  # kp times 0.02 rad are 0.044 N m
    started = rollout(theta(**friction), clock, command, measured=held)[0]
    assert np.abs(started[clock < 0.3] - 0.02).max() < 1e-9
    free = rollout(theta(), clock, command, measured=held)[0]
    assert free[0] == pytest.approx(0.02)
    assert np.abs(free[(clock > 0.25) & (clock < 0.3)]).max() < 1e-3


def test_swings_freely_once_the_torque_is_off():
    t = 0.005 * np.arange(2000)
    command = np.where(t < 1.0, 0.1, np.nan)
    angle = rollout(theta(gravity_Nm=0.48), t, command)[0, 400:]
    crossings = np.flatnonzero(np.diff(np.sign(angle)) > 0)
    period = np.mean(np.diff(t[400:][crossings]))
    assert period == pytest.approx(2 * np.pi * np.sqrt(INERTIA / 0.48), rel=2e-2)
    assert np.abs(angle).max() > 0.05, "nothing damps it"


def test_the_fast_kernel_moves_as_the_one_with_effects_does():
    """Rows without effects go through a kernel of their own, unless one beside them has one."""
    motor = {
        "stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2, "resistance_rise": 1.0,
        "coulomb_Nm": 0.02, "motor_friction": 0.2, "stribeck_motor_friction": 0.1,
        "stribeck_speed_rad_s": 0.5, "loop_period_s": 0.004,
    }  # fmt: skip
    fast = joint_row(JointModel(2.0, 0.06, 0.05, 0.002, law="motor", motor=motor), None)
    effect = (FittedEffect("backlash", {"gap_rad": 0.02}),)
    other = joint_row(JointModel(2.0, 0.06, 0.05, 0.002, effects=effect), None)
    t = 0.02 * np.arange(100)
    command = np.where(t > 0.2, 0.5 * np.sign(np.sin(3 * t)), 0.0)
    alone = rollout(fast[None], t, command, substep_s=5e-4)
    beside = rollout(np.stack([fast, other]), t, command, substep_s=5e-4)
    np.testing.assert_array_equal(alone[0], beside[0])


def test_no_servo_takes_unbounded_time():
    """Absurd gains are simulated with a bounded number of sub-steps, or refused."""
    damped = theta(kp_Nm_per_rad=1e6, kd_Nms_per_rad=1e9)
    assert longest_substep(damped, damped[:, 3]) == SHORTEST_SUBSTEP_S
    t = np.arange(0.0, 1.0, 0.02)
    assert np.isfinite(rollout(damped, t, square(t))).all()
    stiff = joint_row(JointModel(1.2e6, 0.0, 0.05, 0.002), None)
    assert np.isfinite(rollout(stiff[None], t, square(t))).all()
    stiffer = JointModel(1.3e6, 0.0, 0.05, 0.002)
    message(lambda: joint_row(stiffer, None), "kp_Nm_per_rad", "2.55e+04 rad/s", "25000 rad/s")


def test_parameters_that_no_servo_has_are_refused():
    def refused(effect, *parts, **parameters):
        joint = JointModel(2.2, 0.06, 0.05, 0.002, effects=(FittedEffect(effect, parameters),))
        message(lambda: joint_row(joint, None), *parts)

    refused("command_filter", "time_constant_s", "-0.1", "at least 0", time_constant_s=-0.1)
    refused("unmodelled_inertia", "inertia_kgm2", "-0.001 kg m2", inertia_kgm2=-0.003)
    limit = FittedEffect("quadratic_drag", {"coefficient_Nms2": 1e6})
    model = Model({"j1": JointModel(2.2, 0.06, 0.05, 0.002, effects=(limit,))})
    t = np.arange(0.0, 1.0, 0.02)
    message(lambda: predict(model, t, {"j1": square(t)}), "model, j1", "without bound", "stable")


@wp.kernel(enable_backward=False)
def torque_of(x: wp.array2d(dtype=wp.float64), out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    out[i] = law.pd_torque(x[i, 0], x[i, 1], x[i, 2], x[i, 3])


def test_one_law():
    x = np.random.default_rng(0).normal(size=(50, 4))
    out = wp.zeros(50, dtype=wp.float64, device="cpu")
    given = wp.from_numpy(x, dtype=wp.float64, device="cpu")
    wp.launch(torque_of, dim=50, inputs=[given, out], device="cpu")
    kp, kd, error, v = x.T
    np.testing.assert_allclose(out.numpy(), kp * error - kd * v, rtol=1e-14)


@pytest.fixture
def signal():
    rng = np.random.default_rng(1)
    t = np.sort(0.02 * np.arange(300) + rng.normal(0, 3e-4, 300))
    t[150:] += 0.35  # a gap
    return t, np.repeat(rng.uniform(-0.6, 0.6, 10), 30) * (t > 0.5)


@pytest.mark.parametrize("load", [Load(0.002), Load(0.0049, 0.49, 0.1)])
@pytest.mark.parametrize("sine", [False, True])
@pytest.mark.parametrize("gains", [(2.2, 0.06), (8.0, 0.08), (2.2, 0.4)])
def test_agrees_with_an_independent_integrator(signal, load, sine, gains):
    t, command = signal
    parameters = [*gains, LATENCY]
    command = 0.5 * np.sin(6 * t) if sine else command
    row = np.zeros((1, len(COLUMNS)))
    row[0, :5] = [*parameters, load.inertia_kgm2, load.gravity_Nm]
    angle = integrator.simulate(parameters, load, t, command)
    fine = rollout(row, t, command, steps_per_radian=300.0)[0]
    assert np.abs(angle - fine).max() < 1e-5
    usual = rollout(row, t, command)[0]
    assert np.abs(angle - usual).max() < 1e-4
