"""Which limit a motor's torque has: a torque-speed line, a flat limit, or both."""

import numpy as np
import pytest

from sim2real.identification.identify import identify
from sim2real.model import FittedEffect
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.prediction import predict

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
        signals = (t, command[:, None], seen[:, None])
        recordings.append(Recording(name, "servo", ("j1",), *signals, {"j1": Load(INERTIA)}))
    return recordings


LINK = Link("link", 0.1, 0.1, 0.02, 0.02)
SMALL = Servo("small", 1.05 * STALL, SPEED, 0.0)
BENCH = Robot("bench", (LINK, LINK), (Joint("j1", SMALL, (-3.0, 3.0)),))


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
