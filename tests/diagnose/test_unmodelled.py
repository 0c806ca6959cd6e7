"""What is left beyond noise: about 1 where a sensor is noisy and wanders, more where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from simulated import INERTIA, KD, KP, NOISE, PERIOD, row, traced

from sim2real.diagnose.servo_search import baselines
from sim2real.diagnose.unmodelled import excess, unmodelled
from sim2real.inference.correlated_noise import RESIDUAL_WANDER
from sim2real.servo.batch import Batch, Problems


def wander(seed, size, share=RESIDUAL_WANDER.share):
    """An Ornstein-Uhlenbeck process as slow and as large as a sensor's may be."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-PERIOD / RESIDUAL_WANDER.time_s)
    x = np.empty(size)
    x[0] = rng.normal()
    for k in range(1, size):
        x[k] = keep * x[k - 1] + np.sqrt(1 - keep**2) * rng.normal()
    return share * NOISE * x


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


def looked_at(traces):
    batch = Batch([traces])
    return unmodelled(batch, [traces], baselines(batch))[0]


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
    found = looked_at(touched)
    assert found.excess > 1.3
    assert found.windows_evidence > 20
    for some, at in zip(found.windows, events, strict=True):
        assert len(some) == 1
        assert some[0] == pytest.approx((at, at + 0.6), abs=0.25)
