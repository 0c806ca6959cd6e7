"""Record of what a command has changed in the servos of a port, kept until it is restored."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

from sim2real.errors import InputError
from sim2real.output import write_json


@dataclass(frozen=True)
class Changed:
    """A servo that a command has changed, with the values to restore, by name."""

    bus: str
    baud: int
    servo_id: int
    values: Mapping[str, int]


class Journal:
    """The journal of one port, which is locked: one command at a time uses a port.

    It is on the disk before the first change; a command that is killed leaves it behind, and the
    next one on the port restores the servos. It is in the folder for state of this user:
    ``XDG_STATE_HOME``, or what the system uses instead.

    Raises:
        InputError: If another command uses the port.
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
        if self._lock is not None and not _locked(self._lock):
            self._lock.close()
            raise InputError("--port", "", f"{port} in use by another command", "a free port")

    def pending(self) -> list[Changed]:
        """Servos that are changed, or that a command which was killed has left changed."""
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            entries = json.loads(self.path.read_bytes())["servos"]
            return [Changed(e["bus"], e["baud"], e["servo_id"], e["values"]) for e in entries]
        return []

    def note(self, about_to_change: Sequence[Changed]) -> list[Changed]:
        """Note servos before they are changed; returns them as they are noted.

        Those that are noted already stay as they are: what they have now is not what they had
        before the first change.

        Raises:
            InputError: If the journal cannot be written.
        """
        noted = {(entry.bus, entry.servo_id): entry for entry in self.pending()}
        for entry in about_to_change:
            noted.setdefault((entry.bus, entry.servo_id), entry)
        self._replace(list(noted.values()))
        return [noted[entry.bus, entry.servo_id] for entry in about_to_change]

    def forget(self, restored: Sequence[Changed]) -> None:
        """Forget servos that are restored."""
        gone = {(entry.bus, entry.servo_id) for entry in restored}
        self._replace([e for e in self.pending() if (e.bus, e.servo_id) not in gone])

    def close(self) -> None:
        """Unlock the port."""
        if self._lock is not None:
            self._lock.close()

    def _replace(self, entries: Sequence[Changed]) -> None:
        if entries:
            write_json(self.path, {"servos": [asdict(entry) for entry in entries]})
        else:
            self.path.unlink(missing_ok=True)


def _locked(file: BinaryIO) -> bool:
    """Whether the file could be locked; a killed process loses its lock."""
    try:
        import fcntl
    except ModuleNotFoundError:  # Windows, where a port is opened only once anyway
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
