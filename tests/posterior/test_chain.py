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

from sim2real.errors import InputError
from sim2real.posterior.chain import new_chain, read_chain, require, run_chain

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
    result = correlated(8000, 0.8)
    np.testing.assert_allclose(result.times, 9.0, rtol=0.12)
    assert result.reached and result.thin == 4
    require(result, "posterior of j1", NAMES)


def test_a_short_chain_is_refused_and_told_how_long_it_must_be():
    result = correlated(300, 0.95, seed=2)
    assert not result.reached
    with pytest.raises(InputError, match="run again with --steps [0-9]+: the chain continues") as e:
        require(result, "posterior of j1", NAMES)
    needed = int(str(e.value).split("--steps ")[1].split(":")[0])
    assert needed >= 50 * result.times.max()


def test_a_chain_that_stands_still_is_refused():
    chain = correlated(200, 0.5)
    still = replace(chain, coordinates=np.ones_like(chain.coordinates))
    assert not still.reached


def test_what_is_kept():
    chain = correlated(4000, 0.8)
    draws = chain.sample()
    assert draws.shape == (len(range(chain.burn_in, 4000, chain.thin)) * 12, 2)
    assert np.array_equal(draws[:12], chain.coordinates[chain.burn_in])


@pytest.mark.parametrize("phi", [0.9, 0.98])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.8])
def test_the_steps_that_a_message_names_are_enough(phi, share):
    """Chains that stop at a share of what they need, and the same chains after those steps."""
    time = (1 + phi) / (1 - phi)
    for seed in range(5):
        short = correlated(int(share * 50 * time), phi, seed)
        needed = short.needed
        assert needed <= 12 * 50 * time
        assert correlated(needed, phi, seed).reached


def test_a_chain_ends_once_it_is_long_enough():
    found = run_chain(begun(3), skewed, 5000, spans=60)
    assert found.spans >= 60
    assert found.steps < 2500
    whole = run_chain(begun(3), skewed, found.steps)
    assert (whole.coordinates == found.coordinates).all()
