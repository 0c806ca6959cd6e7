"""BAM's parameters as models: the same motion as BAM's equations, one clear line otherwise."""

import json
import math

import numpy as np
import pytest
from good_input import message

from sim2real.cli import main
from sim2real.importers.bam import read_bam_parameters
from sim2real.model import read_model
from sim2real.recording import GRAVITY_M_S2, Load
from sim2real.servo.prediction import predict

LOAD = Load(0.02, 0.9, 0.14)
MOTOR = {"kt": 1.5, "R": 3.2, "armature": 0.012, "friction_viscous": 0.02}
STRIBECK = {"friction_stribeck": 0.2, "dtheta_stribeck": 1.4, "alpha": 2.0}
M4 = {"load_friction_base": 0.1, "load_friction_stribeck": 0.08}
M5 = {
    "load_friction_motor": 0.2,
    "load_friction_external": 0.05,
    "load_friction_motor_stribeck": 0.1,
    "load_friction_external_stribeck": 0.15,
}
FILES = {
    "m1": {**MOTOR, "friction_base": 0.5},
    "m4": {**MOTOR, **STRIBECK, **M4, "friction_base": 0.25},
    "m5": {**MOTOR, **STRIBECK, **M5, "friction_base": 0.25},
}
VOLTS, GAIN, SCALE, DUTY = 15.0, 32.0, 0.158, 0.9625  # of BAM's program for the MX series


def read(folder, name, **changes):
    path = folder / f"{name}.json"
    content = {**FILES[name], "model": name, "actuator": "mx64"} | changes
    path.write_text(json.dumps({k: x for k, x in content.items() if x is not None}))
    return read_bam_parameters(path, LOAD)


def bam(p, goals, dt):
    """BAM's equations for M1, M4 and M5 on a pendulum, by Euler's method."""
    q = dq = 0.0
    inertia = LOAD.inertia_kgm2 + p["armature"]
    angles = []

    def of_load(name, kind):
        return p.get(f"load_friction_{name}{kind}", p.get(f"load_friction{kind or '_base'}", 0.0))

    for goal in goals:
        angles.append(q)
        duty = np.clip((goal - q) * GAIN * SCALE, -DUTY, DUTY)
        motor = p["kt"] / p["R"] * (VOLTS * duty - p["kt"] * dq)
        external = -0.9 * GRAVITY_M_S2 * 0.14 * math.sin(q)
        friction, falling = (
            abs(external * of_load("external", kind) - motor * of_load("motor", kind))
            for kind in ("", "_stribeck")
        )
        friction += p["friction_base"]
        if "alpha" in p:
            share = math.exp(-(abs(dq / p["dtheta_stribeck"]) ** p["alpha"]))
            friction += share * (p["friction_stribeck"] + falling)
        net = motor + external
        stop = inertia / dt * dq + net
        net -= np.sign(stop) * min(abs(stop), friction + p["friction_viscous"] * abs(dq))
        dq += net / inertia * dt
        q += dq * dt
    return np.array(angles)


@pytest.mark.parametrize("name", FILES)
def test_a_model_moves_as_bams_equations_do(name, tmp_path):
    dt = 0.0005
    t = dt * np.arange(6000)
    levels = np.array([0.0, 0.6, -0.5, 0.3, -0.8, 0.1])
    goals = levels[np.searchsorted([0.2, 0.8, 1.3, 1.9, 2.5], t, side="right")]
    theirs = bam(FILES[name], goals, dt)
    ours = predict(read(tmp_path, name), t, {"j1": goals})["j1"]
    apart = np.sqrt(np.mean((ours - theirs) ** 2))
    assert apart < 0.002
    without = predict(read(tmp_path, "m1", friction_base=0.0), t, {"j1": goals})["j1"]
    assert np.sqrt(np.mean((without - theirs) ** 2)) > 3 * apart  # the friction is seen


def test_a_stribeck_curve_of_another_exponent_has_the_same_area(tmp_path):
    alpha, speed = 1.3, 1.4
    joint = read(tmp_path, "m5", alpha=alpha).joints["j1"]
    v = np.linspace(0.0, 200.0, 100_001)
    theirs = np.trapezoid(np.exp(-((v / speed) ** alpha)), v)
    ours = np.trapezoid(np.exp(-((v / joint.motor["stribeck_speed_rad_s"]) ** 2)), v)
    assert ours == pytest.approx(theirs, rel=1e-4)
    assert any("exponent" in note for note in joint.notes)


def test_the_current_limit_of_a_firmware_limits_the_motor(tmp_path):
    limited = read(tmp_path, "m1", actuator="xl330", kt=0.4, R=2.8)
    effects = {effect.effect: effect.parameters for effect in limited.joints["j1"].effects}
    assert effects["torque_saturation"]["limit_Nm"] == pytest.approx(0.4 * 1.75)
    assert limited.provenance["servo"] == {"firmware_gain": 400, "supply_V": 7.5}


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"model": "m9"}, "model: found 'm9', expected one of m1"),
        ({"actuator": "mx65"}, "did you mean mx64?"),
        ({"R": 0}, "R: found 0, expected a number above 0"),
        ({"friction_viscous": None}, "friction_viscous: found nothing, expected a number"),
        ({"kt": "1.5"}, "kt: found '1.5', expected a number"),
    ],
)
def test_bad_fields_are_one_line(changes, line, tmp_path):
    message(lambda: read(tmp_path, "m1", **changes), line)


def test_the_command_writes_a_model_and_says_what_is_not_mapped(tmp_path, capsys):
    read(tmp_path, "m1", q_offset=0.03, backdrive=0.5)
    source, out = str(tmp_path / "m1.json"), tmp_path / "model.json"
    assert main(["import", source, "--out", str(out)]) == 2
    assert "no --inertia or --pendulum j1=..." in capsys.readouterr().err
    assert not out.exists()
    assert main(["import", source, "--pendulum", "j1=0.9,0.14", "--out", str(out)]) == 0
    said, joint = capsys.readouterr().out, read_model(out).joints["j1"]
    for note in ("q_offset = 0.03 rad: not mapped", "backdrive = 0.5: not mapped"):
        assert note in said
        assert any(one.startswith(note) for one in joint.notes)
    assert joint.load == Load(0.9 * 0.14**2, 0.9, 0.14)
