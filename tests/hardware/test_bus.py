"""Requests and replies: what is late, echoed or spoilt never passes for an answer."""

import math
import socket
import threading
from contextlib import closing

import numpy as np
import pytest
from good_input import ROBOT

from sim2real.errors import InputError
from sim2real.hardware.datagram import Datagram, answer, read_answer, read_request, request
from sim2real.hardware.frames import LX, Packet
from sim2real.hardware.lx import LxBus, LxCommand, lx_servo, move
from sim2real.hardware.mounting import Wiring, check_ids, mount
from sim2real.hardware.transport import open_transport
from sim2real.hardware.virtual_bus import Law, VirtualBus
from sim2real.hardware.virtual_servos import VirtualLx
from sim2real.robot import read_robot

ASK = Packet(1, LxCommand.POS_READ)
REPLY = Packet(1, LxCommand.POS_READ, b"\x00\x02")


class Script:
    """A transport that gives these pieces, then silence."""

    together, device_s = False, None

    def __init__(self, *pieces):
        self.pieces, self.written = list(pieces), b""

    def write(self, data):
        self.written += data

    def read(self, deadline):
        return self.pieces.pop(0) if self.pieces else b""

    def close(self):
        self.written = None


@pytest.mark.parametrize(
    ("pieces", "found"),
    [
        ([LX.encode(REPLY)], REPLY),
        ([LX.encode(move(1, 3)) + LX.encode(ASK), LX.encode(REPLY)], REPLY),  # its own echo first
        ([b"\x55\x07\x55", LX.encode(REPLY)[:3], LX.encode(REPLY)[3:] + b"\x55"], REPLY),
        ([LX.encode(Packet(2, LxCommand.POS_READ, b"\x09\x09")), LX.encode(REPLY)], REPLY),
        ([LX.encode(Packet(1, LxCommand.VIN_READ, b"\x09\x09")), LX.encode(REPLY)], REPLY),
        ([], None),
        ([LX.encode(ASK)], None),
        ([LX.encode(REPLY)[:-1]], None),
        ([LX.encode(REPLY)[:-1] + b"\x00"], None),
    ],
)
def test_the_reply_is_found(pieces, found):
    script = Script(*pieces)
    assert LxBus(script).exchange([move(1, 3), ASK], math.inf) == [None, found]
    assert script.written == LX.encode(move(1, 3)) + LX.encode(ASK)


def test_replies_come_in_any_order_and_what_came_too_late_is_thrown_away():
    other = Packet(2, LxCommand.POS_READ, b"\x01\x00")
    bus = LxBus(Script(LX.encode(other) + LX.encode(REPLY)))
    asked = [ASK, Packet(2, LxCommand.POS_READ), Packet(3, LxCommand.POS_READ)]
    assert bus.exchange(asked, math.inf) == [REPLY, other, None]
    bus = LxBus(Script(LX.encode(REPLY), LX.encode(REPLY)[:4]))
    bus.drain()
    assert bus.exchange([ASK], math.inf) == [None]


def test_datagrams():
    assert read_request(request(513, b"abc")) == Datagram(b"abc", 513)
    assert request(513, b"abc") == b"LX\x01\x02abc"
    found = read_answer(answer(513, 12.5, b"abc"))
    assert (found.number, found.data) == (513, b"abc")
    assert found.clock_s == pytest.approx(12.5)
    assert read_answer(b"\x55\x55") == Datagram(b"\x55\x55"), "a plain bridge"


@pytest.mark.parametrize(
    "url", ["/dev/no-such-port", "udp://", "udp://h:1:2", "udp://127.0.0.1:x", "nonsense://x", ""]
)
def test_ports_that_are_none(url):
    with pytest.raises(InputError, match="--port"):
        open_transport(url)


def test_a_serial_port_over_the_network():
    servos = VirtualBus(
        [VirtualLx(1, Law(), 0.0)], LX, np.random.default_rng(0), baud=115_200, fast=True
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            far, _ = listener.accept()
            with far:
                while data := far.recv(100):
                    for reply in servos.receive(data):
                        far.sendall(reply)

        thread = threading.Thread(target=serve)
        thread.start()
        port = f"socket://127.0.0.1:{listener.getsockname()[1]}"
        with closing(LxBus(open_transport(port))) as bus:
            assert bus.ask(1, LxCommand.POS_READ, 5.0) == Packet(1, LxCommand.POS_READ, b"\xf4\x01")
            assert bus.ask(2, LxCommand.POS_READ, 0.01) is None
            assert bus.ask(1, LxCommand.TEMP_READ, 5.0).parameters == b"\x1e"
        thread.join(5)


@pytest.fixture
def fish(tmp_path):
    def robot(limits="[-0.8, 0.8]"):
        path = tmp_path / "robot.toml"
        path.write_text(ROBOT.replace("[-0.8, 0.8]", limits))
        return read_robot(path)

    return robot


def test_ticks_and_angles(fish):
    (plain,) = mount(fish(), [lx_servo(1)], Wiring([1]))
    (turned,) = mount(fish(), [lx_servo(1)], Wiring([1], trim_ticks=[20], reverse=["j1"]))
    assert plain.ticks(0.0) == 500
    assert plain.ticks(0.24 * 3.141592653589793 / 180 * 100) == 600
    assert turned.ticks(0.0) == 520
    assert turned.ticks(plain.angle(600)) == 420
    for mounting in (plain, turned):
        for angle in (-9, -0.8, -0.31, 0.0, 0.31, 0.8, 9):
            inside = mounting.angle(mounting.ticks(angle))
            assert -0.8 <= inside <= 0.8
            assert abs(inside - min(max(angle, -0.8), 0.8)) <= 0.0042


@pytest.mark.parametrize(
    ("ids", "wiring", "limits", "message"),
    [
        ([0, 1], {}, "[-0.8, 0.8]", "found 2"),
        ([0], {"trim_ticks": [1, 2]}, "[-0.8, 0.8]", "trim"),
        ([0], {"reverse": ["j9"]}, "[-0.8, 0.8]", "j9"),
        ([0], {"trim_ticks": [400]}, "[-0.8, 0.8]", "limits_rad"),
        ([1], {}, "[-2.5, 2.5]", r"limits_rad.*-2\.5"),
    ],
)
def test_servos_that_do_not_fit_the_robot(fish, ids, wiring, limits, message):
    with pytest.raises(InputError, match=message):
        mount(fish(limits), [lx_servo(k) for k in ids], Wiring(ids, **wiring))


@pytest.mark.parametrize("ids", [[], [254], [1, 1]])
def test_numbers_that_no_servo_has(ids):
    with pytest.raises(InputError, match="--ids"):
        check_ids(ids, 253)
