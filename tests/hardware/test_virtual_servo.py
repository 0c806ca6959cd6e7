"""What a virtual servo answers."""

import pytest

from sim2real.hardware.lx import BusCommand, Packet, load, move, signed_word, supply_V
from sim2real.hardware.virtual_lx import VirtualServo
from sim2real.hardware.virtual_shaft import Law

LAW = Law(latency_s=0.05)


@pytest.fixture
def servo():
    return VirtualServo(3, LAW, 0.0, supply_V=7.5, temperature_C=40, heating_C_per_s=2)


def read(servo, command, now):
    return servo.handle(Packet(3, command), now)


def test_it_tells_what_it_is_asked(servo):
    assert signed_word(read(servo, BusCommand.POS_READ, 0.0)) == 500
    assert supply_V(read(servo, BusCommand.VIN_READ, 0.0)) == 7.5
    assert read(servo, BusCommand.TEMP_READ, 5.0).parameters == b"\x32"
    assert read(servo, BusCommand.LOAD_READ, 5.0).parameters == b"\x00"
    limits = Packet(3, BusCommand.ANGLE_LIMIT_WRITE, b"\x64\x00\x84\x03")
    assert servo.handle(limits, 5.0) is None
    assert read(servo, BusCommand.ANGLE_LIMIT_READ, 5.0).parameters == limits.parameters


def test_it_moves_only_with_its_torque_on(servo):
    servo.handle(move(3, 600), 0.0)
    assert servo.ticks(2.0) == 500
    servo.handle(load(3, True), 2.0)
    servo.handle(move(3, 600), 2.0)
    assert servo.ticks(2.04) == 500, "not before its latency"
    assert servo.ticks(4.0) == 600
    servo.handle(load(3, False), 4.0)
    servo.handle(move(3, 500), 4.0)
    assert servo.ticks(6.0) == 600


def test_a_waiting_move_starts_with_all_others(servo):
    servo.handle(load(3, True), 0.0)
    servo.handle(Packet(3, BusCommand.MOVE_TIME_WAIT_WRITE, b"\x26\x02\x00\x00"), 0.0)
    assert servo.ticks(1.0) == 500
    servo.handle(Packet(254, BusCommand.MOVE_START), 1.0)
    assert servo.ticks(3.0) == 550


def test_it_minds_its_own_business(servo):
    assert servo.handle(Packet(4, BusCommand.POS_READ), 0.0) is None
    assert servo.handle(Packet(254, BusCommand.POS_READ), 0.0) is None
    assert servo.handle(Packet(254, BusCommand.ID_READ), 0.0) == Packet(3, 14, b"\x03")
    assert servo.handle(Packet(3, 13, b"\x09"), 0.0) is None
    assert servo.servo_id == 3
    servo.connected = False
    assert read(servo, BusCommand.POS_READ, 0.0) is None
