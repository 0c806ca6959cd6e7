"""Calibration by an emulator: what was put in comes out, and the emulator is the simulator nearby.

The simulator is the twin here, with its law held: it takes what the fluid takes, in milliseconds.
"""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos
from test_calibrate import swum

from sim.inference.calibration import FluidSettings, calibrate_in_fluid
from sim.inference.coordinates import (
    effect_parameters,
    servo_parameters,
    signals_of,
    water_parameters,
)
from sim.inference.emulator import emulator
from sim.inference.swims import by_twin, simulated, swim_of, with_values
from sim.robot.swimmer import Swimmer, least_viscosity
from sim2real.errors import InputError
from sim2real.recording import read_recording

NOISE = np.array([0.005, 0.005, 0.02, 0.002, 0.002, 0.002])
TWIN = by_twin(FISH)


def recorded(truth, seed=0):
    return replace(swum(truth, seed), noise=NOISE)


def some(*names):
    return [p for name in names for p in effect_parameters(name)]


def calibrated(truth, count, **options):
    settings = FluidSettings(0.01, rollouts=count)
    return calibrate_in_fluid([recorded(truth)], servos(), FISH, TWIN, settings, **options)


def test_an_emulator_is_the_simulator_near_its_centre():
    free = [*servo_parameters(servos(), FISH), *some("form_drag", "skin_elasticity")]
    swim = recorded({})
    emulated = emulator(TWIN, [swim], servos(), free, count=40)
    near = with_values(
        servos(),
        {
            "form_drag.coefficient": 0.06,
            "j1.latency_s": 0.074,
            "skin_elasticity.stiffness_Nm_per_rad": 0.35,
        },
    )
    (said,) = signals_of([near], swim, emulated)
    start, exact = simulated(swim, [servos(), near], TWIN)
    off = np.sqrt(np.mean((said - exact) ** 2, axis=0))
    assert (off < 0.2 * np.sqrt(np.mean((start - exact) ** 2, axis=0)) + 1e-3).all()


def test_rollouts_that_were_stopped_are_left_out_and_most_must_be_whole():
    def stopping(*rows):
        def simulator(models, command, start):
            track = TWIN(models, command, start)
            track[list(rows), 100:] = np.nan
            return track

        return simulator

    swim = recorded({})
    track = emulator(stopping(3), [swim], servos(), some("form_drag"), count=8)([servos()], swim)
    assert np.isfinite(track).all()
    with pytest.raises(InputError, match="5 of 8 rollouts stopped"):
        emulator(stopping(*range(5)), [swim], servos(), some("form_drag"), count=8)


def test_what_was_put_in_comes_out_of_the_emulator():
    truth = {"form_drag.coefficient": 0.3, "j1.latency_s": 0.075, "j2.kp_Nm_per_rad": 2.2}
    found = calibrated(truth, 64, gains=True)
    names = [p.name for p in found.free]
    low, high = found.interval(0.99).T
    for name, value in truth.items():
        k = names.index(name)
        assert low[k] < value < high[k], name
    assert found.grid is None
    assert (found.rmse[1] < 1.25 * NOISE).all()


def test_a_batch_has_more_rollouts_than_parameters():
    free = servo_parameters(servos(), FISH, gains=True)
    with pytest.raises(InputError, match="rollouts: found 10, expected at least 11, for 9 param"):
        emulator(TWIN, [recorded({})], servos(), free, count=10)


def test_coarser_cells_widen_the_intervals():
    def thicker(models, command, start):
        return TWIN(
            [with_values(m, {"linear_drag.coefficient": 0.5}) for m in models], command, start
        )

    alone, with_coarse = (calibrated({}, 24, coarser=coarse) for coarse in (None, thicker))
    assert alone.best == pytest.approx(with_coarse.best)
    widths = [np.diff(one.interval(), axis=1)[:, 0] for one in (alone, with_coarse)]
    assert (widths[1] >= widths[0]).all()
    form = [p.name for p in alone.free].index("form_drag.coefficient")
    assert widths[1][form] > 1.2 * widths[0][form]


def test_noise_of_a_shipped_swim_is_what_the_camera_has():
    swim = swim_of(read_recording("datasets/pool/clean.csv"), FISH)
    weight = np.sqrt(np.sum(np.arange(-5, 6) ** 2)) * 0.02  # of the estimator's parabola
    assert swim.noise[:3] == pytest.approx(np.array([0.002, 0.002, 0.009]) / weight, rel=0.3)
    assert swim.noise[3:] == pytest.approx([0.0019] * 3, rel=0.35)


def test_each_box_has_the_viscosity_of_its_model_but_none_below_that_of_water():
    given = [with_values(servos(), {"water.viscosity_m2_s": v}) for v in (3e-4, 1e-7)]
    swimmer = Swimmer(FISH, [*given, servos()], n_envs=3, cell_m=0.04)
    least = least_viscosity(0.04)
    assert swimmer.viscosity_m2_s == pytest.approx([3e-4, 1e-6, least])
    viscosity = water_parameters(FISH, 0.04)[-1]
    assert viscosity.low == least < viscosity.nominal < viscosity.high
