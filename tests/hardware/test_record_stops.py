"""A recording that has to end early keeps what it has, lets the servos go and says so."""

import os
import signal

import numpy as np
import pytest
from virtual_bench import LIMITS, limit, limits, record, refused, robot_file, served, when_rows

from sim2real.cli import main
from sim2real.recording import read_recording

ROWS = 15


def stopped(folder, capsys, status, *parts):
    """The recording that is left after one line with ``parts`` and exit status 1."""
    error = refused(capsys, status, 1, "sim2real record: ", *parts)
    recording = read_recording(folder / "run.csv")
    assert f"{recording.t.size} rows" in error
    assert recording.metadata["outcome"]["rows"] == recording.t.size
    assert np.isfinite(recording.command).all()
    return recording


@pytest.mark.parametrize("udp", [False, True])
def test_the_cable_is_pulled(tmp_path, capsys, udp):
    with served(1, udp=udp) as bench, when_rows(tmp_path / "run.csv", ROWS, bench.pull):
        status = record(tmp_path, bench.port)
        why = "no reply from j1" if udp else "the port was lost"
        recording = stopped(tmp_path, capsys, status, why, "torque of any servo may still be on")
        assert ROWS <= recording.t.size < 1500
        assert np.isfinite(recording.position[:ROWS]).mean() > 0.5


def test_one_servo_is_lost_and_the_other_let_go(tmp_path, capsys):
    with served(2) as bench:
        first, second = bench.servos

        def unplug():
            assert first.powered
            second.connected = False

        with when_rows(tmp_path / "run.csv", ROWS, unplug):
            status = record(tmp_path, bench.port, joints=2)
        recording = stopped(
            tmp_path, capsys, status, "no reply from j2", "torque of j2 may still be on"
        )
        assert np.isfinite(recording.position[:, 0]).mean() > 0.5
        assert np.isnan(recording.position[-20:, 1]).all()
        assert not first.powered


@pytest.mark.parametrize(
    ("bus", "number"),
    [("lx", signal.SIGINT), ("dynamixel", signal.SIGTERM), ("feetech", signal.SIGHUP)],
)
def test_the_user_stops_it_and_limits_are_restored(tmp_path, capsys, state, bus, number):
    before = signal.getsignal(number)
    with served(1, bus=bus) as bench:
        (servo,) = bench.servos
        if bus != "lx":
            limit(servo)

        def stop():
            assert servo.powered
            os.kill(os.getpid(), number)

        with when_rows(tmp_path / "run.csv", ROWS, stop):
            status = record(tmp_path, bench.port, "--bus", bus)
        recording = stopped(tmp_path, capsys, status, "interrupted", "torque off")
        assert recording.t.size >= ROWS
        assert not servo.powered
        assert bus == "lx" or limits(servo) == LIMITS
    assert signal.getsignal(number) == before
    assert list(state.glob("sim2real/ports/*.lock"))
    assert not list(state.glob("sim2real/ports/*.json"))


def test_a_servo_gets_hot(tmp_path, capsys):
    with served(1, temperature_C=50, heating_C_per_s=4) as bench:
        status = record(tmp_path, bench.port, "--max-temperature", "57")
        recording = stopped(tmp_path, capsys, status, "above 57 C", "torque off")
        assert 57 < np.nanmax(recording.columns["j1.temperature_C"]) < 60
        assert not bench.servos[0].powered


def test_what_never_began_leaves_no_file(tmp_path, capsys):
    with served(1, temperature_C=70) as bench:
        status = record(tmp_path, bench.port)
        refused(capsys, status, 1, "70 C, above 65 C", "nothing written", "torque off")
        status = record(tmp_path, bench.port, joints=2)
        silent = "no reply from servo 2 (lx, 115200 baud)"
        refused(capsys, status, 1, silent, "nothing written", "torque of j2 may still be on")
        bench.servos[0].connected = False
        status = record(tmp_path, bench.port)
        refused(
            capsys, status, 1, "no reply from servo 1 (lx, 115200 baud)", "torque of any servo may"
        )
    assert [path.name for path in tmp_path.iterdir()] == ["robot.toml"]


def test_a_robot_without_limits_is_refused(tmp_path, capsys):
    path = robot_file(tmp_path, 1)
    path.write_text(path.read_text().replace("limits_rad = [-0.8, 0.8]", ""))
    options = ["--robot", str(path), "--port", "/dev/null", "--ids", "1"]
    status = main(["record", "sine", *options, "--out", str(tmp_path / "run.csv")])
    refused(capsys, status, 2, "limits_rad", "two angles")


@pytest.mark.parametrize(
    ("more", "part"),
    [
        (["--amplitude", "-1"], "--amplitude"),
        (["--inertia", "0.1,0.2"], "--inertia"),
        (["--ids", "1,2"], "--ids"),
        (["--trim", "a"], "--trim"),
        (["--joints", "tail"], "--joints"),
        (["--max-temperature", "200"], "--max-temperature"),
        (["--out", "run.txt"], "--out"),
        (["--port", "/dev/no-such-port"], "--port"),
    ],
)
def test_bad_input_is_one_line_and_drives_nothing(tmp_path, capsys, more, part):
    status = record(tmp_path, "udp://127.0.0.1:9", *more)
    refused(capsys, status, 2, part, "found", "expected")
    assert not (tmp_path / "run.csv").exists()


def test_a_recording_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "run.json").write_text("{}")
    refused(capsys, record(tmp_path, "udp://127.0.0.1:9"), 2, "--overwrite")
    assert (tmp_path / "run.json").read_text() == "{}"
