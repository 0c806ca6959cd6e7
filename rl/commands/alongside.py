"""Run part of a command in a second process, which returns its results one by one."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self


class Alongside:
    """Runs a generator in a second process, in parallel with this one.

    A context manager: leaving the block stops the process. Iterating waits for and returns the
    values that the generator yields, in order; an exception of the generator is raised here.

    The generator must be a function of a module, its arguments and values picklable.
    """

    def __init__(self, work: Callable[..., Iterator[Any]], *arguments: Any) -> None:  # noqa: ANN401
        """Start ``work(*arguments)``."""
        spawn = multiprocessing.get_context("spawn")
        self._receiving, sending = spawn.Pipe(duplex=False)
        self._process = spawn.Process(
            target=_serve, args=(sending, work, arguments), daemon=True, name="alongside"
        )
        self._process.start()
        sending.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the process."""
        self._receiving.close()
        self._process.terminate()
        self._process.join()

    def __iter__(self) -> Self:
        """Return itself."""
        return self

    def __next__(self) -> Any:  # noqa: ANN401 - what the generator yields
        """The next value.

        Raises:
            StopIteration: After the last.
            RuntimeError: If the process died.
        """
        try:
            kind, value = self._receiving.recv()
        except EOFError:
            self._process.join()
            status = self._process.exitcode
            raise RuntimeError(f"the second process died with status {status}") from None
        if kind == "error":
            raise value
        if kind == "end":
            raise StopIteration
        return value


def _serve(sending: Connection, work: Callable[..., Iterator[Any]], arguments: Any) -> None:  # noqa: ANN401
    """Body of the second process; its progress bars are not shown."""
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - as long as the process
    try:
        for value in work(*arguments):
            sending.send(("value", value))
        sending.send(("end", None))
    except Exception as error:
        sending.send(("error", error))
