from dataclasses import replace

import numpy as np
import pytest
from test_chain import begun

from sim2real.errors import InputError
from sim2real.posterior.chain import convergence, require, sample

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
