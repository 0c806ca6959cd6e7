"""The camera's effects and the velocity estimator."""

import numpy as np
import pytest

from sim2real.body import observed
from sim2real.velocity import body_velocity

T = 0.02 * np.arange(200)
POSE = np.stack([0.3 * np.cos(T), 0.3 * np.sin(T), T + np.pi / 2], axis=1)
"""A circle of 0.3 m at 1 rad/s: surge 0.3 m/s, no sway."""


def test_velocities_of_a_circle_whose_heading_wraps_and_of_which_poses_are_missing():
    whole = body_velocity(T, POSE)[10:-10]
    assert whole == pytest.approx(np.tile([0.3, 0.0, 1.0], (len(whole), 1)), abs=1e-3)
    pose = POSE.copy()
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    pose[50:54] = np.nan
    found = body_velocity(T, pose)[10:-10]
    assert found[:, 2] == pytest.approx(1.0, abs=1e-3)
    many = body_velocity(T, np.stack([POSE, pose]))
    np.testing.assert_array_equal(many[1, 10:-10], found)
    with pytest.raises(ValueError, match="five are needed"):
        body_velocity(T, np.full_like(pose, np.nan))


def test_each_effect_of_the_camera():
    def off(**given):
        named = {k.replace("__", "."): v for k, v in given.items()}
        return observed(T, POSE, named) - POSE

    assert np.abs(off()).max() == 0
    assert off(camera_latency__latency_s=0.1)[100:, 2] == pytest.approx(-0.1)
    assert off(camera_scale__ratio=0.02)[0, 0] == pytest.approx(0.006)
    turned = off(camera_rotation__angle_rad=np.pi / 2)
    assert turned[0] == pytest.approx([-0.3, 0.3, 0.0])
    assert off(marker_offset__x_m=0.05)[0] == pytest.approx([0.0, 0.05, 0.0], abs=1e-12)
    assert off(pose_filter__time_constant_s=0.1)[150:, 2] == pytest.approx(-0.1, rel=0.2)
    assert off(dropped_frames__probability=0.5)[100:, 2] == pytest.approx(-0.02)
