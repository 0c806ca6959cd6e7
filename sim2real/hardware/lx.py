"""LX bus servos (LX-16A, LX-224, LX-824)."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import IntEnum
from functools import partial
from typing import Any, ClassVar

from sim2real.hardware import frames
from sim2real.hardware.frames import BROADCAST, Packet, Protocol
from sim2real.hardware.servo_bus import (
    PATIENCE_S,
    BusServo,
    Cycle,
    Found,
    Reading,
    ServoBus,
    Stopped,
)

SERVO = BusServo(0, math.radians(0.24), 500, 0, 1000, ("temperature_C",))
"""All but the identity of a servo."""
USUAL_S = 0.0025
"""Typical time of a servo's set-point, request and reply on the wire, with the adapter."""


class LxCommand(IntEnum):
    """Commands that are used here; 13, which changes an identity permanently, is none of them."""

    MOVE_TIME_WRITE = 1
    MOVE_STOP = 12
    ID_READ = 14
    VIN_LIMIT_READ = 23
    TEMP_MAX_LIMIT_READ = 25
    TEMP_READ = 26
    VIN_READ = 27
    POS_READ = 28
    LOAD_WRITE = 31
    LOAD_READ = 32


REPLY_BYTES = {
    LxCommand.ID_READ: 1,
    LxCommand.VIN_LIMIT_READ: 4,
    LxCommand.TEMP_MAX_LIMIT_READ: 1,
    LxCommand.TEMP_READ: 1,
    LxCommand.VIN_READ: 2,
    LxCommand.POS_READ: 2,
    LxCommand.LOAD_READ: 1,
}
"""Number of parameter bytes in the reply to each command that has a reply."""


def expects_reply(packet: Packet) -> bool:
    """Whether a servo replies to ``packet``."""
    return packet.code in REPLY_BYTES and not packet.parameters


def is_reply(request: Packet, packet: Packet) -> bool:
    """Whether ``packet`` is the reply to ``request``; an echo of the request is not."""
    fits = packet.code == request.code and request.servo_id in (packet.servo_id, BROADCAST)
    return fits and len(packet.parameters) == REPLY_BYTES[LxCommand(request.code)]


def move(servo_id: int, ticks: int) -> Packet:
    """Move to ``ticks``, from 0 to 1000, at the largest speed."""
    if not 0 <= ticks <= SERVO.largest_ticks:
        raise ValueError(f"{ticks} ticks is outside 0 to {SERVO.largest_ticks}")
    return Packet(servo_id, LxCommand.MOVE_TIME_WRITE, ticks.to_bytes(2, "little") + bytes(2))


def load(servo_id: int, on: bool) -> Packet:
    """Switch the torque on or off."""
    return Packet(servo_id, LxCommand.LOAD_WRITE, bytes((on,)))


def number(reply: Packet, start: int = 0) -> int:
    """Up to two bytes of a reply: mV, degrees Celsius, or a position in ticks, which has a sign."""
    word = reply.parameters[start : start + 2]
    return int.from_bytes(word, "little", signed=reply.code == LxCommand.POS_READ)


class LxBus(ServoBus):
    """A bus of LX servos, which are addressed one after the other.

    The position of each is requested directly after its set-point, so that both have the same time;
    then one servo in turn reports its supply or temperature.
    """

    name: ClassVar[str] = "lx"
    baud_rates: ClassVar[tuple[int, ...]] = (115_200, 9600)  # sometimes they fall back to 9600
    protocol: ClassVar[Protocol] = frames.LX
    longest_answer: ClassVar[int] = frames.LX.largest
    _turn = 0

    def exchange(self, packets: Sequence[Packet], deadline: float) -> list[Packet | None]:
        """The reply to each packet by ``deadline``; None if it is missing or none was expected."""
        requests = [packet for packet in packets if expects_reply(packet)]
        data = b"".join(map(self.protocol.encode, packets))
        expected = [partial(is_reply, request) for request in requests]
        replies = iter(self.transfer(data, expected, deadline))
        return [next(replies) if expects_reply(packet) else None for packet in packets]

    def ask(self, servo_id: int, command: int, within_s: float) -> Packet | None:
        """The reply of one servo to one request, or None."""
        return self.exchange([Packet(servo_id, command)], time.monotonic() + within_s)[0]

    def answers(self, servo_id: int, patience_s: float) -> bool:
        """Whether a servo has this identity; one request."""
        self.drain()
        return self.ask(servo_id, LxCommand.POS_READ, patience_s) is not None

    def look(self, servo_id: int, patience_s: float) -> Found:
        """The state of a servo that answers; nothing is written to it.

        The protocol has no error register: LED_ERROR_READ is only a mask of the errors that switch
        the LED on. Errors are therefore limits stored in the servo that are exceeded.
        """

        def ask(command: LxCommand) -> Packet | None:
            return self._insisted(partial(self.ask, servo_id, command, patience_s))

        position, supply = ask(LxCommand.POS_READ), ask(LxCommand.VIN_READ)
        temperature, powered = ask(LxCommand.TEMP_READ), ask(LxCommand.LOAD_READ)
        hottest, range_mV = ask(LxCommand.TEMP_MAX_LIMIT_READ), ask(LxCommand.VIN_LIMIT_READ)
        errors = []
        if temperature and hottest and number(temperature) > number(hottest):
            errors.append(f"above {number(hottest)} C")
        if supply and range_mV:
            low, high = number(range_mV), number(range_mV, 2)
            if not low <= number(supply) <= high:
                errors.append(f"supply outside {low / 1000:.1f} to {high / 1000:.1f} V")
        ticks = None if position is None else number(position)
        return Found(
            servo_id,
            model="",
            ticks=ticks,
            angle_rad=None if ticks is None else SERVO.angle(ticks),
            supply_V=None if supply is None else number(supply) / 1000,
            temperature_C=None if temperature is None else number(temperature),
            powered=None if powered is None else number(powered) != 0,
            errors=tuple(errors),
        )

    def servo(self, servo_id: int) -> BusServo:
        """Scale of a servo, the same for all; others raise ``Stopped`` or ``InputError``."""
        return replace(SERVO, servo_id=servo_id)

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Settings of a servo, for the recording: this protocol tells none."""
        return {}

    def saved(self, servo_id: int) -> dict[str, int]:
        """What ``begin`` changes and ``restore`` restores, of a servo that must answer: nothing.

        Only the torque changes, which is off in the end.
        """
        self._required(servo_id, LxCommand.LOAD_READ)
        return {}

    def reading(self, servo_id: int) -> Reading:
        """Position and temperature of a servo that must answer; ``Stopped`` if it does not."""
        temperature = self._required(servo_id, LxCommand.TEMP_READ)
        return Reading(self._required(servo_id, LxCommand.POS_READ), temperature_C=temperature)

    def begin(self, goals: Mapping[int, int]) -> None:
        """Hold set-points (ticks by identity), torque on, without profile; ``Stopped`` if not."""
        for servo_id, ticks in goals.items():
            if not self._set_load(servo_id, on=True):
                raise Stopped(f"servo {servo_id} does not switch on")
            self.exchange([move(servo_id, ticks)], time.monotonic())

    def cycle(self, goals: Mapping[int, int], deadline: float) -> Cycle:
        """Send set-points (ticks by identity) and read each servo by ``deadline``.

        A servo may take the time that later ones do not need.
        """
        self.drain()
        ids = list(goals)
        asked = ids[self._turn // 2 % len(ids)]
        command, name, unit = LxCommand.VIN_READ, "supply_V", 1000
        if self._turn % 2:
            command, name, unit = LxCommand.TEMP_READ, "temperature_C", 1
        self._turn += 1
        groups = [[move(k, goals[k]), Packet(k, LxCommand.POS_READ)] for k in ids]
        groups.append([Packet(asked, command)])
        if self._transport.together:
            groups = [[packet for group in groups for packet in group]]
        replies: list[Packet | None] = []
        sent, round_trips = [], []
        for after, group in zip(reversed(range(len(groups))), groups, strict=True):
            sent.append(time.monotonic())
            remaining = deadline - sent[-1]
            limit = sent[-1] + max(remaining - after * USUAL_S, remaining / (after + 1))
            received = self.exchange(group, limit)
            if received[-1] is not None:
                round_trips.append(time.monotonic() - sent[-1])
            replies += received
        joints = max(len(groups) - 1, 1)  # the last group of several is the health request
        readings = []
        for servo_id, reply in zip(ids, replies[1::2], strict=False):
            told: dict[str, Any] = {}
            if servo_id == asked and (health := replies[-1]) is not None:
                told[name] = number(health) / unit
            ticks = None if reply is None else number(reply)
            readings.append(Reading(ticks, **told))
        return Cycle(
            sent_s=sum(sent[:joints]) / joints,
            readings=tuple(readings),
            round_trip_s=max(round_trips, default=math.nan),
            device_s=self._device_s(bool(round_trips)),
        )

    def restore(self, servo_id: int, saved: Mapping[str, int]) -> bool:
        """Stop a servo and switch its torque off; whether it confirmed all."""
        self.drain()
        self.exchange([Packet(servo_id, LxCommand.MOVE_STOP)], time.monotonic())
        return self._set_load(servo_id, on=False)

    def cycle_s(self, count: int) -> float:
        """Time on the wire of a cycle with so many servos."""
        return self._wire_s(24 * count + 14)

    def sample_delay_s(self, count: int) -> float:
        """Time from a set-point to the sampling of the position: the request on the wire."""
        return self._wire_s(6)

    def _set_load(self, servo_id: int, *, on: bool) -> bool:
        request = [load(servo_id, on), Packet(servo_id, LxCommand.LOAD_READ)]

        def confirmed() -> Packet | None:
            reply = self.exchange(request, time.monotonic() + PATIENCE_S)[1]
            return reply if reply is not None and bool(number(reply)) == on else None

        return self._insisted(confirmed) is not None

    def _required(self, servo_id: int, command: LxCommand) -> int:
        """The number that a servo must answer."""
        return number(self._insist(servo_id, partial(self.ask, servo_id, command, PATIENCE_S)))
