"""Calibration on swims of the twin itself: what was put in comes out, on what was held out too."""

import json
from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos

from sim.inference.calibration import Calibrated, calibrate
from sim.inference.coordinates import effect_parameters, servo_parameters, twin_parameters
from sim.inference.law_error import marginalised
from sim.inference.swims import Swim, by_followed_twin, by_twin, simulated, swim_of, with_values
from sim.robot.swimmer import CONTROL_S
from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.recording import Recording
from sim2real.robot import read_robot

TIMES = CONTROL_S * np.arange(600)
SENT = np.array(
    [min(1.0, t) * np.array([0.3, 0.45, 0.6]) * np.sin(2 * np.pi * t - 1.2 * np.arange(3))
     + 0.2 * np.sin(0.8 * t) for t in TIMES]
)  # fmt: skip


def swum(truth, seed=0, model=None, robot=FISH):
    rng = np.random.default_rng(seed)
    empty = Swim("made", TIMES, SENT, np.zeros(3), np.empty((0, 6)))
    (signals,) = simulated(empty, [with_values(model or servos(), truth)], by_twin(robot))
    noise = rng.standard_normal(signals.shape) * [0.005, 0.005, 0.02, 0.002, 0.002, 0.002]
    return Swim("made", TIMES, SENT, np.zeros(3), signals + noise)


def test_what_was_put_in_comes_out():
    truth = {
        "form_drag.coefficient": 1.0,
        "added_mass.ratio": 0.3,
        "j1.latency_s": 0.08,
        "j2.latency_s": 0.068,
        "j3.latency_s": 0.06,
    }
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
    one = Calibrated(servos(), tuple(free), nominal, covariance, *np.zeros((3, 2, 6)), mean=mean)
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
