"""Buses whose servos are controlled by reading and writing registers: Dynamixel and Feetech."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from sim2real.errors import InputError
from sim2real.hardware import frames
from sim2real.hardware.frames import BROADCAST, FrameDecoder, Instruction, Packet, Protocol
from sim2real.hardware.registers import LAYOUTS, TORQUE, Layout
from sim2real.hardware.servo_bus import (
    INSISTENCE,
    PATIENCE_S,
    BusServo,
    Cycle,
    Found,
    Reading,
    Scale,
    ServoBus,
    Stopped,
    T,
)
from sim2real.hardware.servo_models import ServoModel, model_of, servo_models
from sim2real.hardware.transport import Transport

FIRST_SHARE = 0.7
"""Share of a cycle's time after which an answer counts as missing."""
TURNS = 7
"""Turns to each side that are used of servos that do several."""
ADAPTER_S = 0.003
"""Longest usual time of adapter and servo besides the time on the wire."""
ALERT = 0x80
"""Bit of a Dynamixel's error number: the register of hardware errors is not 0."""
SCS_MAIN_VERSION = 5
"""First byte of the model's number in servos that have the high byte of a number first."""
_SCAN = ("present_position", "present_voltage", "present_temperature")


class RegisterBus(ServoBus):
    """A bus of servos with registers, which are set and read together.

    A write is confirmed by reading the register, so that it does not matter whether the servo
    answers to writes, and which answers are lost.

    Attributes:
        word_bytes: Bytes of an address, and of a number of bytes, in an instruction.
        answer_bytes: Bytes of an answer besides its data.
    """

    word_bytes: ClassVar[int]
    answer_bytes: ClassVar[int]

    def __init__(self, transport: Transport, baud: int | None = None) -> None:
        super().__init__(transport, baud)
        self._models: dict[int, ServoModel] = {}

    @abstractmethod
    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        """The data of an answer of this servo without an error; None for any other packet."""

    @abstractmethod
    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        """The number of the servo's model, or None if it does not answer; one request."""

    def answers(self, servo_id: int, patience_s: float) -> bool:
        """Whether a servo has this identity; one request."""
        return self._ask_number(servo_id, patience_s) is not None

    def look(self, servo_id: int, patience_s: float) -> Found:
        """The state of a servo that answers; nothing is written to it."""
        number = self._insisted(lambda: self._ask_number(servo_id, patience_s))
        model = None if number is None else model_of(self.name, number)
        if model is None:
            name = "-" if number is None else f"model {number}"
            return Found(servo_id, name, None, None, None, None, None, (f"unknown {name}",))
        layout, values = model.layout, dict[str, int]()
        for names in (_SCAN, (TORQUE,), ("errors",), ("min_voltage",), ("max_voltage",)):
            ask = partial(self.ask, servo_id, *layout.span(names), patience_s)
            data = self._insisted(ask)
            values |= {} if data is None else layout.decode(names, data)
        return model.found(servo_id, values)

    def servo(self, servo_id: int) -> BusServo:
        """Model and scale of a servo, which must control its position."""
        model = self._model(servo_id)
        modes = model.layout.position_modes
        mode = self._value(servo_id, "operating_mode") if modes else None
        if mode is not None and mode not in modes:
            known = ", ".join(f"{number} ({what})" for number, what in modes.items())
            raise InputError(f"servo {servo_id}", "operating mode", f"{mode}", known)
        scale = self._scale(servo_id, model, several_turns=mode in model.layout.multi_turn_modes)
        return BusServo(servo_id, scale, model.quantities)

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Settings of a servo: registers by name, and its gains in the manual's units."""
        model = self._model(servo_id)
        registers = {name: self._value(servo_id, name) for name in model.layout.settings}
        gains = {name: registers[name] / divisor for name, divisor in model.gains.items()}
        settings = {"model": model.name, "baud": self.baud, "registers": registers}
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
        names = model.layout.reported
        return model.reading(self._insist(servo_id, lambda: self._block(servo_id, names)))

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
        self.drain()
        layouts = {servo_id: self._model(servo_id).layout for servo_id in goals}
        registers = {servo_id: layout["goal_position"] for servo_id, layout in layouts.items()}
        data = {k: registers[k].encode(ticks, layouts[k].order) for k, ticks in goals.items()}
        write = self._sync_write(next(iter(registers.values())).address, data)
        begin = time.monotonic()
        blocks: dict[int, bytes | None] = {}
        least = self.cycle_s(len(goals)) + ADAPTER_S
        until = min(begin + max(FIRST_SHARE * (deadline - begin), least), deadline)
        together = [k for k, layout in layouts.items() if layout.sync_read]
        groups = [[k] for k in goals if k not in together]
        groups = [together, *groups] if together else groups
        request = write
        for after, group in zip(reversed(range(len(groups))), groups, strict=True):
            now = time.monotonic()
            blocks |= self._ask_group(request, group, now + (until - now) / (after + 1))
            request = b""
        answered_s = time.monotonic()
        held = self._goals_held([k for k, block in blocks.items() if block is None], deadline)
        answered = any(block is not None for block in blocks.values())
        readings = (
            Reading(goal_ticks=held.get(servo_id))
            if (block := blocks[servo_id]) is None
            else self._models[servo_id].reading(block)
            for servo_id in goals
        )
        return Cycle(
            sent_s=begin + self._wire_s(len(write)),
            readings=tuple(readings),
            round_trip_s=answered_s - begin if answered else math.nan,
            device_s=self._device_s(answered),
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
        layout = next(iter(self._models.values())).layout
        _, size = layout.span(layout.reported)
        request = self._sync_read(range(count), 0, size)
        write = self._sync_write(0, dict.fromkeys(range(count), bytes(4)))
        return self._wire_s(len(write) + len(request) + count * (size + self.answer_bytes))

    def sample_delay_s(self, count: int) -> float:
        """Time on the wire of the request for the positions, which follows the set-points."""
        return self._wire_s(len(self._sync_read(range(count), 0, 1)))

    def ask(self, servo_id: int, address: int, count: int, within_s: float) -> bytes | None:
        """Bytes of the memory of a servo, or None; one request."""
        request = self._instruction(servo_id, Instruction.READ, (address, count))
        return self._exchange(request, servo_id, count, within_s)

    def set(self, servo_id: int, name: str, value: int) -> bool:
        """Write a register until it reads so; whether it does. ``ValueError`` in the EEPROM."""
        layout = self._model(servo_id).layout
        register = layout[name]
        if register.address < layout.volatile_from:
            raise ValueError(f"{name} is in the EEPROM")
        data = register.encode(value, layout.order)
        write = self._instruction(servo_id, Instruction.WRITE, (register.address,), data)
        names = _restored(layout) if name in _restored(layout) else (name,)

        def confirmed() -> bytes | None:
            self._exchange(write, servo_id, 0, PATIENCE_S)
            block = self._block(servo_id, names)
            return block if block and layout.decode(names, block)[name] == value else None

        return self._insisted(confirmed) is not None

    def _instruction(
        self, servo_id: int, code: Instruction, words: Sequence[int], data: bytes = b""
    ) -> bytes:
        head = b"".join(word.to_bytes(self.word_bytes, "little") for word in words)
        return self.protocol.encode(Packet(servo_id, code, head + data))

    def _sync_read(self, ids: Sequence[int], address: int, count: int) -> bytes:
        words = (address, count)
        return self._instruction(BROADCAST, Instruction.SYNC_READ, words, bytes(ids))

    def _sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        words = (address, len(next(iter(data.values()))))
        blocks = b"".join(bytes((servo_id,)) + block for servo_id, block in data.items())
        return self._instruction(BROADCAST, Instruction.SYNC_WRITE, words, blocks)

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
        if layout.sync_read:
            request = self._sync_read(ids, start, count)
        else:
            request = self._instruction(ids[0], Instruction.READ, (start, count))
        return self._answers(write, request, ids, count, deadline)

    def _goals_held(self, ids: Sequence[int], deadline: float) -> dict[int, int]:
        """Set-points in effect of servos whose answer is missing, as far as the time allows.

        Their positions are not asked for again: they would be later than those of the others.
        """
        held = {}
        for after, servo_id in zip(reversed(range(len(ids))), ids, strict=True):
            layout = self._models[servo_id].layout
            register = layout["goal_position"]
            patience = (deadline - time.monotonic()) / (after + 1)
            if patience <= self._wire_s(3 * (register.size + self.answer_bytes)):
                continue
            data = self.ask(servo_id, register.address, register.size, patience)
            if data is not None:
                held[servo_id] = register.decode(data, layout.order)
        return held

    def _exchange(self, request: bytes, servo_id: int, count: int, within_s: float) -> bytes | None:
        self.drain()
        deadline = time.monotonic() + within_s + self._wire_s(len(request))
        return self._answers(b"", request, [servo_id], count, deadline)[servo_id]

    def _answers(
        self, write: bytes, request: bytes, ids: Sequence[int], count: int, deadline: float
    ) -> dict[int, bytes | None]:
        """Answers with ``count`` bytes of data; the request's own echo is none."""
        echoes = FrameDecoder(self.protocol).feed(request)

        def expected(servo_id: int) -> Callable[[Packet], bool]:
            def fits(packet: Packet) -> bool:
                data = self._data(packet, servo_id)
                return data is not None and len(data) == count and packet not in echoes

            return fits

        replies = self.transfer(write + request, [expected(k) for k in ids], deadline)
        pairs = zip(ids, replies, strict=True)
        return {k: None if reply is None else self._data(reply, k) for k, reply in pairs}

    def _model(self, servo_id: int) -> ServoModel:
        if servo_id not in self._models:
            number = self._agreed(servo_id, lambda: self._ask_number(servo_id, PATIENCE_S))
            model = model_of(self.name, number)
            if model is None:
                known = "one of " + ", ".join(model.name for model in servo_models(self.name))
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
        data = self._agreed(servo_id, lambda: self._block(servo_id, [name]))
        return layout[name].decode(data, layout.order)

    def _agreed(self, servo_id: int, ask: Callable[[], T | None]) -> T:
        """The first of two successive answers that agree: a checksum of one byte may err."""
        answer = self._insist(servo_id, ask)
        for _ in range(INSISTENCE):
            again = self._insist(servo_id, ask)
            if again == answer:
                break
            answer = again
        return answer


class DynamixelBus(RegisterBus):
    """Dynamixel servos of Protocol 2.0 (X and MX series)."""

    name: ClassVar[str] = "dynamixel"
    baud_rates: ClassVar[tuple[int, ...]] = (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000)
    protocol: ClassVar[Protocol] = frames.DYNAMIXEL
    longest_answer: ClassVar[int] = 128
    word_bytes: ClassVar[int] = 2
    answer_bytes: ClassVar[int] = 11

    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        answer = packet.code == Instruction.STATUS and packet.parameters
        if not answer or packet.servo_id != servo_id or packet.parameters[0] & ~ALERT:
            return None
        return packet.parameters[1:]

    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        ping = self._instruction(servo_id, Instruction.PING, ())
        data = self._exchange(ping, servo_id, 3, within_s)
        return None if data is None else int.from_bytes(data[:2], "little")


class FeetechBus(RegisterBus):
    """Feetech servos (STS, SMS and SCS), which may be of different series."""

    name: ClassVar[str] = "feetech"
    baud_rates: ClassVar[tuple[int, ...]] = (1_000_000, 500_000, 115_200)
    protocol: ClassVar[Protocol] = frames.FEETECH
    longest_answer: ClassVar[int] = 64
    word_bytes: ClassVar[int] = 1
    answer_bytes: ClassVar[int] = 6

    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        # the error byte tells the servo's state (voltage, load, ...); the data are valid
        return packet.parameters if packet.servo_id == servo_id else None

    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        register = LAYOUTS["sts"]["model"]  # at the same address in all series
        data = self.ask(servo_id, register.address, register.size, within_s)
        if data is None:
            return None
        return int.from_bytes(data, "big" if data[0] == SCS_MAIN_VERSION else "little")


def _restored(layout: Layout) -> tuple[str, ...]:
    """Registers that are restored, which are read in one block.

    An answer does not tell which address was read. No other block has the length of this one, so
    that no late answer to another request passes for it.
    """
    return (TORQUE, *layout.changed)
