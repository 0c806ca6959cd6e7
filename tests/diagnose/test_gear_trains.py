"""Gear trains of two masses: found beside friction, located where they only rattle."""

import numpy as np
import pytest
import simulated

from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.located import rattle, rattles
from sim2real.servo.trace import trace

NOISE, PERIOD = simulated.NOISE, 0.02
STILL = simulated.recording(seconds=30.0, command=lambda t: 0.0 * t)


@pytest.mark.parametrize(("on_output", "restitution"), [(0.0, 0.0), (1.0, 0.6)])
def test_a_gap_is_found_behind_friction_on_either_side(on_output, restitution):
    """The stated load is that of the output; friction holds it in the gap, flanks may rebound."""
    play = {
        "gap_rad": 0.04, "rotor_inertia_kgm2": 4e-4, "output_friction_Nm": 0.04,
        "control_on_output": on_output, "restitution": restitution,
    }  # fmt: skip
    found = diagnose(
        [simulated.recording(k, f"{k}", seconds=12.0, noise=5e-4, backlash=play) for k in (1, 2)],
        simulated.robot("j1"),
    )
    named = found.effects[0]
    assert "backlash" in named.group
    gap = named.parameters["gap_rad"].mean
    assert gap == pytest.approx(0.04, rel=0.25)


def rattling(frequency_Hz, seed, rms=2 * NOISE):
    """White noise, and a wave whose phase wanders."""
    rng = np.random.default_rng(seed)
    t = STILL.t
    phase = 2 * np.pi * frequency_Hz * t + np.cumsum(rng.normal(0.0, 0.2, t.size))
    return rng.normal(0.0, NOISE, t.size) + np.sqrt(2) * rms * np.sin(phase)


def test_a_rattle_is_located_and_its_size_is_that_of_the_wave():
    found = rattle([STILL.t] * 2, [rattling(9.0, seed) for seed in (0, 1)])
    assert found.frequency_Hz == pytest.approx(9.0, abs=0.6)
    assert found.sd_rad == pytest.approx(2 * NOISE, rel=0.2)
    assert "near" in str(found) and "gap of" in str(found)


@pytest.mark.parametrize("seed", range(20))
def test_white_noise_and_slow_residuals_do_not_rattle(seed):
    rng = np.random.default_rng(seed)
    white = [rng.normal(0.0, NOISE, STILL.t.size) for _ in range(2)]
    assert rattle([STILL.t] * 2, white) is None
    decaying = [np.convolve(x, np.exp(-PERIOD * np.arange(40) / 0.1))[: x.size] for x in white]
    assert rattle([STILL.t] * 2, decaying) is None


def test_what_all_joints_have_is_a_vibration_of_the_bench():
    one = trace(STILL, "j1")
    shared = np.array([[rattling(9.0, 0)], [rattling(9.0, 1)], [rattling(14.0, 2)]])
    found = rattles([[one]] * 3, shared)
    assert found[:2] == [None, None]
    assert found[2].frequency_Hz == pytest.approx(14.0, abs=0.6)
