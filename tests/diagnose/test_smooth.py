"""Physics without a name: the state that drives it is recognised, and noise drives nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from simulated import INERTIA, KD, KP, LATENCY, NOISE, PERIOD, row, steps

from sim2real.diagnose.unmodelled import JointMotion, ServoMotion, smooth_function
from sim2real.recording import Load
from sim2real.servo.rollout import rollout, rollout_on
from sim2real.servo.trace import Trace

LAGS = 25
T = PERIOD * np.arange(600)


def servo(motions, **options):
    return ServoMotion(motions, KP, KD, LATENCY, 0.02, LAGS, **options)


def plain(seed):
    """What the plain servo does, and the noise of its sensor as residual."""
    rng = np.random.default_rng(seed)
    command = steps(T, rng)
    angle = rollout(row()[None], T, command)[0]
    noise = rng.normal(0, NOISE, T.size)
    used = np.ones(T.size, dtype=bool)
    trace = Trace("plain", "plain", T, command, angle + noise, Load(INERTIA), used)
    return JointMotion(trace, angle, -noise, np.arange(T.size) >= LAGS, np.zeros((0, T.size)))


def pushed(torque, seed):
    """The same with a torque that the servo does not know of, as small as its own motion is not."""
    motion = plain(seed)
    _, shift, _ = lsim(([1.0], [INERTIA, KD, KP]), torque(motion), T)
    return replace(motion, residual=motion.residual - shift)


def strange(torque):
    return smooth_function(servo([pushed(torque, seed) for seed in (1, 2)]))


def best(found):
    return max(found.shares, key=lambda state: found.shares[state])


@pytest.fixture(scope="module")
def noise_only():
    return smooth_function(servo([plain(1), plain(2)]))


def test_noise_is_driven_by_nothing(noise_only):
    assert noise_only.evidence(1100.0) < 0
    assert max(noise_only.shares.values()) < 15


@pytest.mark.parametrize(
    ("state", "torque"),
    [
        ("position", lambda m: -0.3 * m.angle**3),
        ("speed", lambda m: -2e-4 * np.gradient(m.angle, T) * np.abs(np.gradient(m.angle, T))),
    ],
)
def test_what_drives_a_torque_is_recognised(state, torque):
    found = strange(torque)
    assert found.state == state
    assert found.evidence(1100.0) > 50


def test_shaking_is_likelier_than_any_state():
    assert strange(lambda m: 0.01 * np.sin(2 * np.pi * 1.7 * T + m.angle[-1])).state == "shaking"


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_jump_is_found_when_it_happens(seed):
    instants = np.random.default_rng(seed).uniform(2.0, 10.0, 2)
    motions = [
        replace(m, residual=m.residual - 0.01 * (at <= T))
        for m, at in zip((plain(1), plain(2)), instants, strict=True)
    ]
    found = smooth_function(servo(motions))
    assert found.state == "jump"
    np.testing.assert_allclose(found.jumps_s, instants, atol=0.3)


def test_another_joint_is_recognised():
    """The servo is pulled by the acceleration of its neighbour."""
    motions = []
    for seed in (1, 2):
        neighbour = plain(seed + 10).angle
        pull = 1e-4 * np.gradient(np.gradient(neighbour, T), T)
        motions.append(replace(pushed(lambda m, x=pull: x, seed), others=neighbour[None]))
    found = smooth_function(servo(motions))
    assert best(found) == "other_joint"


def test_a_wrong_gain_is_no_state_in_another_context():
    """At a quarter of the gain of the firmware, angles sampled late."""

    def motion(seed):
        trace = replace(plain(seed).trace, gain_ratio=0.25, sample_delay_s=0.015)
        wrong = row()
        wrong[:3] *= [1.1, 1.1, 1.05]
        angle, measured = rollout_on(trace, np.stack([row(), wrong]))
        noise = np.random.default_rng(seed).normal(0, NOISE, T.size)
        residual = angle - measured - noise
        return JointMotion(trace, angle, residual, np.arange(T.size) >= LAGS, np.zeros((0, T.size)))

    found = smooth_function(servo([motion(1), motion(2)], thorough=False))
    assert found.evidence(1100.0) < 0
