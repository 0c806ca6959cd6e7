"""Names of recordings in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sim2real.recording import Recording


def labelled(recordings: Sequence[Recording]) -> dict[str, str]:
    """A label for each file: the recording's name, or its path where several have that name."""
    names = [recording.name for recording in recordings]
    return {r.file: r.name if names.count(r.name) == 1 else r.file for r in recordings}


def listed(labels: Iterable[str], most: int = 4) -> str:
    """Labels separated by commas; more than ``most`` are abbreviated."""
    names = list(labels)
    if len(names) > most:
        return f"{names[0]} to {names[-1]} ({len(names)} recordings)"
    return ", ".join(names)
