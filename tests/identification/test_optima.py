"""Fits with several optima: which one is taken, and what is said of the others."""

import numpy as np
import pytest

from sim2real.identification import advice
from sim2real.identification.identify import identify
from sim2real.recording import read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

NAMES = ("kp_Nm_per_rad", "motor.rotor_inertia_kgm2")


def test_an_optimum_outside_the_interval_is_named_with_what_differs():
    values, half_width = np.array([2.0, 0.002]), np.array([0.1, 0.0001])
    (note,) = advice.on_optima(NAMES, values, half_width, [np.array([2.05, 0.003])])
    assert "rotor inertia 0.003 instead of 0.002" in note
    assert "kp" not in note
    assert advice.on_optima(NAMES, values, half_width, [values + 0.9 * half_width]) == []
    assert advice.on_optima(NAMES, values, half_width, []) == []


@pytest.mark.parametrize("gain, held_out", [(200, "up_and_down"), (800, "lift_and_drop")])
def test_a_real_servo_is_predicted_on_a_trajectory_that_no_fit_used(realdata, gain, held_out):
    folder = realdata / "bam_xl330"
    paths = sorted(folder.glob(f"xl330_kp{gain}_*.csv"))
    recordings = [read_recording(path) for path in paths]
    (scored,) = (r for r in recordings if r.name.endswith(held_out))
    robot = read_robot(folder / "robot.toml")
    model = identify(recordings, robot, held_out=scored.name, refit=False)
    sent = {"j1": scored.command[:, 0]}
    angle = predict(model, scored.t, sent, scored.loads)["j1"]
    error = (angle - scored.position[:, 0])[: scored.powered(0)]
    assert np.sqrt(np.nanmean(error**2)) < 0.06
    joint = model.joints["j1"]
    per_rad = joint.kp_Nm_per_rad / joint.motor["stall_torque_Nm"]
    assert per_rad == pytest.approx(0.00287 * gain, rel=0.05)  # duty per radian, as reported
