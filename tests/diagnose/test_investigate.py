"""Findings of several joints: each is of its own joint, whichever had to be looked at again."""

import numpy as np
import pytest
from simulated import NOISE, recording
from strange import position_damping, strange

from sim2real.diagnose.baseline import baselines
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import investigate
from sim2real.diagnose.servo_search import plain_sets
from sim2real.identification.servo_problem import residual_angles
from sim2real.servo.batch import Batch
from sim2real.servo.trace import trace


def test_a_joint_that_is_looked_at_again_keeps_its_place():
    """The second look is at some joints only, which are numbered anew there."""
    clean = [trace(recording(k, f"c{k}", seconds=8.0), "j1") for k in (1, 2)]
    odd = [trace(strange(k, f"s{k}", position_damping, seconds=8.0), "j1") for k in (3, 4)]
    batch = Batch([clean, odd])
    rng = np.random.default_rng(0)
    joints = [JointCase("clean", clean, NOISE, None), JointCase("odd", odd, NOISE, None)]
    found = investigate(batch, joints, plain_sets(baselines(batch)), rng=rng)
    assert found[0].excess < DECISION.structured_excess < found[1].excess
    for finding, noise in zip(found, (NOISE, 3 * NOISE), strict=True):
        left = residual_angles(batch, finding.tried.plain.fit)
        assert np.sqrt(np.mean(left**2)) == pytest.approx(noise, rel=0.7)
