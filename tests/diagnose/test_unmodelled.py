"""What is left beyond noise: about 1 where a sensor is noisy and wanders, more where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim
from simulated import INERTIA, KD, KP, LATENCY, NOISE, PERIOD, row, steps, traced

from sim2real.diagnose.located import remainder
from sim2real.diagnose.servo_search import baselines
from sim2real.diagnose.unmodelled import (
    JointMotion,
    ServoMotion,
    excess,
    smooth_function,
    unmodelled,
)
from sim2real.inference.correlated_noise import RESIDUAL_WANDER
from sim2real.recording import Load
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.rollout import rollout, rollout_on
from sim2real.servo.trace import Trace


def wander(seed, size, share=RESIDUAL_WANDER.share):
    """An Ornstein-Uhlenbeck process as slow and as large as a sensor's may be."""
    keep = np.exp(-PERIOD / RESIDUAL_WANDER.time_s)
    drive = share * NOISE * np.sqrt(1 - keep**2)
    return lfilter([drive], [1.0, -keep], np.random.default_rng(seed).normal(size=2 * size))[size:]


def shifted(trace, more):
    return replace(trace, position=trace.position + more)


def excess_of(traces):
    """With the true parameters and the noise that an autoregression finds."""
    batch = Batch([traces])
    one = Problems(np.zeros(1, dtype=np.int32), row()[None, None], np.zeros((1, 1)))
    seen = batch.evaluate(one, keep=True)
    noise = float(np.sqrt(seen.square[0, 0] / seen.count[0]))
    return excess(seen.residual[0], traces, batch, noise)


def wandering(share):
    return [shifted(x, wander(k, x.t.size, share)) for k, x in enumerate(recorded())]


def recorded(seconds=15.0, **effects):
    return [traced(seed, str(seed), seconds=seconds, **effects) for seed in (1, 2)]


def test_noise_that_wanders_is_nothing():
    assert excess_of(wandering(RESIDUAL_WANDER.share)) == pytest.approx(1.0, abs=0.1)


def test_motion_of_its_own_is_something():
    wave = [shifted(x, 4 * NOISE * np.sin(2 * np.pi * 0.8 * x.t)) for x in wandering(1.0)]
    assert excess_of(wave) > 1.3


def test_a_plain_servo_has_nothing_unknown(nothing):
    (found,) = unmodelled(nothing.batch, [nothing.traces], nothing.plain)
    assert found.excess == pytest.approx(1.0, abs=0.12)
    assert found.windows is None
    assert found.windows_evidence == -np.inf
    assert found.smooth.evidence(float(nothing.plain.count[0])) < 0


def test_a_hand_on_the_shaft_is_found_in_time():
    """For half a second in each recording something else moves the joint."""
    events = (4.0, 8.0)
    touched = []
    for trace, at in zip(recorded(12.0), events, strict=True):
        torque = np.where((trace.t >= at) & (trace.t < at + 0.5), 0.15, 0.0)
        _, shift, _ = lsim(([1.0], [INERTIA, KD, KP]), torque, trace.t)
        touched.append(shifted(trace, shift))
    batch = Batch([touched])
    (found,) = unmodelled(batch, [touched], baselines(batch))
    assert found.excess > 1.3
    assert found.windows_evidence > 20
    for some, at in zip(found.windows, events, strict=True):
        assert len(some) == 1
        assert some[0] == pytest.approx((at, at + 0.6), abs=0.25)


TIMES = 0.01 * np.arange(2000)
ANGLE = 0.8 * np.sin(0.9 * TIMES) * np.cos(0.37 * TIMES)
SPEED = np.gradient(ANGLE, TIMES)
TURNS = TIMES[1:][np.diff(np.sign(SPEED)) != 0]
SINCE = np.min(np.abs(TIMES - TURNS[:, None]) + 1e3 * (TURNS[:, None] > TIMES), axis=0)


@pytest.mark.parametrize(
    ("where", "told"),
    [
        (SINCE < 0.15, "reversals"),
        (np.abs(SPEED) > 0.6, "speeds above"),
        (SPEED > 0.05, "turning forwards"),
        (TIMES < 0.8, "first second"),
        (TIMES > -1.0, "spread over"),
    ],
)
def test_the_part_of_the_motion_with_the_error_is_told_with_its_share(where, told):
    trace = Trace("a", "a", TIMES, ANGLE, ANGLE, Load(0.002), np.ones(TIMES.size, dtype=bool))
    noise = np.random.default_rng(0).normal(0, 1e-3, TIMES.size)
    text = remainder([trace], (noise * np.where(where, 5.0, 1.0))[None], 1e-3)
    assert told in text
    assert "%" not in text or int(text.split("%")[0].split()[-1]) > 60


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
    assert max(found.shares, key=found.shares.get) == "other_joint"


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
