"""The buses by name; opening one, with a journal of what is changed in the servos of its port."""

import contextlib
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

from sim2real.errors import InputError, check_choice
from sim2real.hardware.lx import LxBus
from sim2real.hardware.register_bus import DynamixelBus, FeetechBus
from sim2real.hardware.transport import open_transport
from sim2real.output import write_json

Bus = LxBus | DynamixelBus | FeetechBus
BUSES: Mapping[str, type[Bus]] = {bus.name: bus for bus in (LxBus, DynamixelBus, FeetechBus)}


@dataclass(frozen=True)
class Changed:
    """A servo that a command has changed, with the values to restore, by name."""

    bus: str
    baud: int
    servo_id: int
    values: Mapping[str, int]


class Journal:
    """The journal of one port, which is locked: one command at a time uses a port.

    It is on the disk, in the user's folder for state, before the first change; a command that is
    killed leaves it behind, and the next one on the port restores the servos. ``InputError`` if
    another command uses the port.
    """

    def __init__(self, port: str) -> None:
        name = port if "://" in port else os.path.realpath(port)
        name = re.sub(r"[^\w.-]+", "_", name).strip("_")
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        if sys.platform == "win32":
            state = os.environ.get("LOCALAPPDATA", Path.home())
        self.path = Path(state) / "sim2real" / "ports" / f"{name}.json"
        self._lock: BinaryIO | None = None
        with contextlib.suppress(OSError):  # reading the servos needs no journal
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = self.path.with_suffix(".lock").open("wb")
        if self._lock is None or sys.platform == "win32":  # where a port is opened only once anyway
            return
        import fcntl

        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the process ends
        except OSError:
            self._lock.close()
            found = f"{port} in use by another command"
            raise InputError("--port", "", found, "a free port") from None

    def pending(self) -> list[Changed]:
        """Servos that are changed, or that a command which was killed has left changed."""
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            entries = json.loads(self.path.read_bytes())["servos"]
            return [Changed(**entry) for entry in entries]
        return []

    def note(self, about_to_change: Sequence[Changed]) -> list[Changed]:
        """Note servos before they are changed; as they are noted: before the first change."""
        noted = {(entry.bus, entry.servo_id): entry for entry in self.pending()}
        for entry in about_to_change:
            noted.setdefault((entry.bus, entry.servo_id), entry)
        self._replace(list(noted.values()))
        return [noted[entry.bus, entry.servo_id] for entry in about_to_change]

    def forget(self, restored: Sequence[Changed]) -> None:
        """Forget servos that are restored."""
        self._replace([entry for entry in self.pending() if entry not in restored])

    def close(self) -> None:
        """Unlock the port."""
        if self._lock is not None:
            self._lock.close()

    def _replace(self, entries: Sequence[Changed]) -> None:
        if entries:
            write_json(self.path, {"servos": [asdict(entry) for entry in entries]})
        else:
            self.path.unlink(missing_ok=True)


@dataclass(frozen=True)
class Connection:
    """An open bus, with its port and the journal of that."""

    bus: Bus
    port: str
    journal: Journal

    def note(self, ids: Iterable[int]) -> list[Changed]:
        """Note servos in the journal before they are changed, with what is to be restored."""
        bus = self.bus
        return self.journal.note([Changed(bus.name, bus.baud, k, bus.saved(k)) for k in ids])

    def release(
        self, changed: Sequence[Changed], others: Iterable[int] = (), *, attempts: int = 2
    ) -> list[int]:
        """Stop servos and restore what was changed; identities whose torque may still be on.

        Those stay in the journal. Nothing but the torque was changed in the ``others``.
        """
        values: dict[int, Mapping[str, int]] = {servo_id: {} for servo_id in others}
        values |= {entry.servo_id: entry.values for entry in changed}

        def confirmed(servo_id: int) -> bool:
            with contextlib.suppress(OSError):
                return any(self.bus.restore(servo_id, values[servo_id]) for _ in range(attempts))
            return False

        left = [servo_id for servo_id in values if not confirmed(servo_id)]
        self.journal.forget([entry for entry in changed if entry.servo_id not in left])
        return left


def bus_class(name: str) -> type[Bus]:
    """The class of a bus; ``InputError`` if there is none with this name."""
    check_choice("--bus", "", name, BUSES)
    return BUSES[name]


def ids_of(text: str, kind: type[Bus]) -> list[int]:
    """The identities in a list such as ``1,2,10-20``, all different ones of a bus."""
    try:
        ends = [part.partition("-") for part in text.split(",")]
        ids = [k for low, _, high in ends for k in range(int(low), int(high or low) + 1)]
    except ValueError:
        ids = []
    largest = kind.protocol.largest_id
    if not ids or len(set(ids)) != len(ids) or not all(0 <= k <= largest for k in ids):
        expected = f"different numbers from 0 to {largest}, as 1,2,10-20"
        raise InputError("--ids", "", text, expected)
    return ids


@contextmanager
def connection(name: str, port: str, baud: int | None = None) -> Iterator[Connection]:
    """Context manager of an open bus; what an earlier command left changed is restored first."""
    kind = bus_class(name)
    rate = kind.baud_rates[0] if baud is None else baud
    if rate <= 0:
        raise InputError("--baud", "", f"{rate}", "a rate above 0, such as 1000000")
    if advice := latency_advice(port):
        print(advice, file=sys.stderr)
    with closing(Journal(port)) as journal:
        if pending := journal.pending():
            _restore(port, pending, journal)
        with closing(kind(open_transport(port, baud=rate), rate)) as bus:
            yield Connection(bus, port, journal)


def _restore(port: str, pending: Sequence[Changed], journal: Journal) -> None:
    """Restore the servos that an earlier command left changed, and say so in one line."""
    silent = list[int]()
    for name, baud in {(entry.bus, entry.baud): None for entry in pending}:
        entries = [entry for entry in pending if (entry.bus, entry.baud) == (name, baud)]
        with closing(bus_class(name)(open_transport(port, baud=baud), baud)) as bus:
            silent += Connection(bus, port, journal).release(entries)
    listed = ", ".join(str(entry.servo_id) for entry in pending)
    outcome = "torque off, limits restored"
    if silent:
        names = ", ".join(map(str, silent))
        outcome = f"no confirmation from {names} (if they are gone, delete {journal.path})"
    print(f"{port}: servos {listed}, left on by an earlier command: {outcome}", file=sys.stderr)


def latency_advice(port: str, system: Path = Path("/sys"), *, longest_ms: int = 1) -> str | None:
    """One line if a USB adapter on Linux holds bytes back for too long, by sysfs in ``system``."""
    name = os.path.basename(os.path.realpath(port))
    folders = system / "class/tty" / name / "device", system / "bus/usb-serial/devices" / name
    for folder in () if "://" in port else folders:
        file = folder / "latency_timer"
        with contextlib.suppress(OSError, ValueError):
            value = int(file.read_text())
            if value <= longest_ms:
                return None
            return (
                f"{port}: latency timer {value} ms, expected at most {longest_ms} ms: "
                f"echo {longest_ms} | sudo tee {file}"
            )
    return None
