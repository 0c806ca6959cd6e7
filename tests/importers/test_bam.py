import json
import math

import numpy as np
import pytest
from good_input import message

from sim2real.cli import main
from sim2real.importers.bam import read_bam, read_bam_parameters
from sim2real.model import read_model
from sim2real.recording import GRAVITY_M_S2, Load
from sim2real.servo.prediction import predict


def raw_log(rows=40, off_from=None, **changes):
    """A log as the XL330's recorder writes it; field order, types and wrapped load included."""
    entries = [
        {
            "position": -0.0123 + 0.01 * k,
            "speed": 0.024 * (k - 3),
            "load": (5 - k) % 2**16,
            "input_volts": 7.3,
            "temp": 29,
            "timestamp": 0.0036 + 0.0053 * k + 1e-4 * math.sin(k),
            "goal_position": 0.02 * k,
            "torque_enable": off_from is None or k < off_from,
        }
        for k in range(rows)
    ]
    log = {"mass": 0.49, "length": 0.1, "kp": 200, "vin": 7.4, "motor": "xl330"}
    return log | {"trajectory": "lift_and_drop", "entries": entries} | changes


@pytest.fixture
def read(tmp_path):
    def write_and_read(log):
        (tmp_path / "2026-01-15_10h28m49.json").write_text(json.dumps(log))
        return read_bam(tmp_path / "2026-01-15_10h28m49.json")

    return write_and_read


def test_every_field_arrives_in_its_column(read):
    log = raw_log()
    recording = read(log)
    assert (recording.kind, recording.joints, recording.medium) == ("servo", ("j1",), "air")
    for values, field in (
        (recording.t, "timestamp"),
        (recording.command[:, 0], "goal_position"),
        (recording.position[:, 0], "position"),
        (recording.columns["j1.velocity_rad_s"], "speed"),
        (recording.columns["j1.temperature_C"], "temp"),
        (recording.columns["supply_V"], "input_volts"),
    ):
        np.testing.assert_array_equal(values, [entry[field] for entry in log["entries"]])
    wrapped = recording.columns["j1.load"]
    np.testing.assert_array_equal(wrapped, 5.0 - np.arange(40), "unsigned, it gets its sign back")
    assert recording.metadata == {
        "servo": "xl330",
        "trajectory": "lift_and_drop",
        "firmware_p_gain": 200,
        "supply_nominal_V": 7.4,
        "original_file": "2026-01-15_10h28m49.json",
        "not_imported": [],
    }


def test_load_that_was_interpolated_across_the_wrap_stays_behind(read):
    log = raw_log(dt=0.005)
    log["entries"][6]["load"] = 32767.4
    recording = read(log)
    assert "j1.load" not in recording.columns
    assert recording.metadata["not_imported"] == ["load"]
    assert recording.metadata["resampled_every_s"] == 0.005


def test_what_the_servo_does_not_tell_is_no_column(read):
    log = raw_log()
    for k, entry in enumerate(log["entries"]):
        entry["load"] = 0
        entry["control"] = 1.5
        del entry["temp"]
        if k == 7:
            entry["input_volts"] = None
    recording = read(log)
    assert set(recording.columns) == {"j1.velocity_rad_s", "supply_V"}
    assert np.flatnonzero(np.isnan(recording.columns["supply_V"])).tolist() == [7]
    assert recording.metadata["not_imported"] == ["control", "load"]


def test_the_arm_s_mass_with_a_hyphen_as_recorders_write_it(read):
    spelt = [read(raw_log(mass=2.0, **{name: 1.0})) for name in ("arm-mass", "arm_mass")]
    assert spelt[0].loads == spelt[1].loads
    assert "import_warnings" not in spelt[0].metadata
    both = raw_log(**{"arm-mass": 1.0, "arm_mass": 2.0})
    message(lambda: read(both), "arm-mass: found 1.0", "the value of arm_mass, 2.0")


def test_unknown_fields_are_named(read):
    log = raw_log(gear_ratio=2, **{"arm-length": 0.1})
    for entry in log["entries"]:
        entry["control"] = 1.5
    (warning,) = read(log).metadata["import_warnings"]
    assert warning.endswith("not read: gear_ratio, arm-length, entries.control.")


def test_arm_adds_the_inertia_and_the_gravity_torque_of_a_rod(read):
    recording = read(raw_log(mass=2.0, arm_mass=1.0, length=0.15))
    load = recording.loads["j1"]
    along = (np.arange(100_000) + 0.5) / 100_000 * 0.15
    assert load.inertia_kgm2 == pytest.approx(2.0 * 0.15**2 + np.mean(along**2))
    assert load.gravity_Nm == pytest.approx(9.80665 * (2.0 * 0.15 + np.mean(along)))
    assert "arm_mass" in recording.source
    load = read(raw_log()).loads["j1"]
    assert load.inertia_kgm2 == pytest.approx(0.49 * 0.1**2)
    assert (load.pendulum_mass_kg, load.pendulum_length_m) == (0.49, 0.1)


def test_commands_are_empty_once_the_torque_is_off(read):
    log = raw_log(off_from=30)
    for entry in log["entries"][30:]:
        entry["goal_position"] = None
    recording = read(log)
    assert recording.powered(0) == 30
    assert np.isnan(recording.command[30:]).all()
    assert np.isfinite(recording.position).all()
    assert recording.metadata["torque_off_from_s"] == log["entries"][30]["timestamp"]


def test_recording_is_cut_where_the_torque_comes_on_again(read):
    log = raw_log()
    for entry in log["entries"][10:25]:
        entry["torque_enable"] = False
    recording = read(log)
    assert (recording.t.size, recording.powered(0)) == (25, 10)
    assert all(values.size == 25 for values in recording.columns.values())
    assert recording.metadata["left_out"] == {
        "from_s": log["entries"][25]["timestamp"],
        "rows": 15,
        "why": "the torque comes on again",
    }


def entry_with(k, **changes):
    """A log with changes of an entry; a field that is ``...`` is left out."""
    log = raw_log()
    entry = log["entries"][k] | changes
    log["entries"][k] = {name: value for name, value in entry.items() if value is not ...}
    return log


@pytest.mark.parametrize(
    ("log", "where"),
    [
        (raw_log(mass="heavy"), "mass: found 'heavy'"),
        (raw_log(arm_mass=-1), "arm_mass: found -1"),
        (raw_log(motor=330), "motor: found 330"),
        (raw_log(entries={}), "entries: found no list"),
        (raw_log(rows=1), "entries: found 1 samples"),
        (entry_with(3, position=90.0), "entries[3].position: found 90.0"),
        (entry_with(3, position=math.nan), "entries[3].position: found nan"),
        (entry_with(3, goal_position=None), "entries[3].goal_position: found None"),
        (entry_with(3, speed=True), "entries[3].speed: found True"),
        (entry_with(3, timestamp=0.0), "entries[3].timestamp: found 0 s after"),
        (entry_with(3, torque_enable=1), "entries[3].torque_enable: found 1"),
        (entry_with(3, position=...), "entries[3].position: found nothing"),
        (raw_log(off_from=0), "entries[0].torque_enable: found False"),
    ],
)
def test_errors_say_where_in_one_line(read, log, where):
    message(lambda: read(log), f"10h28m49.json: {where}")


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


def model_of(folder, name, **changes):
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
    ours = predict(model_of(tmp_path, name), t, {"j1": goals})["j1"]
    apart = np.sqrt(np.mean((ours - theirs) ** 2))
    assert apart < 0.002
    without = predict(model_of(tmp_path, "m1", friction_base=0.0), t, {"j1": goals})["j1"]
    assert np.sqrt(np.mean((without - theirs) ** 2)) > 3 * apart  # the friction is seen


def test_a_stribeck_curve_of_another_exponent_has_the_same_area(tmp_path):
    alpha, speed = 1.3, 1.4
    joint = model_of(tmp_path, "m5", alpha=alpha).joints["j1"]
    v = np.linspace(0.0, 200.0, 100_001)
    theirs = np.trapezoid(np.exp(-((v / speed) ** alpha)), v)
    ours = np.trapezoid(np.exp(-((v / joint.motor["stribeck_speed_rad_s"]) ** 2)), v)
    assert ours == pytest.approx(theirs, rel=1e-4)
    assert any("exponent" in note for note in joint.notes)


def test_the_current_limit_of_a_firmware_limits_the_motor(tmp_path):
    limited = model_of(tmp_path, "m1", actuator="xl330", kt=0.4, R=2.8)
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
    message(lambda: model_of(tmp_path, "m1", **changes), line)


def test_the_command_writes_a_model_and_says_what_is_not_mapped(tmp_path, capsys):
    model_of(tmp_path, "m1", q_offset=0.03, backdrive=0.5)
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
