"""The servos that ship with the package, by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError, one_of
from sim2real.servo_library.entry import ServoEntry, read_entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).parent / "entries"


@dataclass(frozen=True)
class ServoLibrary(NotebookDisplay):
    """Servos of the library; ``servos["xl330_gain800"]`` is one of them.

    Attributes:
        entries: The servos, in alphabetical order.
    """

    entries: tuple[ServoEntry, ...]

    @property
    def names(self) -> list[str]:
        """Their names."""
        return [entry.name for entry in self.entries]

    def __getitem__(self, name: str) -> ServoEntry:
        """The servo with this name.

        Raises:
            InputError: If there is none; the message names the most similar one.
        """
        for entry in self.entries:
            if entry.name == name:
                return entry
        raise InputError("servos", "", repr(name), one_of(name, self.names))

    def __iter__(self) -> Iterator[ServoEntry]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def plot(self) -> Figure:
        """Stall torque and no-load speed of the servos."""
        figure: Figure = from_report("servo_table.motor_figure")(self.entries)
        return figure


def shipped() -> ServoLibrary:
    """All servos of the library.

    Raises:
        InputError: If a file lacks what an entry needs, or is not named after its servo.
    """
    entries = []
    for path in sorted(FOLDER.glob("*.json")):
        entry = read_entry(path)
        if entry.name != path.stem:
            raise InputError(path, "provenance.servo.name", repr(entry.name), f"{path.stem!r}")
        entries.append(entry)
    return ServoLibrary(tuple(entries))
