"""The chain: that it samples what it should, goes on where it was, and survives being killed."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated
from scipy.signal import lfilter

from sim2real.errors import InputError
from sim2real.identification.search import fit
from sim2real.identification.uncertainty import uncertainty
from sim2real.model import FittedEffect, JointModel
from sim2real.posterior.chain import convergence, new_chain, read_chain, require, run_chain, sample
from sim2real.posterior.posteriors import joint_sample, read_sample, write_sample
from sim2real.posterior.predictive_check import predictive_check
from sim2real.posterior.servo import sample_servo, servo_problem
from sim2real.recording import Load
from sim2real.robot import Servo

WALKERS, FREE = 12, 2
ORIGIN = {"centre": np.array([0.1, 0.2])}


def skewed(w):
    """Two correlated coordinates, the first exponential of a normal: far from the proposals."""
    x, y = w.T
    first = -0.5 * ((np.exp(0.5 * x) - 1) / 0.5) ** 2 + 0.5 * x
    return first - 0.5 * ((y - 0.8 * x) / 0.6) ** 2


def begun(seed=1):
    return new_chain(WALKERS, FREE, seed, ORIGIN, "mark")


def sampled(steps, seed=1):
    return run_chain(begun(seed), skewed, steps)


def same(a, b):
    assert np.array_equal(a.coordinates, b.coordinates)
    assert np.array_equal(a.log_density, b.log_density)
    assert np.array_equal(a.accepted, b.accepted)
    assert a.random[0] == b.random[0] and np.array_equal(a.random[1], b.random[1])
    assert a.random[2:] == b.random[2:]


def test_it_samples_the_density():
    kept = sampled(3000).coordinates[200:].reshape(-1, FREE)
    grid = np.stack(np.meshgrid(np.linspace(-8, 4, 400), np.linspace(-9, 6, 400)), axis=-1)
    grid = grid.reshape(-1, 2)
    weight = np.exp(skewed(grid))
    mean = np.average(grid, axis=0, weights=weight)
    np.testing.assert_allclose(kept.mean(axis=0), mean, atol=0.06)
    np.testing.assert_allclose(np.cov(kept.T), np.cov(grid.T, aweights=weight), atol=0.12)


def test_blocks_do_not_show_and_the_file_gives_everything_back(tmp_path):
    file = tmp_path / "chain.npz"
    for steps in (1, 130, 131, 402, 730):
        found = read_chain(file) if file.exists() else begun()
        run_chain(found, skewed, steps, file)
    found = read_chain(file)
    same(found, sampled(730))
    assert found.fingerprint == "mark"
    assert np.array_equal(found.origin["centre"], ORIGIN["centre"])


def test_another_seed_is_another_chain():
    assert not np.array_equal(sampled(20).coordinates, sampled(20, seed=2).coordinates)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut short", b"no chain"])
def test_a_file_that_is_no_chain(tmp_path, content):
    file = tmp_path / "chain.npz"
    file.write_bytes(content)
    with pytest.raises(InputError, match="found no chain"):
        read_chain(file)


SCRIPT = """
import sys
from pathlib import Path
from test_chain import begun, skewed
from sim2real.posterior.chain import read_chain, run_chain
file = Path(sys.argv[1])
chain = read_chain(file) if file.exists() else begun()
print("ready", flush=True)
run_chain(chain, skewed, int(sys.argv[2]), file)
"""


def test_killed_at_random_it_ends_as_if_it_had_not_been(tmp_path):
    steps, file = 4000, tmp_path / "chain.npz"
    rng = np.random.default_rng(os.getpid())  # other moments in every run
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    call = [sys.executable, "-c", SCRIPT, str(file), str(steps)]
    environment, killed = {**os.environ, "PYTHONPATH": path}, 0
    for attempt in range(4):
        with subprocess.Popen(call, stdout=subprocess.PIPE, env=environment) as process:
            assert process.stdout.readline() == b"ready\n"
            if attempt < 3:
                time.sleep(float(rng.uniform(0.0, 0.35)))
                process.send_signal(signal.SIGKILL)
        killed += process.returncode == -signal.SIGKILL
    assert killed >= 1 and process.returncode == 0
    same(read_chain(file), sampled(steps))


NAMES = ("kp_Nm_per_rad", "latency_s")


def correlated(steps, phi, seed=0, walkers=12):
    """A chain of first-order autoregressions, whose time is (1 + phi) / (1 - phi)."""
    rng = np.random.default_rng(seed)
    x = np.zeros((steps, walkers, 2))
    x[0] = rng.standard_normal((walkers, 2))
    for k in range(1, steps):
        x[k] = phi * x[k - 1] + np.sqrt(1 - phi**2) * rng.standard_normal((walkers, 2))
    return replace(begun(), coordinates=x, log_density=np.zeros((steps, walkers)))


def test_time_of_a_known_chain():
    result = convergence(correlated(8000, 0.8))
    np.testing.assert_allclose(result.times, 9.0, rtol=0.12)
    assert result.reached and result.thin == 4
    require(result, "posterior of j1", NAMES)


def test_a_short_chain_is_refused_and_told_how_long_it_must_be():
    result = convergence(correlated(300, 0.95, seed=2))
    assert not result.reached
    with pytest.raises(InputError, match="run again with --steps [0-9]+: the chain continues") as e:
        require(result, "posterior of j1", NAMES)
    needed = int(str(e.value).split("--steps ")[1].split(":")[0])
    assert needed >= 50 * result.times.max()


def test_a_chain_that_stands_still_is_refused():
    chain = correlated(200, 0.5)
    result = convergence(replace(chain, coordinates=np.ones_like(chain.coordinates)))
    assert not result.reached


def test_what_is_kept():
    chain = correlated(4000, 0.8)
    result = convergence(chain)
    draws = sample(chain, result)
    assert draws.shape == (len(range(result.burn_in, 4000, result.thin)) * 12, 2)
    assert np.array_equal(draws[:12], chain.coordinates[result.burn_in])


@pytest.mark.parametrize("phi", [0.9, 0.98])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.8])
def test_the_steps_that_a_message_names_are_enough(phi, share):
    """Chains that stop at a share of what they need, and the same chains after those steps."""
    time = (1 + phi) / (1 - phi)
    for seed in range(5):
        short = convergence(correlated(int(share * 50 * time), phi, seed))
        needed = short.needed
        assert needed <= 12 * 50 * time
        assert convergence(correlated(needed, phi, seed)).reached


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
    assert found.problem.exact and found.convergence.reached
    assert found.noise_sd == pytest.approx(simulated.NOISE, rel=0.15)


def test_its_widths_are_those_of_the_fit(given, found):
    best = fit(found.problem, found.problem.row[None])
    spread = uncertainty(best)
    expected = best.problem.values(best.x + [[0.0], [1.0]] * spread.sd)
    sd = found.values.std(axis=0)
    np.testing.assert_allclose(sd, np.abs(np.diff(expected, axis=0)[0]), rtol=0.15)
    between = spread.correlation[[0, 0, 1], [1, 2, 2]]
    sampled = np.corrcoef(found.values.T)[[0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(sampled, between, atol=0.1)


def test_a_motor_is_sampled_with_all_that_was_fitted():
    servo = Servo("small", 1.6, 5.2, 0.0)
    line = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2}
    joint = replace(JOINT, law="motor", motor=line)
    found = sample_servo([simulated.traced(1, seconds=8.0)], joint, servo, steps=300)
    assert found.names[3:] == ("motor.stall_torque_Nm", "motor.no_load_speed_rad_s")
    assert "log-normal 1.6 N m" in str(found.parameters[3]) and not found.problem.exact
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
