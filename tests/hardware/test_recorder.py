"""The loop, by a clock of its own: it keeps its schedule, whatever a cycle takes."""

import numpy as np
import pytest
from good_input import ROBOT
from virtual_bench import robot_file

from sim2real.hardware import lx, recorder, servo_bus
from sim2real.hardware.frames import LX, FrameDecoder, Packet
from sim2real.hardware.lx import LxBus, LxCommand, lx_servo
from sim2real.hardware.mounting import Wiring, mount
from sim2real.hardware.recorder import Run
from sim2real.robot import read_robot

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
    mountings = mount(read_robot(tmp_path / "robot.toml"), [lx_servo(1)], Wiring([1]))

    def run(takes, command):
        rows, bus, run = [], LxBus(Line(clock, takes)), Run(mountings)
        recorder.record(run, bus, command, rows.append, rate_hz=HZ, hottest_C=65)
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

    three = [lx_servo(k) for k in (1, 2, 3)]
    run = Run(mount(read_robot(robot_file(tmp_path, 3)), three, Wiring([1, 2, 3])))
    bus = LxBus(Silent(clock, None))
    recorder.record(run, bus, np.zeros((50, 3)), lambda _: None, rate_hz=HZ, hottest_C=65)
    assert run.stopped == "no reply from j1's servo for 0.5 s"
    for cycle in np.reshape(given, (-1, 4)):
        assert cycle.min() > 0.0024
        assert cycle.sum() <= 0.8 / HZ + 1e-9
