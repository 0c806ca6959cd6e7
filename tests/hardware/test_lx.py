"""Packets to bytes, replies to numbers."""

import pytest
from golden import GOLDEN

from sim2real.hardware import lx
from sim2real.hardware.lx import BusCommand, Packet


@pytest.mark.parametrize("text", GOLDEN)
def test_golden_packets(text):
    assert lx.encode(GOLDEN[text]) == bytes.fromhex(text)


def test_requests_by_name():
    assert lx.encode(lx.move(1, 500, 20)) == bytes.fromhex("55 55 01 07 01 F4 01 14 00 ED")
    assert lx.encode(lx.load(1, True)) == bytes.fromhex("55 55 01 04 1F 01 DA")
    assert lx.encode(lx.load(1, False)) == bytes.fromhex("55 55 01 04 1F 00 DB")


def test_numbers_of_replies():
    assert lx.signed_word(GOLDEN["55 55 01 05 1C 00 02 DB"]) == 512
    assert lx.signed_word(GOLDEN["55 55 01 05 1C F4 FF EA"]) == -12
    assert lx.supply_V(GOLDEN["55 55 01 05 1B E8 1C DA"]) == 7.4
    limits = GOLDEN["55 55 01 07 14 00 00 E8 03 F8"]
    assert lx.words(limits) == (0, 1000)


def test_no_servo_ever_gets_a_new_identity():
    with pytest.raises(ValueError, match="13"):
        lx.encode(Packet(254, 13, b"\x01"))
    assert 13 not in list(BusCommand)


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda: lx.encode(Packet(255, BusCommand.POS_READ)),
        lambda: lx.encode(Packet(-1, BusCommand.POS_READ)),
        lambda: lx.encode(Packet(1, BusCommand.MOVE_TIME_WRITE, bytes(5))),
        lambda: lx.move(1, 1001),
        lambda: lx.move(1, -1),
        lambda: lx.move(1, 0, 30001),
    ],
)
def test_what_the_protocol_lacks_is_refused(spoilt):
    with pytest.raises(ValueError, match="\\d"):
        spoilt()


def test_a_reply_is_told_from_an_echo():
    request = Packet(1, BusCommand.POS_READ)
    assert lx.expects_reply(request)
    assert not lx.expects_reply(lx.move(1, 500))
    assert not lx.is_reply(request, request)
    assert lx.is_reply(request, Packet(1, BusCommand.POS_READ, b"\x00\x02"))
    assert not lx.is_reply(request, Packet(2, BusCommand.POS_READ, b"\x00\x02"))
    assert not lx.is_reply(request, Packet(1, BusCommand.VIN_READ, b"\x00\x02"))
    assert lx.is_reply(Packet(254, BusCommand.ID_READ), Packet(7, BusCommand.ID_READ, b"\x07"))
