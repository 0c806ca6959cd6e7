"""Buses whose servos are controlled by reading and writing registers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from sim2real.errors import InputError
from sim2real.hardware import servo_models
from sim2real.hardware.frames import FrameDecoder
from sim2real.hardware.register_values import found_servo, quantities, reading_of
from sim2real.hardware.registers import TORQUE, Layout, Register
from sim2real.hardware.servo_bus import (
    INSISTENCE,
    PATIENCE_S,
    BusServo,
    Cycle,
    Found,
    Reading,
    Scale,
    Stopped,
)
from sim2real.hardware.servo_models import ServoModel
from sim2real.hardware.transport import Transport
from sim2real.hardware.wire_bus import P, T, WireBus

FIRST_SHARE = 0.7
"""Share of a cycle's time after which an answer counts as missing."""
TURNS = 7
"""Turns to each side that are used of servos that do several."""
ADAPTER_S = 0.003
"""Longest usual time of adapter and servo besides the time on the wire."""
_SCAN = ("present_position", "present_voltage", "present_temperature")


class RegisterBus(WireBus[P], ABC):
    """A bus of servos with registers, which are set and read together.

    A write is confirmed by reading the register, so that it does not matter whether the servo
    answers to writes, and which answers are lost.

    Args:
        transport: The transport, which the bus closes.
        baud: Bits per second.
    """

    baud_rates: ClassVar[tuple[int, ...]]
    largest_id: ClassVar[int]

    def __init__(self, transport: Transport, baud: int) -> None:
        super().__init__(transport, self._decoder(), baud)
        self._models: dict[int, ServoModel] = {}

    @abstractmethod
    def _decoder(self) -> FrameDecoder[P]:
        """A decoder of status packets."""

    @abstractmethod
    def _read(self, servo_id: int, address: int, count: int) -> bytes:
        """The instruction to read ``count`` bytes."""

    @abstractmethod
    def _write(self, servo_id: int, address: int, data: bytes) -> bytes:
        """The instruction to write bytes."""

    @abstractmethod
    def _sync_read(self, ids: Sequence[int], address: int, count: int) -> bytes:
        """The instruction to read ``count`` bytes of several servos."""

    @abstractmethod
    def _sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        """The instruction to write bytes, as many for each servo."""

    @abstractmethod
    def _data(self, packet: P, servo_id: int) -> bytes | None:
        """The data of a status packet of this servo without an error; None for any other packet."""

    @abstractmethod
    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        """The number of the servo's model, or None if it does not answer; one request."""

    @abstractmethod
    def _status_bytes(self, count: int) -> int:
        """Length of a status packet with ``count`` bytes of data."""

    def answers(self, servo_id: int, patience_s: float) -> bool:
        """Whether a servo has this identity; one request."""
        return self._ask_number(servo_id, patience_s) is not None

    def look(self, servo_id: int, patience_s: float) -> Found:
        """The state of a servo that answers; nothing is written to it."""
        number = self._insisted(lambda: self._ask_number(servo_id, patience_s))
        model = None if number is None else servo_models.model_of(self.name, number)
        if model is None:
            name = "-" if number is None else f"model {number}"
            return Found(servo_id, name, None, None, None, None, None, (f"unknown {name}",))
        layout, values = model.layout, dict[str, int]()
        for names in (_SCAN, (TORQUE,), ("errors",), ("min_voltage",), ("max_voltage",)):
            ask = partial(self.ask, servo_id, *layout.span(names), patience_s)
            data = self._insisted(ask)
            values |= {} if data is None else layout.decode(names, data)
        return found_servo(servo_id, model, values)

    def servo(self, servo_id: int) -> BusServo:
        """Model and scale of a servo, which must control its position."""
        model = self._model(servo_id)
        modes = model.layout.position_modes
        mode = self._value(servo_id, "operating_mode") if modes else None
        if mode is not None and mode not in modes:
            known = ", ".join(f"{number} ({what})" for number, what in modes.items())
            raise InputError(f"servo {servo_id}", "operating mode", f"{mode}", known)
        scale = self._scale(servo_id, model, several_turns=mode in model.layout.multi_turn_modes)
        return BusServo(servo_id, model.name, scale, quantities(model))

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Settings of a servo: registers by name, and its gains in the manual's units."""
        model = self._model(servo_id)
        registers = {name: self._value(servo_id, name) for name in model.layout.settings}
        gains = {name: registers[name] / divisor for name, divisor in model.gains.items()}
        settings = {"model": model.name, "baud": self._baud, "registers": registers}
        return settings | ({"gains": gains} if gains else {})

    def saved(self, servo_id: int) -> dict[str, int]:
        """Values that ``begin`` changes and ``restore`` restores, as they are now."""
        layout = self._model(servo_id).layout
        names = _restored(layout)
        block = self._agreed(servo_id, lambda: self._block(servo_id, names))
        # a Bus Watchdog that has expired reads -1, and is cleared by writing 0
        return {name: max(layout.decode(names, block)[name], 0) for name in layout.changed}

    def reading(self, servo_id: int) -> Reading:
        """Present values of a servo that must answer."""
        model = self._model(servo_id)
        start, count = model.layout.span(model.layout.reported)
        data = self._insist(servo_id, lambda: self.ask(servo_id, start, count, PATIENCE_S))
        return reading_of(model, data)

    def begin(self, goals: Mapping[int, int]) -> None:
        """Hold these set-points (ticks by identity) with the torque on, without motion profile."""
        for servo_id, ticks in goals.items():
            changed = self._model(servo_id).layout.changed
            self._must_set(servo_id, dict.fromkeys(changed, 0))
            self._must_set(servo_id, {"goal_position": ticks, TORQUE: 1})
        for servo_id in goals:  # last, as a watchdog runs from then on
            changed = self._model(servo_id).layout.changed
            self._must_set(servo_id, {name: value for name, value in changed.items() if value})

    def cycle(self, goals: Mapping[int, int], deadline: float) -> Cycle:
        """Send set-points (ticks by identity) and read every servo."""
        self.wire.drain()
        models = {servo_id: self._model(servo_id) for servo_id in goals}
        data = {k: self._goal(models[k].layout, ticks) for k, ticks in goals.items()}
        address = next(iter(models.values())).layout["goal_position"].address
        write = self._sync_write(address, data)
        begin = time.monotonic()
        sent_s = begin + self._wire_s(len(write))
        blocks: dict[int, bytes | None] = {}
        least = self.cycle_s(len(goals)) + ADAPTER_S
        until = min(begin + max(FIRST_SHARE * (deadline - begin), least), deadline)
        for after, group in self._groups(models):
            remaining = until - time.monotonic()
            limit = time.monotonic() + remaining / (after + 1)
            blocks |= self._ask_group(write, group, limit)
            write = b""
        answered_s = time.monotonic()
        goals_held = self._goals_held([k for k, block in blocks.items() if block is None], deadline)
        answered = any(block is not None for block in blocks.values())
        device_s = self.wire.device_s
        readings = (
            Reading(goal_ticks=goals_held.get(servo_id))
            if (block := blocks[servo_id]) is None
            else reading_of(models[servo_id], block)
            for servo_id in goals
        )
        return Cycle(
            sent_s=sent_s,
            readings=tuple(readings),
            round_trip_s=answered_s - begin if answered else math.nan,
            device_s=device_s if answered and device_s is not None else math.nan,
        )

    def restore(self, servo_id: int, saved: Mapping[str, int]) -> bool:
        """Switch the torque of a servo off and restore what ``begin`` changed."""
        try:
            self._model(servo_id)
        except (Stopped, InputError):
            return False
        released = self.set(servo_id, TORQUE, 0)
        return all([self.set(servo_id, name, value) for name, value in saved.items()]) and released

    def cycle_s(self, count: int) -> float:
        """Time on the wire of a cycle with so many servos."""
        model = next(iter(self._models.values()))
        _, size = model.layout.span(model.layout.reported)
        request = self._sync_read(range(count), 0, size)
        write = self._sync_write(0, dict.fromkeys(range(count), bytes(4)))
        return self._wire_s(len(write) + len(request) + count * self._status_bytes(size))

    def sample_delay_s(self, count: int) -> float:
        """Time on the wire of the request for the positions, which follows the set-points."""
        return self._wire_s(len(self._sync_read(range(count), 0, 1)))

    def ask(self, servo_id: int, address: int, count: int, within_s: float) -> bytes | None:
        """Bytes of the memory of a servo, or None; one request."""
        request = self._read(servo_id, address, count)
        return self._exchange(request, servo_id, count, within_s)

    def set(self, servo_id: int, name: str, value: int) -> bool:
        """Write a register until it reads so; returns whether it does.

        Raises:
            ValueError: If the register is kept without supply (EEPROM), where nothing is written.
        """
        layout = self._model(servo_id).layout
        register = layout[name]
        if register.address < layout.volatile_from:
            raise ValueError(f"{name} is in the EEPROM")
        write = self._write(servo_id, register.address, register.encode(value, layout.order))
        names = _restored(layout) if name in _restored(layout) else (name,)

        def confirmed() -> bytes | None:
            self._exchange(write, servo_id, 0, PATIENCE_S)
            block = self._block(servo_id, names)
            return block if block and layout.decode(names, block)[name] == value else None

        return self._insisted(confirmed) is not None

    def _block(self, servo_id: int, names: Sequence[str]) -> bytes | None:
        """The smallest block of the memory with these registers; one request."""
        return self.ask(servo_id, *self._models[servo_id].layout.span(names), PATIENCE_S)

    def _must_set(self, servo_id: int, values: Mapping[str, int]) -> None:
        for name, value in values.items():
            if not self.set(servo_id, name, value):
                raise Stopped(f"servo {servo_id} does not accept {value} as its {name}")

    def _ask_group(
        self, write: bytes, ids: Sequence[int], deadline: float
    ) -> dict[int, bytes | None]:
        """Present values of servos that are read by one instruction, after a write."""
        layout = self._models[ids[0]].layout
        start, count = layout.span(layout.reported)
        request = (
            self._sync_read(ids, start, count)
            if layout.sync_read
            else self._read(ids[0], start, count)
        )
        echoes = self._decoder().feed(request)
        expected = [self._expected(servo_id, count, echoes) for servo_id in ids]
        replies = self.wire.exchange(write + request, expected, deadline)
        return {
            servo_id: None if reply is None else self._data(reply, servo_id)
            for servo_id, reply in zip(ids, replies, strict=True)
        }

    def _goals_held(self, ids: Sequence[int], deadline: float) -> dict[int, int]:
        """Set-points in effect of servos whose answer is missing, as far as the time allows.

        Their positions are not asked for again: they would be later than those of the others.
        """
        held = {}
        for after, servo_id in zip(reversed(range(len(ids))), ids, strict=True):
            register = self._models[servo_id].layout["goal_position"]
            patience = (deadline - time.monotonic()) / (after + 1)
            if patience <= self._wire_s(3 * self._status_bytes(register.size)):
                continue
            data = self.ask(servo_id, register.address, register.size, patience)
            if data is not None:
                held[servo_id] = register.decode(data, self._models[servo_id].layout.order)
        return held

    def _groups(self, models: Mapping[int, ServoModel]) -> list[tuple[int, list[int]]]:
        """Servos that are read together, each with the number of groups after it."""
        together = [k for k, model in models.items() if model.layout.sync_read]
        groups = [together] if together else []
        groups += [[k] for k, model in models.items() if not model.layout.sync_read]
        return list(zip(reversed(range(len(groups))), groups, strict=True))

    def _exchange(self, request: bytes, servo_id: int, count: int, within_s: float) -> bytes | None:
        self.wire.drain()
        expected = [self._expected(servo_id, count, self._decoder().feed(request))]
        deadline = time.monotonic() + within_s + self._wire_s(len(request))
        (reply,) = self.wire.exchange(request, expected, deadline)
        return None if reply is None else self._data(reply, servo_id)

    def _expected(self, servo_id: int, count: int, echoes: Sequence[P]) -> Callable[[P], bool]:
        """Whether a packet is the answer with ``count`` bytes, and not the request's echo."""

        def expected(packet: P) -> bool:
            data = self._data(packet, servo_id)
            return data is not None and len(data) == count and packet not in echoes

        return expected

    def _model(self, servo_id: int) -> ServoModel:
        if servo_id not in self._models:
            number = self._agreed(servo_id, lambda: self._ask_number(servo_id, PATIENCE_S))
            model = servo_models.model_of(self.name, number)
            if model is None:
                known = "one of " + ", ".join(servo_models.names(self.name))
                raise InputError(f"servo {servo_id}", "model", f"number {number}", known)
            self._models[servo_id] = model
        return self._models[servo_id]

    def _scale(self, servo_id: int, model: ServoModel, *, several_turns: bool) -> Scale:
        low, high = (self._value(servo_id, f"{end}_position") for end in ("min", "max"))
        if several_turns or low == high:  # equal limits: several turns of a Feetech servo
            turns = TURNS * math.floor(model.ticks_per_turn)
            low, high = model.centre_ticks - turns, model.centre_ticks + turns
        return model.scale(low, high)

    def _value(self, servo_id: int, name: str) -> int:
        """A register of a servo that must answer."""
        layout = self._model(servo_id).layout
        register: Register = layout[name]
        data = self._agreed(
            servo_id, lambda: self.ask(servo_id, register.address, register.size, PATIENCE_S)
        )
        return register.decode(data, layout.order)

    def _agreed(self, servo_id: int, ask: Callable[[], T | None]) -> T:
        """The first of two successive answers that agree: a checksum of one byte may err."""
        answer = self._insist(servo_id, ask)
        for _ in range(INSISTENCE):
            again = self._insist(servo_id, ask)
            if again == answer:
                break
            answer = again
        return answer

    def _goal(self, layout: Layout, ticks: int) -> bytes:
        return layout["goal_position"].encode(ticks, layout.order)


def _restored(layout: Layout) -> tuple[str, ...]:
    """Registers that are restored, which are read in one block.

    An answer does not tell which address was read. No other block has the length of this one, so
    that no late answer to another request passes for it.
    """
    return (TORQUE, *layout.changed)
