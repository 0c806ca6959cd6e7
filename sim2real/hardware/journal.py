"""Record of what a command has changed in the servos of a port, kept until it is restored."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedRandom
from pathlib import Path
from typing import Any

from sim2real.errors import InputError


@dataclass(frozen=True)
class Changed:
    """Servos that a command has changed.

    Attributes:
        bus: Name of the bus.
        baud: Bits per second.
        servos: For each identity the values to restore, by name.
    """

    bus: str
    baud: int
    servos: Mapping[int, Mapping[str, int]]


def state_folder() -> Path:
    """Folder for state of this user: ``XDG_STATE_HOME``, or what the system uses instead."""
    if given := os.environ.get("XDG_STATE_HOME"):
        return Path(given) / "sim2real"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "sim2real"
    return Path.home() / ".local" / "state" / "sim2real"


class Journal:
    """The journal of one port, which is locked: one command at a time uses a port.

    It is written, and forced to the disk, before the first change; a command that is killed leaves
    it behind, and the next one on the port restores the servos.

    Args:
        port: The port, as given to ``--port``.

    Raises:
        InputError: If another command uses the port.
    """

    def __init__(self, port: str) -> None:
        name = port if "://" in port else os.path.realpath(port)
        self.path = state_folder() / "ports" / (re.sub(r"[^\w.-]+", "_", name).strip("_") + ".json")
        self._file = self._opened()
        if self._file is not None and not _locked(self._file):
            self._file.close()
            raise InputError("--port", "", f"{port} in use by another command", "a free port")

    def pending(self) -> Changed | None:
        """What a command that was killed has left changed, or None."""
        if self._file is None:
            return None
        self._file.seek(0)
        with contextlib.suppress(ValueError, KeyError, TypeError):
            content = json.loads(self._file.read())
            servos = {int(k): dict(values) for k, values in content["servos"].items()}
            return Changed(content["bus"], content["baud"], servos) if servos else None
        return None  # empty, or cut off before anything was changed

    def write(self, changed: Changed) -> None:
        """Note what is about to be changed.

        Raises:
            InputError: If it cannot be written.
        """
        content: dict[str, Any] = {
            "bus": changed.bus,
            "baud": changed.baud,
            "servos": {str(k): dict(values) for k, values in changed.servos.items()},
        }
        self._replace(json.dumps(content).encode())

    def clear(self) -> None:
        """Forget the changes, which are restored."""
        if self._file is not None:
            self._replace(b"")

    def close(self) -> None:
        """Unlock the port."""
        if self._file is not None:
            self._file.close()

    def _replace(self, content: bytes) -> None:
        if self._file is None:
            raise InputError(self.path, "", "a folder that can't be written", "one that can")
        self._file.seek(0)
        self._file.truncate()
        self._file.write(content)
        self._file.flush()
        os.fsync(self._file.fileno())

    def _opened(self) -> BufferedRandom | None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.touch()
            return self.path.open("r+b")
        except OSError:
            return None  # reading the servos needs no journal


def _locked(file: BufferedRandom) -> bool:
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
