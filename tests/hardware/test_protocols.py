"""Frames of Dynamixel and Feetech: known packets, and any bytes at all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim2real.hardware import dynamixel, feetech
from sim2real.hardware.dynamixel import DynamixelDecoder, DynamixelPacket
from sim2real.hardware.feetech import FeetechDecoder, FeetechPacket
from sim2real.hardware.registers import LAYOUTS, Register

# examples of the e-Manual's pages on Protocol 2.0, and of Feetech's protocol manual
DYNAMIXEL = {
    "FF FF FD 00 01 03 00 01 19 4E": DynamixelPacket(1, 0x01),
    "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D": DynamixelPacket(1, 0x55, b"\x00\x06\x04\x26"),
    "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15": DynamixelPacket(1, 0x02, b"\x84\x00\x04\x00"),
    "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0": DynamixelPacket(
        1, 0x55, b"\x00\xa6\x00\x00\x00"
    ),
    "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89": DynamixelPacket(
        1, 0x03, b"\x74\x00\x00\x02\x00\x00"
    ),
}
FEETECH = {
    "FF FF 01 02 01 FB": FeetechPacket(1, 0x01),
    "FF FF 01 02 00 FC": FeetechPacket(1, 0x00),
    "FF FF 01 04 02 38 02 BE": FeetechPacket(1, 0x02, b"\x38\x02"),
    "FF FF 01 04 00 18 05 DD": FeetechPacket(1, 0x00, b"\x18\x05"),
}


@pytest.mark.parametrize(
    ("protocol", "decoder", "golden"),
    [(dynamixel, DynamixelDecoder, DYNAMIXEL), (feetech, FeetechDecoder, FEETECH)],
)
def test_known_packets_split_at_every_byte(protocol, decoder, golden):
    for text, packet in golden.items():
        data = bytes.fromhex(text)
        assert protocol.encode(packet) == data
        for at in range(len(data) + 1):
            fresh = decoder()
            found = fresh.feed(b"\xff\x00\xfd" + data[:at]) + fresh.feed(data[at:])
            assert found == [packet], (text, at)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 252), st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=20))
def test_stuffing_hides_every_header(servo_id, body):
    packet = DynamixelPacket(servo_id, 3, bytes(body))
    data = dynamixel.encode(packet)
    assert data.count(dynamixel.HEADER) == 1
    assert DynamixelDecoder().feed(data + data) == [packet, packet]


@pytest.mark.parametrize(
    ("protocol", "make", "kind"),
    [(dynamixel, DynamixelDecoder, DynamixelPacket), (feetech, FeetechDecoder, FeetechPacket)],
)
def test_packets_are_found_after_any_noise(protocol, make, kind):
    rng, decoder, lost = np.random.default_rng(0), make(64), 0
    for k in range(500):
        packet = kind(k % 250, 3, rng.bytes(int(rng.integers(8))))
        noise = rng.choice([0xFF, 0xFD, 0x00, 0x01, 0x30], int(rng.integers(12)))
        quiet = bytes(64)  # completes a frame that the noise began
        lost += packet not in decoder.feed(
            noise.astype(np.uint8).tobytes() + quiet + protocol.encode(packet)
        )
    assert lost <= 2, "but for chance agreement of a checksum"


@pytest.mark.parametrize("make", [DynamixelDecoder, FeetechDecoder])
def test_ten_thousand_random_bytes(make):
    rng, decoder = np.random.default_rng(1), make()
    data = rng.choice([0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x00, 0x09, 0x55], 10_000)
    for start in range(0, 10_000, 37):
        decoder.feed(data[start : start + 37].astype(np.uint8).tobytes())
    assert decoder.garbled > 10


def test_numbers_of_registers():
    speed = Register(58, 2, sign_bit=15)
    assert speed.encode(-3, "little") == b"\x03\x80"
    assert speed.encode(-3, "big") == b"\x80\x03"
    assert Register(60, 2, sign_bit=10).decode(b"\x05\x04", "little") == -5
    assert Register(128, 4, signed=True).encode(-2, "little") == b"\xfe\xff\xff\xff"
    with pytest.raises(OverflowError):
        speed.encode(40_000, "little")


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_what_a_recording_changes_is_lost_without_supply(layout):
    for name in (*layout.changed, "torque_enable", "goal_position"):
        assert layout[name].address >= layout.volatile_from
