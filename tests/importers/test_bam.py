import json
import math

import numpy as np
import pytest
from good_input import message

from sim2real.importers.bam import read_bam


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
