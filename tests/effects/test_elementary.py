"""Sine and exponential of the inner loop: NumPy's to the last places, wherever a shaft may turn."""

import numpy as np
import pytest
import warp as wp

from sim2real.effects.elementary import decay, sine

ROW = wp.array(dtype=wp.float64)


@wp.kernel(enable_backward=False)
def evaluate(x: ROW, waves: ROW, decays: ROW) -> None:
    k = wp.tid()
    waves[k] = sine(x[k])
    decays[k] = decay(wp.abs(x[k]))


def evaluated(x):
    waves, decays = (wp.zeros(x.size, dtype=wp.float64, device="cpu") for _ in range(2))
    given = wp.from_numpy(x, dtype=wp.float64, device="cpu")
    wp.launch(evaluate, dim=x.size, inputs=[given], outputs=[waves, decays], device="cpu")
    return waves.numpy(), decays.numpy()


@pytest.mark.parametrize("reach", [1e-3, 1.7, 10.0, 500.0, 3e5, 1e8])
def test_they_are_numpys(reach):
    x = np.random.default_rng(0).uniform(-reach, reach, 20000)
    waves, decays = evaluated(x)
    np.testing.assert_allclose(waves, np.sin(x), rtol=0, atol=1e-15)
    np.testing.assert_allclose(decays, np.exp(-np.abs(x)), rtol=2e-15, atol=0)


def test_odd_arguments():
    waves, decays = evaluated(np.array([0.0, np.pi, np.nan, np.inf]))
    assert waves[0] == 0.0 and waves[1] == pytest.approx(np.sin(np.pi), abs=1e-16)
    assert np.isnan(waves[2:]).all()
    assert decays[0] == 1.0 and decays[3] == 0.0 and np.isnan(decays[2])
