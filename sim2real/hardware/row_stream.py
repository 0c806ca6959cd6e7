"""Incremental writing of a recording: the sidecar first, then row by row."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from sim2real.errors import InputError
from sim2real.hardware.servo_bus import Stopped
from sim2real.output import check_writable, is_stream, write_json

FEWEST_ROWS = 2  # of a valid recording


class RowStream:
    """``NAME.csv`` and ``NAME.json``, valid on disk after every row from the second on.

    Files of a recording with fewer rows are removed.

    Args:
        path: The CSV file.
        columns: Its header.
        sidecar: Content of the JSON file.

    Raises:
        InputError: If the folder cannot be written.
    """

    def __init__(self, path: Path, columns: Sequence[str], sidecar: dict[str, Any]) -> None:
        self._path = check_writable(path)
        if is_stream(path):
            raise InputError(path, "", "a device or a pipe", "a file, to write row by row")
        self._sidecar = sidecar
        self.rows = 0
        write_json(path.with_suffix(".json"), sidecar)
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(columns)

    def write(self, row: Sequence[float]) -> None:
        """Append one row and flush it; NaN is written as an empty cell.

        Raises:
            Stopped: If it cannot be written.
        """
        try:
            self._writer.writerow("" if math.isnan(x) else f"{x:.6f}" for x in row)
            self._file.flush()
        except OSError as error:
            raise Stopped(f"{self._path} can't be written ({error.strerror})") from None
        self.rows += 1

    def add(self, **fields: object) -> None:
        """Add fields to the sidecar."""
        self._sidecar |= fields

    def __enter__(self) -> RowStream:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        if self.rows < FEWEST_ROWS:
            self._path.unlink()
            self._path.with_suffix(".json").unlink()
        else:
            write_json(self._path.with_suffix(".json"), self._sidecar)
