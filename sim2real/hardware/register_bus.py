"""Buses whose servos are controlled by reading and writing registers: Dynamixel and Feetech."""

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from sim2real.errors import InputError
from sim2real.hardware import frames
from sim2real.hardware.frames import BROADCAST, FrameDecoder, Instruction, Packet, Protocol
from sim2real.hardware.registers import LAYOUTS, TORQUE, Layout, ServoModel, model_of, servo_models
from sim2real.hardware.servo_bus import (
    INSISTENCE,
    PATIENCE_S,
    BusServo,
    Cycle,
    Found,
    Reading,
    ServoBus,
    Stopped,
    T,
)
from sim2real.hardware.transport import Transport

TURNS = 7
"""Turns to each side that are used of servos that do several."""
ALERT = 0x80
"""Bit of a Dynamixel's error number: the register of hardware errors is not 0."""
_SCAN = ("present_position", "present_voltage", "present_temperature")


class RegisterBus(ServoBus):
    """A bus of servos with registers, which are set and read together.

    A write is confirmed by reading the register, so that it does not matter whether the servo
    answers to writes, and which answers are lost.
    """

    layout: ClassVar[Layout]
    word_bytes: ClassVar[int]  # bytes of an address, and of a number of bytes, in an instruction
    answer_bytes: ClassVar[int]  # bytes of an answer besides its data

    def __init__(self, transport: Transport, baud: int | None = None) -> None:
        super().__init__(transport, baud)
        self._models: dict[int, ServoModel] = {}

    @abstractmethod
    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        """The data of an answer of this servo without an error; None for any other packet."""

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
        values = dict[str, int]()
        for names in (_SCAN, (TORQUE,), ("errors",), ("min_voltage",), ("max_voltage",)):
            data = self._insisted(partial(self._block, servo_id, names, patience_s))
            values |= {} if data is None else self.layout.decode(names, data)
        bits, low = values.get("errors", 0), values.get("min_voltage", 0)
        high, tenths = values.get("max_voltage", math.inf), values.get("present_voltage")
        errors = [what for bit, what in self.layout.errors.items() if bits >> bit & 1]
        if tenths is not None and not low <= tenths <= high:
            errors.append(f"supply outside {low / 10:.1f} to {high / 10:.1f} V")
        ticks = values.get("present_position")
        return Found(
            servo_id,
            model=model.name,
            ticks=ticks,
            angle_rad=None if ticks is None else model.servo(servo_id).angle(ticks),
            supply_V=None if tenths is None else tenths / 10,
            temperature_C=values.get("present_temperature"),
            powered=None if TORQUE not in values else values[TORQUE] != 0,
            errors=tuple(errors),
        )

    def servo(self, servo_id: int) -> BusServo:
        """Model and scale of a servo, which must control its position."""
        model = self._model(servo_id)
        modes, mode = self.layout.position_modes, self._value(servo_id, "operating_mode")
        if mode not in modes:
            known = ", ".join(f"{number} ({what})" for number, what in modes.items())
            raise InputError(f"servo {servo_id}", "operating mode", f"{mode}", known)
        low, high = (self._value(servo_id, f"{end}_position") for end in ("min", "max"))
        # equal limits: several turns of a Feetech servo
        if mode in self.layout.multi_turn_modes or low == high:
            turns = TURNS * math.floor(model.ticks_per_turn)
            low, high = model.centre_ticks - turns, model.centre_ticks + turns
        return model.servo(servo_id, low, high)

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Settings of a servo: registers by name, and its gains in the manual's units."""
        model = self._model(servo_id)
        registers = {name: self._value(servo_id, name) for name in self.layout.settings}
        gains = {name: registers[name] / divisor for name, divisor in model.gains.items()}
        settings = {"model": model.name, "baud": self.baud, "registers": registers}
        return settings | ({"gains": gains} if gains else {})

    def saved(self, servo_id: int) -> dict[str, int]:
        """Values that ``begin`` changes and ``restore`` restores, as they are now."""
        self._model(servo_id)
        block = self._agreed(servo_id, lambda: self._block(servo_id, self._restored))
        # a Bus Watchdog that has expired reads -1, and is cleared by writing 0
        values = self.layout.decode(self._restored, block)
        return {name: max(values[name], 0) for name in self.layout.changed}

    def reading(self, servo_id: int) -> Reading:
        """Present values of a servo that must answer."""
        ask = partial(self._block, servo_id, self.layout.reported)
        return self._model(servo_id).reading(self._insist(servo_id, ask))

    def begin(self, goals: Mapping[int, int]) -> None:
        """Hold these set-points (ticks by identity) with the torque on, without motion profile."""
        changed = self.layout.changed
        for servo_id, ticks in goals.items():
            values = dict.fromkeys(changed, 0) | {"goal_position": ticks, TORQUE: 1}
            self._must_set(servo_id, values)
        for servo_id in goals:  # last, as a watchdog runs from then on
            self._must_set(servo_id, {name: value for name, value in changed.items() if value})

    def cycle(self, goals: Mapping[int, int], deadline: float) -> Cycle:
        """Send set-points (ticks by identity) and read every servo."""
        self.drain()
        goal, ids = self.layout["goal_position"], list(goals)
        data = {servo_id: goal.encode(ticks) for servo_id, ticks in goals.items()}
        write = self._sync_write(goal.address, data)
        begin = time.monotonic()
        start, count = self.layout.span(self.layout.reported)
        request = self._sync_read(ids, start, count)
        blocks = self._answers(write, request, ids, count, deadline)
        answered_s = time.monotonic()
        answered = any(block is not None for block in blocks.values())
        readings = (
            Reading() if block is None else self._model(k).reading(block)
            for k, block in blocks.items()
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
        _, size = self.layout.span(self.layout.reported)
        request = self._sync_read(range(count), 0, size)
        write = self._sync_write(0, dict.fromkeys(range(count), bytes(4)))
        return self._wire_s(len(write) + len(request) + count * (size + self.answer_bytes))

    def sample_delay_s(self, count: int) -> float:
        """Time on the wire of the request for the positions, which follows the set-points."""
        return self._wire_s(len(self._sync_read(range(count), 0, 1)))

    def set(self, servo_id: int, name: str, value: int) -> bool:
        """Write a register until it reads so; whether it does. ``ValueError`` in the EEPROM."""
        self._model(servo_id)
        register = self.layout[name]
        if register.address < self.layout.volatile_from:
            raise ValueError(f"{name} is in the EEPROM")
        data = register.encode(value)
        write = self._instruction(servo_id, Instruction.WRITE, (register.address,), data)
        names = self._restored if name in self._restored else (name,)

        def confirmed() -> bytes | None:
            self._exchange(write, servo_id, 0, PATIENCE_S)
            block = self._block(servo_id, names)
            return block if block and self.layout.decode(names, block)[name] == value else None

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

    def _block(
        self, servo_id: int, names: Sequence[str], within_s: float = PATIENCE_S
    ) -> bytes | None:
        """The smallest block of the memory with these registers; one request."""
        start, count = self.layout.span(names)
        request = self._instruction(servo_id, Instruction.READ, (start, count))
        return self._exchange(request, servo_id, count, within_s)

    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        """The number of the servo's model, or None if it does not answer; one request."""
        data = self._block(servo_id, ["model"], within_s)
        return None if data is None else self.layout["model"].decode(data)

    @property
    def _restored(self) -> tuple[str, ...]:
        """Registers that are restored, which are read in one block.

        An answer does not tell which address was read. No other block has the length of this one,
        so that no late answer to another request passes for it.
        """
        return (TORQUE, *self.layout.changed)

    def _must_set(self, servo_id: int, values: Mapping[str, int]) -> None:
        for name, value in values.items():
            if not self.set(servo_id, name, value):
                raise Stopped(f"servo {servo_id} does not accept {value} as its {name}")

    def _exchange(self, request: bytes, servo_id: int, count: int, within_s: float) -> bytes | None:
        self.drain()
        deadline = time.monotonic() + within_s + self._wire_s(len(request))
        return self._answers(b"", request, [servo_id], count, deadline)[servo_id]

    def _answers(
        self, write: bytes, request: bytes, ids: Sequence[int], count: int, deadline: float
    ) -> dict[int, bytes | None]:
        """Answers with ``count`` bytes of data; the request's own echo is none."""
        echoes = FrameDecoder(self.protocol).feed(request)

        def fits(servo_id: int, packet: Packet) -> bool:
            data = self._data(packet, servo_id)
            return data is not None and len(data) == count and packet not in echoes

        replies = self.transfer(write + request, [partial(fits, k) for k in ids], deadline)
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

    def _value(self, servo_id: int, name: str) -> int:
        """A register of a servo that must answer."""
        data = self._agreed(servo_id, lambda: self._block(servo_id, [name]))
        return self.layout[name].decode(data)

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
    layout: ClassVar[Layout] = LAYOUTS["dynamixel"]
    longest_answer: ClassVar[int] = 128
    word_bytes: ClassVar[int] = 2
    answer_bytes: ClassVar[int] = 11

    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        answer = packet.code == Instruction.STATUS and packet.parameters
        if not answer or packet.servo_id != servo_id or packet.parameters[0] & ~ALERT:
            return None
        return packet.parameters[1:]


class FeetechBus(RegisterBus):
    """Feetech servos of the STS and SMS series."""

    name: ClassVar[str] = "feetech"
    baud_rates: ClassVar[tuple[int, ...]] = (1_000_000, 500_000, 115_200)
    protocol: ClassVar[Protocol] = frames.FEETECH
    layout: ClassVar[Layout] = LAYOUTS["feetech"]
    longest_answer: ClassVar[int] = 64
    word_bytes: ClassVar[int] = 1
    answer_bytes: ClassVar[int] = 6

    def _data(self, packet: Packet, servo_id: int) -> bytes | None:
        # the error byte tells the servo's state (voltage, load, ...); the data are valid
        return packet.parameters if packet.servo_id == servo_id else None
