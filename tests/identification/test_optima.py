"""Fits with several optima: which one is taken, and what is said of the others."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real.identification import advice
from sim2real.identification.identify import identify
from sim2real.identification.priors import gains
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.search import fit
from sim2real.identification.uncertainty import Uncertainty
from sim2real.inference.parameters import Parameter
from sim2real.recording import read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

NAMES = ("kp_Nm_per_rad", "motor.rotor_inertia_kgm2")


def fit_with(others):
    """A fit of kp 2 and a rotor of 0.002, with other minima that explain the data as well."""
    free = Parameter(NAMES[0], 0.0, 9.0, 1.0), Parameter(NAMES[1], 0.0, 1.0, 1e-3)
    trace = simulated.traced(1, seconds=1.0)
    problem = ServoProblem([trace], plain_row(2.0, 0.1, 0.0), free)
    none = np.zeros(trace.t.size), np.zeros((trace.t.size, 2))
    x = np.array([[2.0, 0.002], *others]) / problem.unit
    return Fit(problem, x[0], *none, 1.0, 1.0, True, x[1:], np.zeros(len(others)))


def test_an_optimum_outside_the_interval_is_named_with_what_differs():
    half_width = np.array([0.1, 0.0001]) / [1.0, 1e-3]
    spread = Uncertainty(np.eye(2), half_width, (), 1.0, 0.9)
    (note,) = advice.on_optima(fit_with([[2.05, 0.003]]), spread)
    assert "rotor inertia 0.003 instead of 0.002" in note
    assert "kp" not in note
    assert advice.on_optima(fit_with([[2.09, 0.00209]]), spread) == []
    assert advice.on_optima(fit_with([]), spread) == []


def test_a_fit_ends_early_where_it_does_not_come_below_its_rival():
    problem = ServoProblem([simulated.traced(1)], plain_row(1.0, 0.05, 0.05), gains(0.002))
    start = plain_row(1.05 * simulated.KP, simulated.KD, simulated.LATENCY)[None]
    best = fit(problem, start)
    worse = replace(best, error=best.error + 0.01)
    assert best.converged and fit(problem, start, rival=(worse, 5.0)).converged
    assert not fit(problem, start, rival=(best, 5.0)).converged


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
