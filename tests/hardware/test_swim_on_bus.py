"""A policy that drives servos on a bus of this computer, and the radio that carries a bus."""

import math
import socket
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from virtual_bench import LIMITS, limit, limits, refused, robot_file, served

from rl.deploy.link import Telemetry, telemetry_bytes
from sim2real.cli import main
from sim2real.hardware.frames import LX, Packet
from sim2real.hardware.lx import LxBus, LxCommand
from sim2real.hardware.radio import (
    AHEAD,
    HALF,
    PATIENCE,
    SILENCE_S,
    UdpTransport,
    VirtualRadio,
    answer,
    read_answer,
    request,
)
from sim2real.hardware.transport import open_transport
from sim2real.recording import read_recording
from tests.rl.test_swim import policy_file

JOINTS = ("j1", "j2", "j3")


policy = policy_file  # a fixture


@pytest.fixture
def tracker():
    """URL at which poses arrive, from a tracker that sees the fish stand still."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    done = threading.Event()

    def watch():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not done.wait(0.02):
                seen = Telemetry(time.monotonic(), np.zeros(3), np.empty(0))
                sender.sendto(telemetry_bytes(seen), address)

    thread = threading.Thread(target=watch)
    thread.start()
    yield "udp://{}:{}".format(*address)
    done.set()
    thread.join()


def swim(policy, folder, port, tracker, *more, bus="dynamixel"):
    robot = str(robot_file(folder, 3))
    return main(
        ["swim", str(policy), "--target", "1.5,0.4", "--bus", bus, "--port", port, "--ids", "1,2,3",
         "--robot", robot, "--pose", tracker, "--seconds", "1", "--out", str(folder / "swim.csv"),
         *more]
    )  # fmt: skip


def test_servos_follow_the_policy_and_are_released(policy, tmp_path, tracker):
    with served(3, bus="dynamixel") as bench:
        for servo in bench.servos:
            limit(servo)
        assert swim(policy, tmp_path, bench.port, tracker) == 0
        for servo in bench.servos:
            assert not servo.powered
            assert limits(servo) == LIMITS
    recording = read_recording(tmp_path / "swim.csv")
    assert recording.joints == JOINTS
    assert np.nanmax(np.abs(recording.position)) > 0.1
    late = recording.command[:-4] - recording.position[4:]  # its latency
    assert np.nanmedian(np.abs(late)) < 0.2


def test_a_hot_servo_ends_the_swim(policy, tmp_path, tracker, capsys):
    with served(3, bus="feetech", temperature_C=60, heating_C_per_s=6) as bench:
        assert swim(policy, tmp_path, bench.port, tracker, "--seconds", "5", bus="feetech") == 1
        assert not any(servo.powered for servo in bench.servos)
    assert "j1's servo is at 66 C, above 65 C" in capsys.readouterr().err


def test_what_is_wrong_is_one_line(policy, tmp_path, tracker, capsys):
    for more, part in (
        (["--ids", "1,2"], "--ids: found 2 numbers, expected 3"),
        (["--pose", "nonsense"], "--pose"),
        (["--bus", "lynx"], "--bus: found 'lynx'"),
        (["--ids", "4,5,6"], "no reply from servo 4"),
    ):
        with served(3, bus="dynamixel") as bench:
            refused(capsys, swim(policy, tmp_path, bench.port, tracker, *more), 2, part)


KEY = b"a key of the swimming pool"
MINE, OTHER = ("127.0.0.1", 1), ("127.0.0.1", 2)
ASK = LX.encode(Packet(1, LxCommand.POS_READ, b""))
SESSION = bytes(2 * HALF)


def connected(port, key):
    return closing(LxBus(UdpTransport(port, key)))


def heard(port, key, patience_s=1.0):
    """Whether a servo answers a computer with this key."""
    with connected(port, key) as bus:
        return bus.ask(1, LxCommand.POS_READ, patience_s) is not None


@pytest.mark.parametrize("key", [None, KEY])
def test_a_stranger_is_not_heard(key):
    with (
        served(1, udp=True, key=key) as bench,
        closing(LxBus(UdpTransport(bench.port, key))) as bus,
    ):
        assert bus.ask(1, LxCommand.POS_READ, 1.0) is not None
        host, port = bench.port.removeprefix("udp://").split(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.settimeout(0.1)
            for number in (0, 1, 2, 500, 60_000):
                stranger.sendto(request(number, ASK, SESSION, key), (host, int(port)))
                stranger.sendto(ASK, (host, int(port)))
                assert bus.ask(1, LxCommand.POS_READ, 1.0) is not None
            with pytest.raises(TimeoutError):
                stranger.recv(2048)


@pytest.mark.parametrize("key", [None, KEY])
def test_a_computer_that_is_done_leaves_the_radio_to_the_next(key):
    with served(1, udp=True, key=key) as bench:
        assert all(heard(bench.port, key) for _ in range(3))


@pytest.mark.parametrize(("radios", "computers"), [(KEY, None), (None, KEY), (KEY, KEY[::-1])])
def test_another_key_is_no_key(radios, computers):
    with served(1, udp=True, key=radios) as bench:
        assert not heard(bench.port, computers, 0.1)


def test_the_key_comes_from_the_environment(monkeypatch):
    monkeypatch.setenv("SIM2REAL_KEY", KEY.decode())
    with served(1, udp=True, key=KEY) as bench, closing(LxBus(open_transport(bench.port))) as bus:
        assert bus.ask(1, LxCommand.POS_READ, 1.0) is not None


def test_a_radio_that_was_switched_off_is_found_again():
    """It has forgotten the session, and does not answer until another is begun."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        port = "udp://{}:{}".format(*end.getsockname())
        with closing(UdpTransport(port, KEY)) as transport:
            for _ in range(2):
                radio = VirtualRadio(KEY)
                tries = (exchanged(end, radio, transport) for _ in range(2 * PATIENCE))
                assert b"angle" in tries
                assert exchanged(end, radio, transport) == b"angle"


def exchanged(end, radio, transport):
    """What the transport reads after a request, which may be sent after a first datagram."""
    transport.write(ASK)
    for _ in range(2):
        datagram, sender = end.recvfrom(2048)
        packets = radio.receive(datagram, sender, time.monotonic())
        if packets is None:
            return b""
        end.sendto(radio.answer(0.0, b"angle" if packets else b""), sender)
        if found := transport.read(time.monotonic() + 0.1):
            return found
    return b""


def test_numbers_advance_by_bounded_steps():
    for number in (65_000, 64_999, 0, 1, (65_001 + AHEAD) % 65_536):
        radio = VirtualRadio()
        assert radio.receive(request(65_000, ASK), MINE, 0.0) == ASK
        step = (number - 65_000) % 65_536
        expected = ASK if 0 < step <= AHEAD else None
        assert radio.receive(request(number, ASK), MINE, 0.1) == expected, number
    radio = VirtualRadio()
    silent = 0.2 + SILENCE_S + 0.01
    for number, data, sender, now, expected in (
        (65_000, ASK, MINE, 0.0, ASK),
        (65_001, ASK, OTHER, 0.2, None),
        (65_001, ASK, MINE, 0.2, ASK),
        (7, ASK, OTHER, silent, ASK),
        (65_002, ASK, MINE, 0.8, None),
        (8, b"", OTHER, 0.8, b""),  # released
        (65_003, ASK, MINE, 0.81, ASK),
    ):
        assert radio.receive(request(number, data), sender, now) == expected, number


def test_a_session_with_a_key_cannot_be_replayed():
    radio, sent = VirtualRadio(KEY), []

    def receive(number, data, session, sender, now):
        sent.append(request(number, data, session, KEY))
        return radio.receive(sent[-1], sender, now)

    assert receive(1, ASK, SESSION, MINE, 0.0) is None, "it has to begin"
    assert receive(0, b"", SESSION, MINE, 0.1) == b""
    reply = read_answer(radio.answer(1.0, b""), KEY)
    assert reply.session != SESSION
    assert receive(1, ASK, reply.session, MINE, 0.2) == ASK
    assert receive(0, b"", SESSION, OTHER, 0.3) is None
    for now, sender in ((0.3, MINE), (0.3, OTHER), (9.0, OTHER), (20.0, MINE)):
        heard = [radio.receive(datagram, sender, now) for datagram in list(sent)]
        assert ASK not in heard
    assert read_answer(answer(1, 1.0, b"", reply.session, KEY)[:-1], KEY) is None
    assert radio.receive(request(2, ASK, reply.session, None), MINE, 20.0) is None
    assert math.isfinite(radio._heard)
