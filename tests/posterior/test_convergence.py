from dataclasses import replace

import numpy as np
import pytest
from test_chain import begun

from sim2real.errors import InputError
from sim2real.posterior.chain import convergence, require, sample

NAMES = ("kp_Nm_per_rad", "latency_s")


def correlated(steps, keep, seed=0, walkers=12):
    """A chain of first-order autoregressions, whose time is (1 + keep) / (1 - keep)."""
    rng = np.random.default_rng(seed)
    x = np.zeros((steps, walkers, 2))
    x[0] = rng.standard_normal((walkers, 2))
    for k in range(1, steps):
        x[k] = keep * x[k - 1] + np.sqrt(1 - keep**2) * rng.standard_normal((walkers, 2))
    return replace(begun(), coordinates=x, log_density=np.zeros((steps, walkers)))


def test_time_of_a_known_chain():
    found = convergence(correlated(8000, 0.8))
    np.testing.assert_allclose(found.times, 9.0, rtol=0.12)
    assert found.reached and found.thin == 4
    require(found, "posterior of j1", NAMES)


def test_a_short_chain_is_refused_and_told_how_long_it_must_be():
    found = convergence(correlated(300, 0.95, seed=2))
    assert not found.reached
    with pytest.raises(InputError, match="run again with --steps [0-9]+: the chain continues") as e:
        require(found, "posterior of j1", NAMES)
    needed = int(str(e.value).split("--steps ")[1].split(":")[0])
    assert needed >= 50 * found.times.max()


def test_a_chain_that_stands_still_is_refused():
    chain = correlated(200, 0.5)
    found = convergence(replace(chain, coordinates=np.ones_like(chain.coordinates)))
    assert not found.reached


def test_what_is_kept():
    chain = correlated(4000, 0.8)
    found = convergence(chain)
    kept = sample(chain, found)
    assert kept.shape == (len(range(found.burn_in, 4000, found.thin)) * 12, 2)
    assert np.array_equal(kept[:12], chain.coordinates[found.burn_in])
