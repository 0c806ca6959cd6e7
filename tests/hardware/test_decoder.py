"""The decoder: whatever it is fed, it finds what is there and raises nothing."""

import numpy as np
import pytest
from golden import GOLDEN
from hypothesis import given, settings
from hypothesis import strategies as st

from sim2real.hardware.lx import HEADER, Decoder, Packet, checksum, encode

PACKETS = st.builds(
    Packet,
    st.integers(0, 254),
    st.sampled_from([1, 12, 26, 27, 28, 31, 36]),
    st.binary(max_size=4),
)


@pytest.mark.parametrize("text", GOLDEN)
@pytest.mark.parametrize("ahead", [b"", b"\x55", b"\x55\x55", b"\x55\x55\x01\x05", b"\x00\xff"])
def test_golden_packets_split_at_every_byte(text, ahead):
    data = bytes.fromhex(text)
    for at in range(len(data) + 1):
        decoder = Decoder()
        found = decoder.feed(ahead + data[:at]) + decoder.feed(data[at:])
        found += decoder.feed(bytes(10))  # lets go of a beginning that promised more
        assert found == [GOLDEN[text]]


def test_a_million_random_bytes():
    rng = np.random.default_rng(0)
    data = rng.integers(0, 256, 1_000_000, dtype=np.uint8)
    data[rng.random(data.size) < 0.2] = 0x55  # many false headers
    lengths = rng.random(data.size) < 0.2
    data[lengths] = rng.integers(3, 8, lengths.sum())
    data = data.tobytes()
    decoder, place, found = Decoder(), 0, 0
    for start in range(0, len(data), 997):
        for packet in decoder.feed(data[start : start + 997]):
            body = bytes([packet.servo_id, len(packet.parameters) + 3, packet.command])
            body += packet.parameters
            whole = HEADER + body + bytes([checksum(body)])
            place = data.index(whole, place) + len(whole)  # there, in order, not overlapping
            found += 1
    assert found > 10, "some noise looks like a packet"
    assert decoder.garbled > 10_000


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=30)))
def test_pieces_do_not_matter(pieces):
    whole, cut = Decoder(), Decoder()
    together = whole.feed(b"".join(pieces))
    assert [packet for piece in pieces for packet in cut.feed(piece)] == together
    assert (whole.garbled, whole.skipped) == (cut.garbled, cut.skipped)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.binary(max_size=12).filter(lambda b: b"\x55" not in b), PACKETS)))
def test_packets_between_garbage_are_all_found(stream):
    data = b"".join(garbage + encode(packet) for garbage, packet in stream)
    decoder = Decoder()
    assert decoder.feed(data) == [packet for _, packet in stream]
    assert decoder.skipped == sum(len(garbage) for garbage, _ in stream)


@pytest.mark.parametrize("text", GOLDEN)
def test_any_one_wrong_byte_is_noticed(text):
    data = bytearray.fromhex(text)
    for at in range(len(data)):
        for flip in (1, 0x80, 0xFF):
            spoilt = bytearray(data)
            spoilt[at] ^= flip
            assert Decoder().feed(bytes(spoilt)) == []


def test_a_beginning_is_forgotten_when_told():
    decoder = Decoder()
    data = bytes.fromhex("55 55 01 05 1C 00 02 DB")
    assert decoder.feed(data[:5]) == []
    decoder.clear()
    assert decoder.feed(data[5:]) == []
    assert decoder.feed(data) == [Packet(1, 28, b"\x00\x02")]
