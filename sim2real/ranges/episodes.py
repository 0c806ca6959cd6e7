"""What recordings are called in a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sim2real.recording import Recording


def labelled(recordings: Sequence[Recording]) -> dict[str, str]:
    """A label for each file: the recording's name, or its path where several have that name."""
    names = [recording.name for recording in recordings]
    return {r.file: r.name if names.count(r.name) == 1 else r.file for r in recordings}


def listed(labels: Iterable[str], most: int = 4) -> str:
    """Labels one after the other; many are counted."""
    every = list(labels)
    if len(every) > most:
        return f"{every[0]} to {every[-1]} ({len(every)} recordings)"
    return ", ".join(every)
