"""A recording that has to end early keeps what it has, lets the servos go and says so."""

import os
import signal

import numpy as np
import pytest
from good_input import ROBOT
from virtual_bench import LIMITS, limit, limits, record, refused, robot_file, served, when_rows

from sim2real.cli import main
from sim2real.hardware import lx, recorder, servo_bus
from sim2real.hardware.frames import LX, FrameDecoder, Packet
from sim2real.hardware.lx import LxBus, LxCommand
from sim2real.hardware.mounting import places
from sim2real.hardware.recorder import Run, mounted
from sim2real.recording import read_recording
from sim2real.robot import read_robot

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


HZ = 50


class Clock:
    now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class Line:
    """A wire whose servo answers after as long as the script says."""

    together, device_s = False, None
    replies = {
        LxCommand.POS_READ: b"\x26\x02",
        LxCommand.VIN_READ: b"\xe8\x1c",
        LxCommand.TEMP_READ: b"\x1e",
    }

    def __init__(self, clock, takes):
        self.clock, self.takes, self.cycle, self.reply = clock, takes, -1, b""

    def write(self, data):
        command = FrameDecoder(LX).feed(data)[-1].code
        self.cycle += command == LxCommand.POS_READ  # of the only servo
        self.clock.now += self.takes(self.cycle) / 2
        self.reply = LX.encode(Packet(1, command, self.replies[command]))

    def read(self, deadline):
        arrived, self.reply = self.reply, b""
        return arrived


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    for module in (recorder, lx, servo_bus):
        monkeypatch.setattr(module, "time", clock)
    return clock


@pytest.fixture
def play(tmp_path, clock):
    (tmp_path / "robot.toml").write_text(ROBOT)
    robot = read_robot(tmp_path / "robot.toml")
    mountings = mounted(LxBus(None), robot, places(robot, [1]))

    def run(takes, command):
        rows, bus, run = [], LxBus(Line(clock, takes)), Run(mountings)
        recorder.record(run, bus, command, lambda row: rows.append([*row.values()]), hottest_C=65)
        return run, np.array(rows)

    return run


def test_the_schedule_does_not_drift_and_supply_and_temperature_take_turns(play):
    run, rows = play(lambda _: 0.018, np.zeros((200, 1)))
    np.testing.assert_allclose(rows[:, 0], np.arange(200) / HZ, atol=1e-9)
    np.testing.assert_allclose(rows[:, 2], 50 * np.deg2rad(0.24))
    assert run.stopped is None
    assert run.missing == {"j1": 0}
    assert run.skipped == 0
    temperature, supply = rows[:, 3], rows[:, 4]
    assert np.all(supply[::2] == 7.4)
    assert np.all(np.isnan(supply[1::2]))
    assert np.all(temperature[1::2] == 30)


def test_a_stall_skips_set_points_and_then_it_is_on_time_again(play):
    command = np.linspace(0, 0.5, 100)[:, None]
    run, rows = play(lambda cycle: 0.071 if cycle == 10 else 0.004, command)
    slots = np.round(rows[:, 0] * HZ).astype(int)
    assert list(slots[:13]) == [*range(11), 14, 15]
    assert slots[-1] == 99
    assert run.skipped == 3
    np.testing.assert_allclose(rows[:, 1], command[slots, 0], atol=0.0022)
    late = np.array(run.late_s)
    assert late[11] == pytest.approx(0.0, abs=1e-9)


def test_a_silent_servo_leaves_the_others_their_time(tmp_path, clock):
    given = []

    class Silent(Line):
        def write(self, data):
            self.reply = b""

        def read(self, deadline):
            if deadline > clock.now:
                given.append(deadline - clock.now)
                clock.now = deadline
            return b""

    robot = read_robot(robot_file(tmp_path, 3))
    run = Run(mounted(LxBus(None), robot, places(robot, [1, 2, 3])))
    bus = LxBus(Silent(clock, None))
    recorder.record(run, bus, np.zeros((50, 3)), lambda _: None, hottest_C=65)
    assert run.stopped == "no reply from j1's servo for 0.5 s"
    for cycle in np.reshape(given, (-1, 4)):
        assert cycle.min() > 0.0024
        assert cycle.sum() <= 0.8 / HZ + 1e-9
