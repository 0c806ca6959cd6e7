"""Dynamixel and Feetech servos, from scan to recording, and what is left behind."""

import json
import os
import re
import signal
import time

import numpy as np
import pytest
from virtual_bench import LAW, record, refused, served, when_rows

from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.hardware.buses import BUSES, Changed, Journal, connection, latency_advice
from sim2real.hardware.servo_bus import Stopped
from sim2real.hardware.servo_models import model_of, servo_models
from sim2real.hardware.virtual_bus import Shaft
from sim2real.recording import read_recording

REGISTERS = ("dynamixel", "feetech")
LIMITS = {"profile_velocity": 44, "profile_acceleration": 7}


def limit(servo, values):
    for name, value in values.items():
        servo.put(name, value)


def eeprom(servo):
    return bytes(servo.memory[: servo.model.layout.volatile_from])


@pytest.mark.parametrize("bus", REGISTERS)
def test_a_recording_stores_settings_and_restores_limits(tmp_path, bus):
    more = ["--bus", bus, "--seconds", "1.2", "--reverse", "j2"]
    with served(2, bus=bus, echo=bus == "feetech") as bench:
        for servo in bench.servos:
            limit(servo, LIMITS)
        before = [eeprom(servo) for servo in bench.servos]
        assert record(tmp_path, bench.port, *more, joints=2) == 0
        assert [eeprom(servo) for servo in bench.servos] == before
        for servo in bench.servos:
            assert not servo.powered
            assert {name: servo.get(name) for name in LIMITS} == LIMITS
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


def test_scs_servos_are_read_one_by_one_with_the_high_byte_first(tmp_path):
    with served(2, bus="feetech", model="SCS0009") as bench:
        assert record(tmp_path, bench.port, "--bus", "feetech", "--seconds", "1", joints=2) == 0
        assert not any(servo.powered for servo in bench.servos)
    recording = read_recording(tmp_path / "run.csv")
    assert np.nanmax(np.abs(recording.position)) > 0.4
    assert np.isnan(recording.position).mean() < 0.2


@pytest.mark.parametrize("bus", REGISTERS)
def test_scan_names_the_model(bus, capsys):
    with served(2, bus=bus, supply_V=3.3, temperature_C=41) as bench:
        assert main(["scan", "--bus", bus, "--port", bench.port, "--ids", "1-3"]) == 0
        first, second = capsys.readouterr().out.splitlines()[1:]
        name = "XL330-M288" if bus == "dynamixel" else "STS3215"
        for part in (name, "2048", "3.30 V", "41 C", "off", "voltage"):
            assert part in first
        assert second.split()[0] == "2"


def test_what_is_wrong_is_one_line(tmp_path, capsys):
    with served(1, bus="dynamixel") as bench:
        port = bench.port
        status = record(tmp_path, port, "--bus", "dynamixle")
        refused(capsys, status, 2, "--bus: found 'dynamixle'", "did you mean dynamixel?")
        status = main(["scan", "--bus", "feetech", "--port", port, "--ids", "1-2"])
        refused(capsys, status, 1, "no servo answers", "feetech", "1000000", "--bus")
        status = record(tmp_path, port, "--bus", "feetech")
        refused(capsys, status, 1, "no reply from servo 1 (feetech, 1000000 baud)")
        status = record(tmp_path, port, "--bus", "dynamixel", "--baud", "57600")
        refused(capsys, status, 1, "no reply from servo 1 (dynamixel, 57600 baud)")
        status = record(tmp_path, port, "--bus", "dynamixel", "--baud", "-1")
        refused(capsys, status, 2, "--baud: found -1")
        more = ["--bus", "dynamixel", "--ids", "7"]
        refused(capsys, record(tmp_path, port, *more), 1, "no reply from servo 7")
        more = ["--bus", "dynamixel", "--ids", "253"]
        refused(capsys, record(tmp_path, port, *more), 2, "--ids: found 253", "0 to 252")
        bench.servos[0].put("operating_mode", 1)
        status = record(tmp_path, port, "--bus", "dynamixel")
        refused(capsys, status, 2, "servo 1: operating mode: found 1", "3 (position)")
        bench.servos[0].put("operating_mode", 3)
        bench.servos[0].put("max_position", 2100)
        status = record(tmp_path, port, "--bus", "dynamixel")
        refused(capsys, status, 2, "limits_rad", "limits that the servo reaches")
        bench.servos[0].put("model", 350)
        status = record(tmp_path, port, "--bus", "dynamixel")
        refused(capsys, status, 2, "servo 1: model: found number 350", "XL430-W250")
    assert not (tmp_path / "run.csv").exists()


def test_a_rate_that_is_too_slow_is_refused(tmp_path, capsys):
    with served(3, bus="dynamixel") as bench:
        for servo in bench.servos:  # as if they listened at any rate
            assert servo.get("baud") == 3
        options = ["--bus", "dynamixel", "--baud", "38400"]  # a terminal's own rate
        status = record(tmp_path, bench.port, *options, joints=3)
        refused(capsys, status, 2, "--baud: found 38400 baud", "a faster rate")


def test_a_servo_outside_its_range_is_not_driven(tmp_path, capsys):
    """It would jump to the end of the range; in an operating mode of several turns it is inside."""
    with served(1, bus="dynamixel") as bench:
        (servo,) = bench.servos
        servo.put("max_position", 2600)
        servo.put("min_position", 1500)
        servo._shaft = Shaft(LAW, time.monotonic(), 1.2)  # 2830 ticks
        status = record(tmp_path, bench.port, "--bus", "dynamixel", "--trim=0")
        refused(capsys, status, 1, "2830 ticks, outside its range of 1500 to 2600", "torque off")
        servo.put("operating_mode", 4)
        servo.put("max_position", 4095)
        more = ["--bus", "dynamixel", "--seconds", "1"]
        assert record(tmp_path, bench.port, *more) == 0
    assert np.nanmax(np.abs(read_recording(tmp_path / "run.csv").command)) <= 0.8


@pytest.mark.parametrize("bus", BUSES)
def test_the_user_stops_it_and_limits_are_restored(tmp_path, capsys, bus, state):
    with served(1, bus=bus) as bench:
        (servo,) = bench.servos
        if bus != "lx":
            limit(servo, LIMITS)

        def hang_up():
            assert servo.powered
            os.kill(os.getpid(), signal.SIGHUP)

        with when_rows(tmp_path / "run.csv", 10, hang_up):
            status = record(tmp_path, bench.port, "--bus", bus)
        refused(capsys, status, 1, "interrupted", "torque off")
        assert not servo.powered
        if bus != "lx":
            assert {name: servo.get(name) for name in LIMITS} == LIMITS
    assert list(state.glob("sim2real/ports/*.lock"))
    assert not list(state.glob("sim2real/ports/*.json"))


def test_limits_are_restored_by_the_next_command(capsys):
    """After a kill, which leaves the journal, whichever bus the next command asks for."""
    with served(1, bus="dynamixel") as bench:
        (servo,) = bench.servos
        limit(servo, {**LIMITS, "bus_watchdog": -1})
        with connection("dynamixel", bench.port) as link:
            saved = link.bus.saved(1)
            assert saved == {"bus_watchdog": 0, **LIMITS}
            link.journal.note([Changed("dynamixel", 1_000_000, 1, saved)])
            link.bus.begin({1: 2048})
            assert servo.powered and servo.get("profile_velocity") == 0
            with pytest.raises(InputError, match="in use by another command"):
                Journal(bench.port)
        main(["scan", "--port", bench.port, "--ids", "9"])
        said = capsys.readouterr().err.splitlines()
        assert said[0] == (
            f"{bench.port}: servos 1, left on by an earlier command: torque off, limits restored"
        )
        assert not servo.powered
        assert {name: servo.get(name) for name in LIMITS} == LIMITS
        assert servo.get("bus_watchdog") == 0
        main(["scan", "--port", bench.port, "--ids", "9"])
        assert "left on" not in capsys.readouterr().err


def test_a_servo_that_did_not_answer_is_restored_later_to_what_it_had(tmp_path, capsys):
    """Even if it is recorded again in between, when its limits are those of the first recording."""
    with served(1, bus="feetech") as bench:
        (servo,) = bench.servos
        before = Changed("feetech", 1_000_000, 1, LIMITS)
        journal = Journal(bench.port)
        assert journal.note([before]) == [before]
        journal.close()
        servo.connected = False
        main(["scan", "--bus", "feetech", "--port", bench.port, "--ids", "1"])
        gone = f"no confirmation from 1 (if they are gone, delete {journal.path})"
        assert gone in capsys.readouterr().err
        servo.connected = True
        journal = Journal(bench.port)
        now = Changed("feetech", 1_000_000, 1, dict.fromkeys(LIMITS, 0))
        assert journal.note([now]) == [before], "what it had first"
        journal.close()
        assert record(tmp_path, bench.port, "--bus", "feetech", "--seconds", "1") == 0
        assert {name: servo.get(name) for name in LIMITS} == LIMITS
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
        bus.cycle({1: 2048}, begin + 0.01)
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
