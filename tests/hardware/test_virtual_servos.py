"""A virtual servo moves as the library's servo law says, and answers what it is asked."""

import numpy as np
import pytest
from simulated import row, steps

from sim2real.hardware.frames import Packet
from sim2real.hardware.lx import LxCommand, load, move
from sim2real.hardware.virtual_bus import Law, Shaft
from sim2real.hardware.virtual_servos import VirtualLx
from sim2real.servo.rollout import rollout

LAW = Law(kp_Nm_per_rad=2.2, kd_Nms_per_rad=0.06, latency_s=0.05, inertia_kgm2=0.002)


@pytest.fixture
def shaft():
    shaft = Shaft(LAW, 0.0)
    shaft.powered = True
    return shaft


def test_the_one_law(shaft):
    rng = np.random.default_rng(5)
    t = 0.02 * np.arange(400) + rng.normal(0, 5e-4, 400)
    sent, angle = steps(t, rng), np.empty(t.size)
    for k in range(t.size):
        shaft.command(t[k], sent[k])
        angle[k] = shaft.angle(t[k])
    expected = rollout(row()[None], t, sent)[0]
    assert np.ptp(expected) > 0.5
    assert np.abs(angle - expected).max() < 1e-4


def test_without_torque_it_comes_to_rest_and_stays(shaft):
    shaft.command(0.0, 0.6)
    moving = shaft.angle(0.1)
    shaft.hold(0.1)
    shaft.powered = False
    rest = shaft.angle(3.0)
    assert 0.01 < moving < rest < 1.2
    assert shaft.angle(10.0) == pytest.approx(rest, abs=1e-9)


@pytest.fixture
def servo():
    return VirtualLx(3, LAW, 0.0)


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


def test_it_minds_its_own_business(servo):
    for packet, answer in (
        (Packet(4, LxCommand.POS_READ), None),
        (Packet(254, LxCommand.POS_READ), None),
        (Packet(254, LxCommand.ID_READ), Packet(3, 14, b"\x03")),
        (Packet(3, 13, b"\x09"), None),
        (Packet(3, LxCommand.LOAD_READ), Packet(3, LxCommand.LOAD_READ, b"\x00")),
    ):
        assert servo.handle(packet, 0.0) == answer
    assert servo.servo_id == 3
    servo.connected = False
    assert servo.handle(Packet(3, LxCommand.POS_READ), 0.0) is None
