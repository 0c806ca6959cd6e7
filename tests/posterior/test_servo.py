"""One servo's posterior: right, and refusing what is not its own."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from scipy.signal import lfilter

from sim2real.errors import InputError
from sim2real.identification.search import fit
from sim2real.identification.uncertainty import uncertainty
from sim2real.model import FittedEffect, JointModel
from sim2real.posterior.posteriors import joint_sample, read_sample, write_sample
from sim2real.posterior.servo import predictive_check, sample_servo, servo_problem
from sim2real.recording import Load
from sim2real.robot import Servo

JOINT = JointModel(2.0, 0.05, 0.06, simulated.INERTIA, load=Load(simulated.INERTIA))
TRUTH = np.array([simulated.KP, simulated.KD, simulated.LATENCY])


@pytest.fixture(scope="module")
def given():
    return simulated.traced(1)


@pytest.fixture(scope="module")
def found(given):
    return sample_servo([given], JOINT, steps=400)


def test_it_finds_the_servo_and_says_how_sure(found):
    low, middle, high = found.quantiles(0.01, 0.5, 0.99)
    assert (low < TRUTH).all() and (high > TRUTH).all()
    np.testing.assert_allclose(middle, TRUTH, rtol=0.01)
    assert found.chain.reached
    assert found.chain.origin["noise"][0] == pytest.approx(simulated.NOISE, rel=0.15)


def test_its_widths_are_those_of_the_fit(given, found):
    best = fit(found.problem, found.problem.row[None])
    spread = uncertainty(best)
    expected = best.problem.values(best.x + [[0.0], [1.0]] * spread.sd)
    sd = found.values.std(axis=0)
    np.testing.assert_allclose(sd, np.abs(np.diff(expected, axis=0)[0]), rtol=0.15)
    between = list(spread.correlation(best.names).values())
    sampled = np.corrcoef(found.values.T)[[0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(sampled, between, atol=0.1)


def test_a_motor_is_sampled_with_all_that_was_fitted():
    servo = Servo("small", 1.6, 5.2, 0.0)
    line = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2}
    joint = replace(JOINT, law="motor", motor=line)
    found = sample_servo([simulated.traced(1, seconds=8.0)], joint, servo, steps=300)
    assert found.names[3:] == ("motor.stall_torque_Nm", "motor.no_load_speed_rad_s")
    assert "log-normal 1.6 N m" in str(found.parameters[3])
    low, high = found.quantiles(0.01, 0.99)
    assert (low[:3] < TRUTH).all() and (high[:3] > TRUTH).all()


def test_what_is_random_is_not_sampled(given):
    jitter = FittedEffect("latency_jitter", {"halfwidth_s": 0.01})
    backlash = FittedEffect("backlash", {"gap_rad": 0.03})
    problem = servo_problem([given], replace(JOINT, effects=(jitter, backlash)))
    assert problem.names[3:] == ("backlash.gap_rad",)
    assert problem.parameters[3].unit == "rad" and "log-uniform" in str(problem.parameters[0])


def test_noise_that_is_correlated_widens_it(given, found):
    white = np.random.default_rng(4).standard_normal(given.t.size)
    wander = lfilter([0.0015 * np.sqrt(1 - 0.95**2)], [1, -0.95], white)
    wide = sample_servo([replace(given, position=given.position + wander)], JOINT, steps=400)
    assert wide.values.std(axis=0)[0] > 1.15 * found.values.std(axis=0)[0]


def test_what_a_kill_left_is_cleared_and_the_chain_of_other_data_is_refused(given, tmp_path):
    file = tmp_path / "chain.npz"
    (tmp_path / ".chain.npz.half").write_bytes(b"half")
    sample_servo([given], JOINT, steps=5, file=file)
    assert [one.name for one in tmp_path.iterdir()] == ["chain.npz"]
    other = replace(given, position=given.position + 1e-6)
    for trace, seed in ((other, 0), (given, 1)):
        with pytest.raises(InputError, match="remove the file"):
            sample_servo([trace], JOINT, steps=5, file=file, seed=seed)
    with pytest.raises(InputError, match="at least 6 for 3 parameters"):
        sample_servo([given], JOINT, walkers=5)


def test_predictions_of_a_recording_never_seen(given, found):
    def checked(**effects):
        unseen = simulated.traced(7, **effects)
        return predictive_check(found, JOINT, [given], unseen, np.random.default_rng(0))

    check = checked()
    for level, share in check.covered.items():
        assert share == pytest.approx(level, abs=0.06)
    assert check.holds and check.rmse == pytest.approx(simulated.NOISE, rel=0.15)
    assert not checked(backlash={"gap_rad": 0.05}).holds, "physics is missing"


def test_sample_of_all_joints(found, tmp_path):
    sample = joint_sample({"j1": found, "j2": found}, np.random.default_rng(0))
    write_sample(sample, tmp_path / "posterior.npz")
    again = read_sample(tmp_path / "posterior.npz")
    assert again.names == sample.names and again.units == sample.units
    assert np.allclose(again.values, sample.values, rtol=1e-6, atol=0)  # stored as float32
    assert again.names[0] == "j1.kp_Nm_per_rad" and again.units[2] == "s"
    within = np.corrcoef(again.values[:, :2].T)[0, 1]
    assert within == pytest.approx(np.corrcoef(found.values[:, :2].T)[0, 1], abs=0.06)
    assert abs(np.corrcoef(again.values[:, [0, 3]].T)[0, 1]) < 0.08
