"""A finding about a recording: one sentence, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["note", "warning", "error"]


@dataclass(frozen=True)
class RecordingFinding:
    """A finding about a recording.

    Attributes:
        text: The finding, one sentence.
        severity: ``"note"`` if it is merely unusual; ``"warning"`` if numbers that are fitted to
            the recording may be wrong, and are shown with it; ``"error"`` if they would be wrong,
            and nothing is fitted.
        where: Of an error, the column, for the message of the exception.
        found: Of an error, what is found there.
        expected: Of an error, what is expected there.
    """

    text: str
    severity: Severity = "note"
    where: str = ""
    found: str = ""
    expected: str = ""
