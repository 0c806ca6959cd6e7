"""Calibration on swims of the twin, in the twin and by an emulator: what was put in comes out."""

import json
from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos

from sim.inference.calibration import Calibrated, Calibration, calibrate, calibrate_in_fluid
from sim.inference.coordinates import (
    effect_parameters,
    servo_parameters,
    twin_parameters,
    water_parameters,
)
from sim.inference.in_water import emulator
from sim.inference.law_error import marginalised
from sim.inference.swims import Swim, by_followed_twin, by_twin, simulated, swim_of, with_values
from sim.robot.swimmer import CONTROL_S, Swimmer, least_viscosity
from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.recording import Recording, read_recording
from sim2real.robot import read_robot

TIMES = CONTROL_S * np.arange(600)
SENT = np.array(
    [min(1.0, t) * np.array([0.3, 0.45, 0.6]) * np.sin(2 * np.pi * t - 1.2 * np.arange(3))
     + 0.2 * np.sin(0.8 * t) for t in TIMES]
)  # fmt: skip


def swum(truth, seed=0, model=None, robot=FISH):
    rng = np.random.default_rng(seed)
    made, nowhere = [with_values(model or servos(), truth)], np.zeros((TIMES.size, 3))
    empty = Swim("made", TIMES, SENT, np.zeros(3), np.empty((0, 6)), nowhere)
    (signals,), (track,) = simulated(empty, made, by_twin(robot)), by_twin(robot)(made, empty)
    noise = rng.standard_normal(signals.shape) * [0.005, 0.005, 0.02, 0.002, 0.002, 0.002]
    return replace(empty, signals=signals + noise, pose=track[:, :3])


def test_what_was_put_in_comes_out():
    truth = {"form_drag.coefficient": 1.0, "added_mass.ratio": 0.3}
    truth |= {"j1.latency_s": 0.08, "j2.latency_s": 0.068, "j3.latency_s": 0.06}
    free = [*effect_parameters("form_drag"), *effect_parameters("added_mass")]
    free += servo_parameters(servos(), FISH)
    found = calibrate([swum(truth)], servos(), free, by_twin(FISH))
    for p, best, (low, high) in zip(found.free, found.best, found.interval(0.999), strict=True):
        assert low < truth[p.name] < high, p.name
        assert best == pytest.approx(truth[p.name], rel=0.35), p.name
    assert found.rmse[1, 0] < 0.7 * found.rmse[0, 0]
    assert found.rmse[1, :3] == pytest.approx([0.005, 0.005, 0.02], rel=0.2)


def test_an_error_of_the_law_does_not_pass_for_drag_area():
    robot, model = read_robot("datasets/pool/robot.toml"), replace(servos(), body={})
    swim = swum({"twin.head": 2.0, "twin.tail": 1.5}, model=model, robot=robot)
    free = twin_parameters(model, robot)
    found = calibrate([swim], model, free, by_twin(robot))
    (k,) = [k for k, p in enumerate(free) if p.name == "appendage_area.ratio"]
    low, high = found.interval()[k]
    assert abs(found.best[k]) < 1.5 * free[k].prior_sd
    assert low < 0.0 < high


def test_camera_effects_are_seen_through():
    truth = {"camera_latency.latency_s": 0.1, "camera_rotation.angle_rad": 0.1}
    free = [*effect_parameters("camera_latency"), *effect_parameters("camera_rotation")]
    found = calibrate([swum(truth)], servos(), free, by_twin(FISH))
    assert found.best == pytest.approx([0.1, 0.1], rel=0.1)


def test_a_bench_recording_is_no_swim():
    t = CONTROL_S * np.arange(20)
    bench = Recording("bench", "servo", ("j1", "j2", "j3"), t, np.zeros((20, 3)), np.zeros((20, 3)))
    with pytest.raises(InputError, match="body.x_m: found no such column"):
        swim_of(bench, FISH)


def test_angles_sampled_late_are_of_their_own_time():
    delay, t = 0.008, CONTROL_S * np.arange(200)
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    columns = {name: np.sin(t + k) for k, name in enumerate(names)}
    angles = np.sin(3 * (t[:, None] + delay) + np.arange(3))
    context = {"context": {"sample_delay_s": delay}}
    late = Recording(
        "late", "pool", ("j1", "j2", "j3"), t, angles, angles, columns=columns, metadata=context
    )
    found = swim_of(late, FISH).signals[1:, 3:]
    np.testing.assert_allclose(found, np.sin(3 * t[1:, None] + np.arange(3)), atol=1e-3)


def test_the_shipped_swims_are_calibrated_by_the_command(tmp_path, capsys):
    out = tmp_path / "calibrated.json"
    given = ["datasets/pool/clean.csv", "--robot", "datasets/pool/robot.toml"]
    given += ["--model", "datasets/pool/model.json", "--no-plots"]
    assert main(["calibrate", *given, "--out", str(out)]) == 0
    written = json.loads(out.read_text())
    fit = written["fit"]
    for signal, most in (("surge", 1.0), ("sway", 0.7), ("yaw_rate", 1.5)):
        figures = fit[f"body.{signal}"]
        assert figures["heldout"] < most * figures["heldout_before"]
    for joint, truth in (("j1", 0.066), ("j2", 0.062), ("j3", 0.074)):  # of truth.json
        low, high = written["body"]["interval"][f"{joint}.latency_s"]
        assert low < truth < high, joint
        assert high - low < 0.012, joint
        assert written["joints"][joint]["interval"]["latency_s"] == pytest.approx([low, high])
    printed = capsys.readouterr().out
    assert "held-out error" in printed
    assert "gains that are held or for effects that are missing" in printed  # kp is 9 % off


def test_a_hidden_skin_does_not_pass_for_latency():
    truth = {"skin_elasticity.stiffness_Nm_per_rad": 0.6, "j2.latency_s": 0.08}
    free = servo_parameters(servos(), FISH)
    nominal = np.array([p.nominal for p in free])
    skins = by_followed_twin(FISH, substeps=8)
    mean, covariance = marginalised([swum(truth)], servos(), FISH, free, nominal, skins)
    for p, at, sd in zip(free, mean, np.sqrt(np.diag(covariance)), strict=True):
        assert at == pytest.approx(truth.get(p.name, p.nominal), abs=3 * sd), p.name
        assert sd < 0.004
    one = Calibrated(servos(), tuple(free), nominal, mean, covariance, *np.zeros((3, 2, 6)))
    ends = one.interval()
    assert (ends[:, 0] <= nominal).all()
    assert (nominal <= ends[:, 1]).all()


def test_a_model_without_the_servos_is_refused(tmp_path, capsys):
    (tmp_path / "model.json").write_text('{"schema": "sim2real.model/1", "joints": {}}')
    given = ["datasets/pool/clean.csv", "--robot", "datasets/pool/robot.toml"]
    given += ["--model", str(tmp_path / "model.json"), "--out", str(tmp_path / "c.json")]
    assert main(["calibrate", *given]) == 2
    assert "the robot's joint j1" in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()


NOISE = np.array([0.005, 0.005, 0.02, 0.002, 0.002, 0.002])
TWIN = by_twin(FISH)


def recorded(truth, seed=0):
    return replace(swum(truth, seed), noise=NOISE)


def some(*names):
    return [p for name in names for p in effect_parameters(name)]


def calibrated(truth, count, gains=False, coarser=lambda models, _: [[[np.nan] * 6] * 600]):
    before = Calibrated(servos(), (), *np.zeros((6, 0)))
    begun = Calibration(servos(), servos(), FISH, (recorded(truth),), TWIN, before)
    options = {"cell_m": 0.01, "rollouts": count, "gains": gains, "held_out": 1 / 3, "seed": 0}
    return calibrate_in_fluid(begun, {0.01: TWIN, 0.02: coarser}.get, **options).in_fluid


def test_rollouts_that_were_stopped_are_left_out_and_most_must_be_whole():
    def stopping(*rows):
        def simulator(models, swim):
            track = TWIN(models, swim)
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
    def thicker(models, swim):
        return TWIN([with_values(m, {"linear_drag.coefficient": 0.5}) for m in models], swim)

    alone, with_coarse = calibrated({}, 24), calibrated({}, 24, coarser=thicker)
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
