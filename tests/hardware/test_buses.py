"""Dynamixel and Feetech servos, from scan to recording, and what is left behind."""

import json
import os
import re
import subprocess
import sys
import time

import numpy as np
import pytest
from virtual_bench import LIMITS, limit, limits, record, refused, robot_file, served

from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.hardware.buses import BUSES, Changed, Journal, connection, latency_advice
from sim2real.hardware.registers import model_of, servo_models
from sim2real.hardware.servo_bus import Stopped
from sim2real.recording import read_recording

REGISTERS = ("dynamixel", "feetech")


def eeprom(servo):
    return bytes(servo.memory[: servo.model.layout.volatile_from])


@pytest.mark.parametrize("bus", REGISTERS)
def test_a_recording_stores_settings_and_restores_limits(tmp_path, bus):
    more = ["--bus", bus, "--seconds", "1.2", "--reverse", "j2"]
    with served(2, bus=bus, echo=bus == "feetech") as bench:
        for servo in bench.servos:
            limit(servo)
        before = [eeprom(servo) for servo in bench.servos]
        assert record(tmp_path, bench.port, *more, joints=2) == 0
        assert [eeprom(servo) for servo in bench.servos] == before
        for servo in bench.servos:
            assert not servo.powered
            assert limits(servo) == LIMITS
            if bus == "dynamixel":
                assert servo.get("bus_watchdog") == 0
    recording = read_recording(tmp_path / "run.csv")
    moved = recording.t > 0.9
    apart = np.diff(recording.position[moved], axis=1)
    assert np.nanmax(np.abs(apart)) < 0.05, "both do the same"
    assert np.nanmax(np.abs(recording.position)) > 0.4
    assert np.nanmax(np.abs(recording.position[recording.t < 0.5])) < 0.005
    current, velocity = (recording.columns[f"j1.{x}"] for x in ("current_A", "velocity_rad_s"))
    assert np.nanmax(np.abs(current)) > 0.1
    rate = np.gradient(recording.position[:, 0], recording.t)
    known = np.isfinite(rate) & np.isfinite(velocity)
    assert np.corrcoef(rate[known], velocity[known])[0, 1] > 0.95
    assert np.nanmax(recording.columns["j1.temperature_C"]) == 30
    assert np.nanmax(recording.columns["supply_V"]) == 7.4
    lost = recording.metadata["outcome"]["lost_set_points"]
    assert max(lost.values()) <= 2, "none, but for late answers"
    stored = recording.metadata["bus"]
    assert stored["name"] == bus and stored["baud"] == 1_000_000
    request_bytes = {"dynamixel": 14, "feetech": 8}[bus] + 2  # of a sync read of two servos
    assert recording.metadata["context"]["sample_delay_s"] == pytest.approx(1e-5 * request_bytes)
    for settings in stored["servos"]:
        registers = settings["registers"]
        assert registers["position_p"] == (400 if bus == "dynamixel" else 32)
        assert registers["operating_mode"] == (3 if bus == "dynamixel" else 0)
        assert {name: registers[name] for name in LIMITS} == LIMITS
    if bus == "dynamixel":
        assert stored["servos"][0]["gains"]["position_p"] == 400 / 128


@pytest.mark.parametrize(
    ("bus", "parts"),
    [
        ("lx", ("500", "supply outside 4.5 to 12.0 V")),
        ("dynamixel", ("XL330-M288", "2048", "voltage")),
        ("feetech", ("STS3215", "2048", "voltage")),
    ],
)
def test_scan_names_who_is_there(bus, parts, capsys):
    with served(2, bus=bus, supply_V=3.3, temperature_C=41) as bench:
        call = ["scan", "--bus", bus, "--port", bench.port, "--ids"]
        assert main([*call, "1-3"]) == 0
        first, second = capsys.readouterr().out.splitlines()[1:]
        for part in (*parts, "3.30 V", "41 C", "off"):
            assert part in first
        assert second.split()[0] == "2"
        refused(capsys, main([*call, "3"]), 1, "no servo answers")
        assert main([*call, "1-300"]) == 2


def test_what_is_wrong_is_one_line(tmp_path, capsys):
    def wrong(status, *parts, bus="dynamixel", joints=1, more=()):
        found = record(tmp_path, bench.port, "--bus", bus, *more, joints=joints)
        refused(capsys, found, status, *parts)

    with served(3, bus="dynamixel") as bench:
        servo = bench.servos[0]
        wrong(2, "--bus: found 'dynamixle'", "did you mean dynamixel?", bus="dynamixle")
        wrong(1, "no reply from servo 1 (feetech, 1000000 baud)", bus="feetech")
        silent = "no reply from servo 1 (dynamixel, 57600 baud)"
        wrong(1, silent, more=["--baud", "57600"])
        wrong(2, "--baud: found -1", more=["--baud", "-1"])
        slow = ["--baud", "38400"]  # a terminal's own rate, as if they listened at any rate
        wrong(2, "--baud: found 38400 baud", "a faster rate", more=slow, joints=3)
        wrong(1, "no reply from servo 7", more=["--ids", "7"])
        wrong(2, "--ids: found 253", "0 to 252", more=["--ids", "253"])
        servo.put("operating_mode", 1)
        wrong(2, "servo 1: operating mode: found 1", "3 (position)")
        servo.put("operating_mode", 3)
        servo.put("max_position", 2100)
        wrong(2, "limits_rad", "limits that the servo reaches")
        servo.put("model", 350)
        wrong(2, "servo 1: model: found number 350", "XL430-W250")
        status = main(["scan", "--bus", "feetech", "--port", bench.port, "--ids", "1-2"])
        refused(capsys, status, 1, "no servo answers", "feetech", "1000000", "--bus")
    assert not (tmp_path / "run.csv").exists()


def test_a_servo_outside_its_range_is_not_driven(tmp_path, capsys):
    """It would jump to the end of the range; in an operating mode of several turns it is inside."""
    with served(1, bus="dynamixel") as bench:
        (servo,) = bench.servos
        servo.put("max_position", 2600)
        servo.put("min_position", 1500)
        servo._angle = 1.2  # 2830 ticks
        status = record(tmp_path, bench.port, "--bus", "dynamixel", "--trim=0")
        refused(capsys, status, 1, "2830 ticks, outside its range of 1500 to 2600", "torque off")
        servo.put("operating_mode", 4)
        servo.put("max_position", 4095)
        more = ["--bus", "dynamixel", "--seconds", "1"]
        assert record(tmp_path, bench.port, *more) == 0
    assert np.nanmax(np.abs(read_recording(tmp_path / "run.csv").command)) <= 0.8


def test_after_a_kill_the_next_command_restores_limits(tmp_path, state, capsys):
    """By the journal, whichever bus that command asks for."""
    with served(1, bus="dynamixel", loss=0.02, noise=0.001) as bench:
        (servo,) = bench.servos
        limit(servo)
        program = subprocess.Popen(
            [sys.executable, "-m", "sim2real", "record", "sine", "--bus", "dynamixel",
             "--port", bench.port, "--ids", "1", "--robot", str(robot_file(tmp_path, 1)),
             "--out", str(tmp_path / "run.csv")],
            env=os.environ | {"XDG_STATE_HOME": str(state)}, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        deadline, run = time.monotonic() + 30, tmp_path / "run.csv"
        while time.monotonic() < deadline and not (
            run.exists() and run.read_text().count("\n") > 9
        ):
            time.sleep(0.01)
        assert servo.powered and servo.get("profile_velocity") == 0
        with pytest.raises(InputError, match="in use by another command"):
            Journal(bench.port)
        program.kill()
        program.wait(20)
        assert read_recording(run).t.size > 5, "a crash loses nothing"
        assert servo.powered
        main(["scan", "--port", bench.port, "--ids", "9"])
        said = capsys.readouterr().err.splitlines()
        assert said[0] == (
            f"{bench.port}: servos 1, left on by an earlier command: torque off, limits restored"
        )
        assert not servo.powered
        assert limits(servo) == LIMITS
        assert servo.get("bus_watchdog") == 0
        main(["scan", "--port", bench.port, "--ids", "9"])
        assert "left on" not in capsys.readouterr().err


def test_a_servo_that_did_not_answer_is_restored_later_to_what_it_had(tmp_path, capsys):
    """Even if it is recorded again in between, when its limits are those of the first recording."""
    with served(1, bus="feetech") as bench:
        (servo,) = bench.servos
        before, now = (
            Changed("feetech", 1_000_000, 1, values)
            for values in (LIMITS, dict.fromkeys(LIMITS, 0))
        )
        journal = Journal(bench.port)
        assert journal.note([before]) == [before]
        journal.close()
        servo.connected = False
        main(["scan", "--bus", "feetech", "--port", bench.port, "--ids", "1"])
        gone = f"no confirmation from 1 (if they are gone, delete {journal.path})"
        assert gone in capsys.readouterr().err
        servo.connected = True
        journal = Journal(bench.port)
        assert journal.note([now]) == [before], "what it had first"
        journal.close()
        assert record(tmp_path, bench.port, "--bus", "feetech", "--seconds", "1") == 0
        assert limits(servo) == LIMITS
        assert not journal.path.exists()


def test_a_journal_that_is_cut_off_means_nothing_was_changed(state):
    journal = Journal("udp://127.0.0.1:9")
    for content in (b"", b"{", b'{"bus": "lx"}', b"\x00\xff", b"[]", b'{"servos": [{}]}'):
        journal.path.write_bytes(content)
        assert journal.pending() == []
    journal.close()


@pytest.mark.parametrize("bus", REGISTERS)
def test_nothing_is_written_to_the_eeprom(bus):
    with served(1, bus=bus) as bench, connection(bus, bench.port) as link:
        with pytest.raises(ValueError, match="EEPROM"):
            link.bus.set(1, "min_position", 0)
        with pytest.raises(Stopped, match="no reply from servo 4"):
            link.bus.servo(4)


class Noise:
    """A transport from which random bytes come."""

    together, device_s = False, None

    def __init__(self):
        self.rng, self.left = np.random.default_rng(3), 10_000

    def write(self, data):
        assert data

    def read(self, deadline):
        count = min(self.left, 40)
        self.left -= count
        return self.rng.choice([0xFF, 0xFF, 0xFD, 0, 1, 4, 9, 85], count).astype("u1").tobytes()


@pytest.mark.parametrize("name", REGISTERS)
def test_random_bytes_instead_of_answers(name):
    line, kind = Noise(), BUSES[name]
    bus = kind(line, 1_000_000)
    bus._models[1] = model_of(name, 1200 if name == "dynamixel" else 777)
    while line.left:
        begin = time.monotonic()
        bus.cycle({1: 2048}, begin + 0.05)
        assert time.monotonic() < begin + 0.5
    assert bus.garbled


@pytest.mark.parametrize("bus", BUSES)
def test_random_bytes_to_the_servos(bus):
    with served(1, bus=bus) as bench:
        rng, line = np.random.default_rng(0), os.open(bench.port, os.O_RDWR | os.O_NOCTTY)
        data = rng.choice([0x55, 0xFF, 0xFF, 0xFD, 0, 1, 3, 4, *range(256)], 10_000)
        for start in range(0, 10_000, 500):
            os.write(line, data[start : start + 500].astype("u1").tobytes())
            time.sleep(0.001)
        os.close(line)
        with connection(bus, bench.port) as link:
            assert any(link.bus.answers(1, 0.05) for _ in range(20))


def test_every_model_has_a_source_and_plausible_ratings():
    for model in servo_models():
        assert model.source and model.layout
        assert model.bus in BUSES
        for rating in model.ratings:
            assert 3 < rating.supply_V < 25
            assert 0.1 < rating.stall_torque_Nm < 15
            assert 2 < rating.no_load_speed_rad_s < 50
    assert model_of("feetech", 777).rating(12.4).stall_torque_Nm == 2.94
    assert model_of("feetech", 0x1209).name == "STS", "another of that series"
    assert model_of("feetech", 0x0506) is None and model_of("dynamixel", 777) is None
    numbers = [(model.bus, model.number) for model in servo_models()]
    assert len(set(numbers)) == len(numbers)


def test_a_latency_timer_that_is_too_long_is_told(tmp_path):
    for folder in ("class/tty/ttyUSB3/device", "bus/usb-serial/devices/ttyUSB4"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "latency_timer").write_text("16\n")
        port = f"/dev/{re.search('ttyUSB.', folder)[0]}"
        advice = latency_advice(port, tmp_path)
        assert "latency timer 16 ms, expected at most 1 ms" in advice
        assert str(tmp_path / folder / "latency_timer") in advice and "\n" not in advice
        (tmp_path / folder / "latency_timer").write_text("1\n")
        assert latency_advice(port, tmp_path) is None
    assert latency_advice("/dev/ttyUSB9", tmp_path) is None
    assert latency_advice("udp://127.0.0.1:9", tmp_path) is None


def test_set_points_that_were_lost_are_counted(tmp_path):
    """The servo reports the set-point in effect, which is recorded instead of a lost one."""
    with served(1, bus="dynamixel", loss=0.3) as bench:
        assert record(tmp_path, bench.port, "--bus", "dynamixel", "--seconds", "1.2") == 0
    sidecar = json.loads((tmp_path / "run.json").read_text())
    assert 2 <= sidecar["outcome"]["lost_set_points"]["j1"] <= 50
    recording = read_recording(tmp_path / "run.csv")
    assert np.isnan(recording.position).sum() > 5
    moved = recording.command[30:-2, 0]
    assert (np.diff(moved) == 0).sum() >= 2, "held while a set-point was lost"
