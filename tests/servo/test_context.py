"""Recordings in another context: the same servo with another supply voltage or firmware gain."""

from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from simulated import INERTIA, LATENCY, recording, row, traced

from sim2real.identification.priors import gains
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import fit
from sim2real.model import Model
from sim2real.recording import Load
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS, context_factors, joint_row, stated
from sim2real.servo.prediction import predict_recordings
from sim2real.servo.rollout import rollout, rollout_on
from sim2real.servo.trace import reported_drive, trace

ONE = {"supply_ratio": 1.0, "gain_ratio": 1.0}


def column(values, name):
    return values[COLUMNS.index(name)]


def test_supply_scales_what_the_voltage_gives_and_gain_the_gain():
    factors = context_factors(0.5, 3.0)
    assert column(factors, "kp_Nm_per_rad") == 1.5
    assert column(factors, "motor.stall_torque_Nm") == 0.5
    assert column(factors, "motor.no_load_speed_rad_s") == 0.5
    assert np.count_nonzero(factors != 1) == 3


def test_every_simulation_heeds_the_context():
    plain = traced()
    soft = replace(plain, gain_ratio=0.25, sample_delay_s=0.003)
    weak = row()
    weak[0] *= 0.25
    weak[COLUMNS.index("latency_s")] -= 0.003
    expected = rollout(weak[None], plain.t, plain.command)[0]
    np.testing.assert_allclose(rollout_on(soft, row()[None])[0], expected, atol=1e-9)
    still = replace(soft, position=np.zeros_like(plain.t))
    batch = Batch([[still, replace(still, gain_ratio=1.0)]])
    problems = Problems(np.zeros(1, dtype=np.int32), row()[None, None], np.zeros((1, 1)))
    angle = batch.evaluate(problems, keep=True).residual[0]
    np.testing.assert_allclose(angle[0], expected, atol=2e-4)
    assert np.abs(angle[1] - expected).max() > 0.01


def test_a_recording_that_samples_late_shows_the_whole_latency():
    delay, sent = 0.0026, recording(seconds=6.0, noise=0.0)
    times = np.sort(np.concatenate([sent.t, sent.t + delay]))
    angle = rollout(row()[None], times, np.repeat(sent.command[:, 0], 2))[0][1::2]
    angle += np.random.default_rng(1).normal(0, 0.0005, angle.size)
    late = replace(sent, position=angle[:, None], metadata={"context": {"sample_delay_s": delay}})
    start = row()
    found = fit(ServoProblem([trace(late, "j1")], start, gains(INERTIA)), start[None])
    assert column(found.row, "latency_s") == pytest.approx(LATENCY, abs=2e-4)
    model = Model({"j1": stated(row(), Load(INERTIA))})
    (rmse,) = predict_recordings([late], model).rmse.values()
    assert rmse < 0.0006


@pytest.mark.parametrize("name", ["supply_ratio", "gain_ratio"])
def test_a_prediction_is_of_the_recording_s_context(name):
    motor = {"stall_torque_Nm": 0.4, "no_load_speed_rad_s": 5.0}
    model = Model({"j1": replace(stated(row(), Load(INERTIA)), law="motor", motor=motor)})
    there = replace(recording(seconds=4.0), metadata={"context": {name: 0.5}})
    (angles,) = predict_recordings([there], model).angles
    scaled = joint_row(model.joints["j1"], None) * context_factors(**{**ONE, name: 0.5})
    expected = rollout(scaled[None], there.t, there.command[:, 0])[0]
    np.testing.assert_allclose(angles[:, 0], expected, atol=1e-9)
    (usual,) = predict_recordings([replace(there, metadata={})], model).angles
    assert np.abs(usual[:, 0] - expected).max() > 0.01


def test_the_reported_drive_of_late_samples_has_the_same_latency():
    t, delay, latency = 0.01 * np.arange(2000), 0.006, 0.008

    def sent(at):
        return 0.3 * np.sin(2 * np.pi * 0.5 * at) + 0.2 * np.sin(2 * np.pi * 1.3 * at)

    angle = sent(t + delay - 0.05)
    drive = sent(t + delay - latency) - angle
    found = reported_drive(t, sent(t), angle, drive, delay)
    assert found.latency_s == pytest.approx(latency, abs=5e-4)


def test_a_context_that_is_none_is_refused_in_one_line():
    bad = replace(recording(), metadata={"context": {"supply_ratio": -1}})
    message(lambda: trace(bad, "j1"), "context.supply_ratio", "-1", "above 0")


def test_an_unknown_parameter_of_the_motor_is_refused():
    joint = replace(stated(row(), Load(INERTIA)), law="motor", motor={"stall_torque": 1.0})
    message(lambda: predict_recordings([recording()], Model({"j1": joint})), "'stall_torque'")
