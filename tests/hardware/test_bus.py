"""Requests and replies: what is late, echoed or spoilt never passes for an answer."""

import math
import socket
import threading
from contextlib import closing

import numpy as np
import pytest
from good_input import ROBOT
from hypothesis import given, settings
from hypothesis import strategies as st

from sim2real.errors import InputError
from sim2real.hardware.buses import ids_of
from sim2real.hardware.frames import DYNAMIXEL, FEETECH, LX, FrameDecoder, Packet
from sim2real.hardware.lx import LxBus, LxCommand, load, move, number
from sim2real.hardware.mounting import places
from sim2real.hardware.radio import Datagram, answer, read_answer, read_request, request
from sim2real.hardware.recorder import mounted
from sim2real.hardware.registers import LAYOUTS, Register
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
    robot, bus = fish(), LxBus(None)
    (plain,) = mounted(bus, robot, places(robot, [1]))
    (turned,) = mounted(bus, robot, places(robot, [1], trim_ticks=[20], reverse=["j1"]))
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
        mounted(LxBus(None), fish(limits), places(fish(limits), ids, **wiring))


@pytest.mark.parametrize("ids", ["", "254", "1,1", "1,a"])
def test_numbers_that_no_servo_has(ids):
    with pytest.raises(InputError, match="--ids"):
        ids_of(ids, LxBus)


PROTOCOLS = {"lx": LX, "feetech": FEETECH, "dynamixel": DYNAMIXEL}
# LX worked out by hand; examples of the e-Manual's pages on Protocol 2.0, of Feetech's manual
KNOWN = {
    "55 55 01 07 01 F4 01 00 00 01": (LX, Packet(1, 1, b"\xf4\x01\x00\x00")),
    "55 55 01 03 1C DF": (LX, Packet(1, 28)),
    "55 55 01 05 1C 00 02 DB": (LX, Packet(1, 28, b"\x00\x02")),
    "55 55 01 05 1C F4 FF EA": (LX, Packet(1, 28, b"\xf4\xff")),
    "55 55 01 05 1B E8 1C DA": (LX, Packet(1, 27, b"\xe8\x1c")),
    "55 55 01 04 1F 01 DA": (LX, Packet(1, 31, b"\x01")),
    "55 55 FE 03 0E F0": (LX, Packet(254, 14)),
    "55 55 01 07 14 00 00 E8 03 F8": (LX, Packet(1, 20, b"\x00\x00\xe8\x03")),
    "FF FF FD 00 01 03 00 01 19 4E": (DYNAMIXEL, Packet(1, 0x01)),
    "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D": (DYNAMIXEL, Packet(1, 0x55, b"\x00\x06\x04\x26")),
    "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89": (
        DYNAMIXEL,
        Packet(1, 0x03, b"\x74\x00\x00\x02\x00\x00"),
    ),
    "FF FF 01 02 01 FB": (FEETECH, Packet(1, 0x01)),
    "FF FF 01 04 02 38 02 BE": (FEETECH, Packet(1, 0x02, b"\x38\x02")),
    "FF FF 01 04 00 18 05 DD": (FEETECH, Packet(1, 0x00, b"\x18\x05")),
}


@pytest.mark.parametrize("text", KNOWN)
def test_known_packets_split_at_every_byte(text):
    (protocol, packet), data = KNOWN[text], bytes.fromhex(text)
    assert protocol.encode(packet) == data
    for ahead in (b"", b"\x55\x55\x01\x05", b"\xff\x00\xfd", protocol.header[:1]):
        for at in range(len(data) + 1):
            decoder = FrameDecoder(protocol, 30)
            found = decoder.feed(ahead + data[:at]) + decoder.feed(data[at:])
            found += decoder.feed(bytes(30))  # lets go of a beginning that promised more
            assert found == [packet], (ahead, at)
    for at in range(len(data)):
        for flip in (1, 0x80, 0xFF):
            spoilt = bytearray(data)
            spoilt[at] ^= flip
            assert FrameDecoder(protocol).feed(bytes(spoilt)) == [], "one wrong byte is noticed"


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS)
def test_a_hundred_thousand_random_bytes(protocol):
    rng, place, found = np.random.default_rng(0), 0, 0
    data = rng.integers(0, 256, 100_000, dtype=np.uint8)
    usual = np.frombuffer(protocol.header * 2 + b"\x03\x04\x05\x00", np.uint8)
    false = rng.random(data.size) < 0.7
    data[false] = rng.choice(usual, false.sum())  # many false headers
    data, decoder = data.tobytes(), FrameDecoder(protocol)
    for start in range(0, len(data), 997):
        for packet in decoder.feed(data[start : start + 997]):
            whole = protocol.encode(packet)
            place = data.index(whole, place) + len(whole)  # there, in order, not overlapping
            found += 1
    assert found > 10 or protocol is DYNAMIXEL, "some noise looks like a packet"
    assert decoder.garbled > 100


PACKETS = st.builds(Packet, st.integers(0, 252), st.integers(1, 40), st.binary(max_size=4))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(list(PROTOCOLS.values())), st.lists(st.binary(max_size=30)))
def test_pieces_do_not_matter(protocol, pieces):
    whole, cut = FrameDecoder(protocol), FrameDecoder(protocol)
    together = whole.feed(b"".join(pieces))
    assert [packet for piece in pieces for packet in cut.feed(piece)] == together
    assert whole.garbled == cut.garbled


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(list(PROTOCOLS.values())), st.lists(st.tuples(st.binary(max_size=12), PACKETS))
)
def test_packets_between_garbage_are_all_found(protocol, stream):
    stream = [(bytes(set(x) - set(protocol.header)), packet) for x, packet in stream]
    data = b"".join(garbage + protocol.encode(packet) for garbage, packet in stream)
    assert FrameDecoder(protocol).feed(data) == [packet for _, packet in stream]


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 252), st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=20))
def test_stuffing_hides_every_header(servo_id, body):
    packet = Packet(servo_id, 3, bytes(body))
    data = DYNAMIXEL.encode(packet)
    assert data.count(DYNAMIXEL.header) == 1
    assert FrameDecoder(DYNAMIXEL).feed(data + data) == [packet, packet]


def test_lx_requests_and_numbers_of_replies():
    decoder, data = FrameDecoder(LX), LX.encode(Packet(1, 28, b"\x00\x02"))
    assert decoder.feed(data[:5]) == []
    decoder.clear()
    assert decoder.feed(data[5:]) == [], "a beginning is forgotten when told"
    assert decoder.feed(data) == [Packet(1, 28, b"\x00\x02")]
    assert LX.encode(move(1, 500)) == bytes.fromhex("55 55 01 07 01 F4 01 00 00 01")
    assert LX.encode(load(1, True)) == bytes.fromhex("55 55 01 04 1F 01 DA")
    assert number(Packet(1, LxCommand.POS_READ, b"\xf4\xff")) == -12
    assert number(Packet(1, LxCommand.VIN_READ, b"\xe8\x1c")) == 7400
    assert number(Packet(1, LxCommand.VIN_LIMIT_READ, b"\x00\x00\xe8\x03"), 2) == 1000
    assert 13 not in list(LxCommand), "no servo ever gets a new identity"
    with pytest.raises(ValueError, match="1001"):
        move(1, 1001)


@pytest.mark.parametrize(
    ("protocol", "packet"),
    [
        (LX, Packet(255, 28)),
        (LX, Packet(-1, 28)),
        (LX, Packet(1, 1, bytes(5))),
        (DYNAMIXEL, Packet(253, 1)),
        (FEETECH, Packet(1, 3, bytes(251))),
    ],
)
def test_what_a_protocol_lacks_is_refused(protocol, packet):
    with pytest.raises(ValueError, match="\\d"):
        protocol.encode(packet)


def test_numbers_of_registers():
    speed = Register(58, 2, sign_bit=15)
    assert speed.encode(-3) == b"\x03\x80"
    assert Register(60, 2, sign_bit=10).decode(b"\x05\x04") == -5
    assert Register(128, 4, signed=True).encode(-2) == b"\xfe\xff\xff\xff"
    with pytest.raises(OverflowError):
        speed.encode(40_000)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_what_a_recording_changes(layout):
    """It is lost without supply, and read back in a block of a length of its own.

    So a late answer to another request, which does not tell its address, can't pass for it.
    """
    for name in (*layout.changed, "torque_enable", "goal_position"):
        assert layout[name].address >= layout.volatile_from
    _, own = layout.span(("torque_enable", *layout.changed))
    single = {register.size for register in layout.registers.values()}
    assert own not in single | {3, layout.span(layout.reported)[1]}, "3: the answer to a ping"
