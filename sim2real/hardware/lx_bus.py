"""LX servos behind the interface of the buses."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from sim2real.hardware import lx
from sim2real.hardware.lx import BusCommand, Packet, expects_reply, is_reply, load, move
from sim2real.hardware.servo_bus import PATIENCE_S, BusServo, Cycle, Found, Reading, Scale, Stopped
from sim2real.hardware.transport import Transport
from sim2real.hardware.wire_bus import WireBus

USUAL_S = 0.0025
"""Typical time of a servo's set-point, request and reply on the wire, with the adapter."""
SCALE = Scale(lx.TICK_RAD, lx.CENTRE_TICKS, 0, lx.LARGEST_TICKS)


class LxBus(WireBus[Packet]):
    """A bus of LX servos, which are addressed one after the other.

    The position of each is requested directly after its set-point, so that both have the same time;
    then one servo in turn reports its supply or temperature.

    Args:
        transport: The transport, which the bus closes.
        baud: Bits per second.
    """

    name: ClassVar[str] = "lx"
    baud_rates: ClassVar[tuple[int, ...]] = lx.BAUD_RATES
    largest_id: ClassVar[int] = lx.LARGEST_ID

    def __init__(self, transport: Transport, baud: int = lx.BAUD_RATES[0]) -> None:
        super().__init__(transport, lx.Decoder(), baud)
        self._turn = 0

    def exchange(self, packets: Sequence[Packet], deadline: float) -> list[Packet | None]:
        """Send packets together and wait for the replies.

        Args:
            packets: Packets in order; if not ``together``, only the last may be a request.
            deadline: Time limit, by ``time.monotonic``.

        Returns:
            The reply to each packet; None if it is missing or none was expected.
        """
        requests = [packet for packet in packets if expects_reply(packet)]
        expected = [lambda reply, request=request: is_reply(request, reply) for request in requests]
        data = b"".join(lx.encode(packet) for packet in packets)
        replies = iter(self.wire.exchange(data, expected, deadline))
        return [next(replies) if expects_reply(packet) else None for packet in packets]

    def ask(self, servo_id: int, command: int, within_s: float) -> Packet | None:
        """The reply of one servo to one request, or None."""
        return self.exchange([Packet(servo_id, command)], time.monotonic() + within_s)[0]

    def answers(self, servo_id: int, patience_s: float) -> bool:
        """Whether a servo has this identity; one request."""
        self.wire.drain()
        return self.ask(servo_id, BusCommand.POS_READ, patience_s) is not None

    def look(self, servo_id: int, patience_s: float) -> Found:
        """The state of a servo that answers; nothing is written to it.

        The protocol has no error register: LED_ERROR_READ is only a mask of the errors that switch
        the LED on. Errors are therefore limits stored in the servo that are exceeded.
        """

        def ask(command: BusCommand) -> Packet | None:
            return self._insisted(partial(self.ask, servo_id, command, patience_s))

        position, supply = ask(BusCommand.POS_READ), ask(BusCommand.VIN_READ)
        temperature, powered = ask(BusCommand.TEMP_READ), ask(BusCommand.LOAD_READ)
        hottest, range_mV = ask(BusCommand.TEMP_MAX_LIMIT_READ), ask(BusCommand.VIN_LIMIT_READ)
        errors = []
        if temperature and hottest and temperature.parameters[0] > hottest.parameters[0]:
            errors.append(f"above {hottest.parameters[0]} C")
        if supply and range_mV:
            low, high = (millivolts / 1000 for millivolts in lx.words(range_mV))
            if not low <= lx.supply_V(supply) <= high:
                errors.append(f"supply outside {low:.1f} to {high:.1f} V")
        ticks = None if position is None else lx.signed_word(position)
        return Found(
            servo_id,
            model="",
            ticks=ticks,
            angle_rad=None if ticks is None else SCALE.angle(ticks),
            supply_V=None if supply is None else lx.supply_V(supply),
            temperature_C=None if temperature is None else temperature.parameters[0],
            powered=None if powered is None else powered.parameters[0] != 0,
            errors=tuple(errors),
        )

    def servo(self, servo_id: int) -> BusServo:
        """Scale of a servo, which is the same for all of this family."""
        return lx_servo(servo_id)

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Nothing: these servos do not tell their settings."""
        return {}

    def saved(self, servo_id: int) -> dict[str, int]:
        """Nothing, of a servo that answers: only the torque changes, which is off in the end."""
        self._required_reply(servo_id, BusCommand.LOAD_READ)
        return {}

    def reading(self, servo_id: int) -> Reading:
        """Position and temperature of a servo that must answer."""
        temperature = self._required_reply(servo_id, BusCommand.TEMP_READ)
        position = self._required_reply(servo_id, BusCommand.POS_READ)
        ticks = lx.signed_word(position)
        return Reading(position_ticks=ticks, temperature_C=float(temperature.parameters[0]))

    def begin(self, goals: Mapping[int, int]) -> None:
        """Hold these set-points (ticks by identity) with the torque on."""
        for servo_id, ticks in goals.items():
            if not self._set_load(servo_id, on=True):
                raise Stopped(f"servo {servo_id} does not switch on")
            self.exchange([move(servo_id, ticks)], time.monotonic())

    def cycle(self, goals: Mapping[int, int], deadline: float) -> Cycle:
        """Send set-points (ticks by identity) and read every servo.

        A servo may take the time that the later ones do not need.
        """
        self.wire.drain()
        ids = list(goals)
        asked, command = ids[self._turn // 2 % len(ids)], BusCommand.VIN_READ
        if self._turn % 2:
            command = BusCommand.TEMP_READ
        self._turn += 1
        groups = [[move(k, goals[k]), Packet(k, BusCommand.POS_READ)] for k in ids]
        groups.append([Packet(asked, command)])
        if self.wire.together:
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
        device_s = self.wire.device_s
        health = replies[-1]
        readings = (
            _reading(reply, command, health if servo_id == asked else None)
            for servo_id, reply in zip(ids, replies[1::2], strict=False)
        )
        return Cycle(
            sent_s=sum(sent[:joints]) / joints,
            readings=tuple(readings),
            round_trip_s=max(round_trips, default=math.nan),
            device_s=math.nan if device_s is None or not round_trips else device_s,
        )

    def restore(self, servo_id: int, saved: Mapping[str, int]) -> bool:
        """Stop a servo and switch its torque off."""
        self.wire.drain()
        self.exchange([Packet(servo_id, BusCommand.MOVE_STOP)], time.monotonic())
        return self._set_load(servo_id, on=False)

    def cycle_s(self, count: int) -> float:
        """Time on the wire of a cycle with so many servos."""
        return self._wire_s(24 * count + 14)

    def sample_delay_s(self, count: int) -> float:
        """Time on the wire of the request for a position, which follows each set-point."""
        return self._wire_s(6)

    def _set_load(self, servo_id: int, *, on: bool) -> bool:
        request = [load(servo_id, on), Packet(servo_id, BusCommand.LOAD_READ)]

        def confirmed() -> Packet | None:
            reply = self.exchange(request, time.monotonic() + PATIENCE_S)[1]
            return reply if reply is not None and bool(reply.parameters[0]) == on else None

        return self._insisted(confirmed) is not None

    def _required_reply(self, servo_id: int, command: BusCommand) -> Packet:
        return self._insist(servo_id, partial(self.ask, servo_id, command, PATIENCE_S))


def lx_servo(servo_id: int) -> BusServo:
    """An LX servo."""
    return BusServo(servo_id, "LX", SCALE, ("temperature_C",))


def _reading(position: Packet | None, command: BusCommand, health: Packet | None) -> Reading:
    supply = temperature = math.nan
    if health is not None and command == BusCommand.VIN_READ:
        supply = lx.supply_V(health)
    elif health is not None:
        temperature = float(health.parameters[0])
    ticks = None if position is None else lx.signed_word(position)
    return Reading(position_ticks=ticks, supply_V=supply, temperature_C=temperature)
