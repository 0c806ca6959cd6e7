"""Calibration by an emulator: what was put in comes out, and the emulator is the simulator nearby.

The simulator is the twin here, with its law held: it takes what the fluid takes, in milliseconds.
"""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos
from test_calibrate import SENT, TIMES, swum

from sim.calibration.emulator import Batch, Emulator, rollouts
from sim.calibration.fluid_calibration import calibrate_in_fluid
from sim.calibration.swim_parameters import effect_parameters, servo_parameters, water_parameters
from sim.inference.swims import Swim, by_twin, simulated, swim_of, values_of, with_values
from sim.robot.swimmer import Swimmer, least_viscosity
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter
from sim2real.recording import read_recording

NOISE = np.array([0.005, 0.005, 0.02, 0.002, 0.002, 0.002])


def recorded(truth, seed=0):
    return replace(swum(truth, seed), noise=NOISE)


def some(*names):
    return [p for name in names for p in effect_parameters(name)]


def test_an_emulator_is_the_simulator_near_its_centre():
    free = [*servo_parameters(servos(), FISH), *some("form_drag", "skin_elasticity")]
    swim, twin = recorded({}), by_twin(FISH)
    batch = rollouts(twin, swim, servos(), free, count=40)
    assert batch.track.shape == (40, TIMES.size, 6)
    assert batch.values[0] == pytest.approx(values_of(servos(), batch.names))
    near = with_values(
        servos(),
        {
            "form_drag.coefficient": 0.06,
            "j1.latency_s": 0.074,
            "skin_elasticity.stiffness_Nm_per_rad": 0.35,
        },
    )
    (said,), (exact,) = (simulated(swim, [near], s) for s in (Emulator([batch]), twin))
    (start,) = simulated(swim, [servos()], twin)
    off = np.sqrt(np.mean((said - exact) ** 2, axis=0))
    assert (off < 0.2 * np.sqrt(np.mean((start - exact) ** 2, axis=0)) + 1e-3).all()


def test_rollouts_that_were_stopped_are_left_out_and_most_must_be_whole():
    free = some("form_drag")
    batch = rollouts(by_twin(FISH), recorded({}), servos(), free, count=8)
    broken = batch.track.copy()
    broken[3, 100:] = np.nan
    track = Emulator([replace(batch, track=broken)])([servos()], SENT, np.zeros(3))
    assert np.isfinite(track).all()
    broken[:5] = np.nan
    with pytest.raises(InputError, match="5 of 8 rollouts stopped"):
        Emulator([replace(batch, track=broken)])


def test_a_path_comes_back_from_its_steps():
    swim = recorded({})
    track = by_twin(FISH)([servos()] * 2, SENT, np.array([0.3, -0.2, 0.9]))
    batch = Batch(swim, ("form_drag.coefficient",), np.array([[0.0], [0.0]]), track)
    again = Emulator([batch])([servos()], SENT, np.array([0.3, -0.2, 0.9]))
    assert again == pytest.approx(track[:1], abs=1e-9)


def test_swims_with_the_same_commands_are_told_apart_by_where_they_began():
    free, twin = some("form_drag"), by_twin(FISH)
    first = recorded({})
    second = replace(first, start=np.array([0.5, 0.2, 1.0]))
    batches = [rollouts(twin, swim, servos(), free, count=8) for swim in (first, second)]
    turned = batches[1].track.copy()
    turned[..., 3:] += 0.1  # not what the first swim's rollouts show
    both = Emulator([batches[0], replace(batches[1], track=turned)])
    for swim, offset in ((first, 0.0), (second, 0.1)):
        (said,) = both([servos()], SENT, swim.start)
        (alone,) = Emulator(batches[:1])([servos()], SENT, swim.start)
        np.testing.assert_allclose(said[:, 3:], alone[:, 3:] + offset, atol=1e-9)
    with pytest.raises(KeyError, match="2 swims with these commands"):
        both([servos()], SENT, np.array([9.0, 9.0, 0.0]))


def test_what_was_put_in_comes_out_of_the_emulator():
    truth = {"form_drag.coefficient": 0.3, "j1.latency_s": 0.075, "j2.kp_Nm_per_rad": 2.2}
    found = calibrate_in_fluid(
        [recorded(truth)], servos(), FISH, by_twin(FISH), cell_m=0.01, gains=True, count=64
    )
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
        rollouts(by_twin(FISH), recorded({}), servos(), free, count=10)


def test_coarser_cells_widen_the_intervals():
    swims, twin = [recorded({})], by_twin(FISH)

    def thicker(models, command, start):
        return twin(
            [with_values(m, {"linear_drag.coefficient": 0.5}) for m in models], command, start
        )

    alone, with_coarse = (
        calibrate_in_fluid(swims, servos(), FISH, twin, cell_m=0.01, coarser=coarse, count=24)
        for coarse in (None, thicker)
    )
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


def test_the_waters_viscosity_begins_where_cells_can_hold_it():
    for cell in (0.01, 0.02):
        viscosity = water_parameters(FISH, cell)[-1]
        assert viscosity.low == least_viscosity(cell) < viscosity.nominal < viscosity.high
    assert isinstance(viscosity, Parameter)
    assert least_viscosity(0.01) == pytest.approx(2.4e-5)
    swim = Swim("s", TIMES, SENT, np.zeros(3), np.zeros((TIMES.size, 6)))
    assert swim.noise == 0.0


def test_each_box_has_the_viscosity_of_its_model_but_none_below_that_of_water():
    given = [with_values(servos(), {"water.viscosity_m2_s": v}) for v in (3e-4, 1e-7)]
    swimmer = Swimmer(FISH, [*given, servos()], n_envs=3, cell_m=0.04)
    least = least_viscosity(0.04)
    assert swimmer.viscosity_m2_s == pytest.approx([3e-4, 1e-6, least])
