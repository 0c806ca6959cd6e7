"""Intervals of a fit whose residuals are correlated in time or repeat with the angle."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest
from simulated import one_joint, robot

from sim2real.identification.identify import identify
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.uncertainty import uncertainty, variance_components
from sim2real.inference.least_squares import robust_scale
from sim2real.inference.parameters import Parameter
from sim2real.model import FittedEffect
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.prediction import predict
from sim2real.servo.trace import Trace

UNIT = 100.0
FREE = tuple(Parameter(name, -9.0, 9.0, UNIT) for name in COLUMNS[:2])


def linear_fit(t, angle, slopes, measured):
    """A least-squares fit of two coefficients of ``slopes``, and these."""
    estimate = np.linalg.lstsq(slopes, measured, rcond=None)[0]
    error = slopes @ estimate - measured
    trace = Trace("a", "a", t, angle, angle - error, Load(0.002), np.ones(t.size, bool))
    problem = ServoProblem([trace], plain_row(4.0, 0.1, 0.0), FREE)
    none = np.empty((0, 2)), np.empty(0)
    x, scale = np.array([4.0, 0.1]) / UNIT, robust_scale(error)
    return Fit(problem, x, error, slopes * UNIT, scale, 1.0, True, *none), estimate


def half_width(fit, repeating):
    return uncertainty(fit, repeating=repeating).half_width * UNIT


def test_intervals_hold_where_residuals_are_correlated():
    """A line through correlated noise: intervals for independent noise would miss half the time."""
    held = 0
    x = np.linspace(-1, 1, 1500)
    slopes = np.stack([np.ones_like(x), x], axis=1)
    for seed in range(200):
        white = np.random.default_rng(seed).standard_normal(x.size)
        noise = lfilter([1.0], [1.0, -0.9], white)
        fit, estimate = linear_fit(np.arange(x.size) / 50, x, slopes, noise)
        held += abs(estimate[1]) < half_width(fit, False)[1]
    low, high = binomtest(held, 200).proportion_ci(0.99)
    assert high > 0.85, held
    assert low < 0.97, held


def test_intervals_hold_where_errors_repeat_with_the_angle():
    """A servo that passes the same angles again and again, with an error that depends on them."""
    t = np.arange(1000) / 50
    angle = 0.5 * np.sin(2 * np.pi * 0.5 * t)
    slopes = np.stack([angle, np.gradient(angle, t)], axis=1)
    held, held_without, cases = 0, 0, 60
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        cycles, phase = rng.uniform(0.5, 10.0, 3), rng.uniform(0, 2 * np.pi, 3)
        repeating = np.sin(2 * np.pi * np.outer(angle, cycles) + phase).sum(axis=1)
        measured = 3e-3 * repeating + 1e-3 * rng.standard_normal(t.size)
        fit, estimate = linear_fit(t, angle, slopes, measured)
        held += abs(estimate[0]) < half_width(fit, True)[0]
        held_without += abs(estimate[0]) < half_width(fit, False)[0]
    assert held_without < 0.5 * cases, held_without
    assert held >= 0.83 * cases, held


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


KP, KD, LATENCY, INERTIA, NOISE = 1.4, 0.07, 0.06, 0.0022, 1e-3
STALL, SPEED = 0.8, 5.0
STEP = 5e-4


def line(torque, speed):
    """Drive limited in voltage; the damping is that of the back-EMF."""
    emf = STALL / SPEED
    return np.clip(torque + emf * speed, -STALL, STALL) - emf * speed


def flat(torque, speed, share=0.8):
    """Drive limited in current; this share of the damping acts besides."""
    beside = share * KD * speed
    return np.clip(torque + beside, -STALL, STALL) - beside


def both(torque, speed):
    """A line, and a current limit at a bit more than half of the stall torque."""
    return np.clip(line(torque, speed), -0.55 * STALL, 0.55 * STALL)


def recorded(limit, kd=KD, seed=0, ramp=np.inf):
    """Two recordings of a servo, integrated by itself in steps of half a millisecond."""
    rng, recordings = np.random.default_rng(seed), []
    t = np.arange(0.0, 12.0, 0.01)
    for name in ("a", "b"):
        levels = np.append(0.0, rng.uniform(-0.9, 0.9, 60))
        command = levels[np.searchsorted(0.3 + np.cumsum(rng.uniform(0.3, 0.8, 60)), t)]
        angle, speed, inside, seen = 0.0, 0.0, 0.0, np.zeros(t.size)
        for i in range(1, t.size):
            for part in range(20):
                now = t[i - 1] + STEP * part - LATENCY
                sent = command[max(int(np.floor(now / 0.01 + 1e-9)), 0)]
                inside += np.clip(sent - inside, -ramp * STEP, ramp * STEP)
                torque = limit(KP * (inside - angle) - kd * speed, speed)
                speed += STEP * torque / INERTIA
                angle += STEP * speed
            seen[i] = angle
        seen += rng.normal(0.0, NOISE, t.size)
        recordings.append(one_joint(t, command, seen, Load(INERTIA), name))
    return recordings


BENCH = robot("j1", servo=Servo("small", 1.05 * STALL, SPEED, 0.0), limits=(-3.0, 3.0))


def test_a_flat_limit_is_told_from_a_line():
    recordings = recorded(flat)
    model = identify(recordings, BENCH)
    joint = model.joints["j1"]
    assert joint.law == "current_limited" and not joint.effects
    assert joint.motor["stall_torque_Nm"] == pytest.approx(STALL, rel=0.02)
    beside = joint.motor["stall_torque_Nm"] / joint.motor["no_load_speed_rad_s"]
    assert beside == pytest.approx(0.8 * KD, rel=0.2)
    low, high = joint.interval["motor.no_load_speed_rad_s"]
    assert 0.99 * low < STALL / (0.8 * KD) < 1.01 * high
    assert any("at any speed" in note for note in joint.notes)
    assert model.fit["j1.position_rad"]["heldout"] < 1.1 * NOISE
    angles = predict(model, recordings[1].t, {"j1": recordings[1].command[:, 0]}, {})
    assert np.sqrt(np.mean((angles["j1"] - recordings[1].position[:, 0]) ** 2)) < 1.2 * NOISE


def test_a_line_stays_the_data_sheets():
    joint = identify(recorded(line, kd=STALL / SPEED), BENCH).joints["j1"]
    assert joint.law == "motor" and not joint.effects
    assert joint.motor["no_load_speed_rad_s"] == pytest.approx(SPEED, rel=0.03)


def test_a_limit_of_the_set_point_s_speed_is_told_from_the_motor_s():
    joint = identify(recorded(line, kd=STALL / SPEED, ramp=3.0), BENCH).joints["j1"]
    (effect,) = joint.effects
    assert effect.effect == "rate_limit" and joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.05)
    assert effect.parameters["limit_rad_s"] == pytest.approx(3.0, rel=0.02)


def test_a_current_limit_below_the_line_is_found_with_it():
    model = identify(recorded(both, kd=STALL / SPEED), BENCH)
    joint = model.joints["j1"]
    assert joint.law == "motor"
    (effect,) = joint.effects
    assert isinstance(effect, FittedEffect) and effect.effect == "torque_saturation"
    assert effect.parameters["limit_Nm"] == pytest.approx(0.55 * STALL, rel=0.05)
    low, high = joint.interval["torque_saturation.limit_Nm"]
    assert low < effect.parameters["limit_Nm"] < high
    assert joint.motor["no_load_speed_rad_s"] == pytest.approx(SPEED, rel=0.3)
    assert model.fit["j1.position_rad"]["heldout"] < 1.15 * NOISE
