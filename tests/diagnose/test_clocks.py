"""Clocks that differ as crystals do are no finding; those that run apart farther are left alone."""

import numpy as np
from simulated import traced

from sim2real.diagnose.case import JointCase, on_one_clock
from sim2real.diagnose.servo_search import baselines, plain_sets
from sim2real.servo.batch import Batch

QUIET = 1e-5


def moved(drifts):
    """By how much recordings whose clocks run apart so much were moved, and should be, rad."""
    given = [
        traced(k, f"r{k}", seconds=30.0, noise=QUIET, clock_drift={"s_per_s": drift})
        for k, drift in enumerate(drifts)
    ]
    still = [traced(k, f"r{k}", seconds=30.0, noise=QUIET) for k, _ in enumerate(drifts)]
    batch = Batch([given])
    best = [one.best for one in plain_sets(baselines(batch))]
    (joint,) = on_one_clock(batch, [JointCase("j1", given, QUIET, None)], best)
    now = [
        after.position - before.position for after, before in zip(joint.traces, given, strict=True)
    ]
    right = [a.position - b.position for a, b in zip(still, given, strict=True)]
    return np.concatenate(now), np.concatenate(right)


def test_each_recording_has_a_drift_of_its_own():
    now, right = moved((20e-6, -15e-6))
    assert np.std(right) > 10 * QUIET
    assert np.std(now - right) < 0.3 * np.std(right)


def test_clocks_that_run_apart_are_left_alone():
    now, _ = moved((3e-4, 3e-4))
    assert not now.any()
