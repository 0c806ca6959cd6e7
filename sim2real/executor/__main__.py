"""``python -m sim2real.executor FOLDER``: the process of one job, as ``Job.start`` starts it.

It ends, with everything started here, when standard input is closed. Exit status: 0 if the job is
done, 2 for wrong input, 1 if it raised an exception.
"""

import fcntl
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim2real.errors import InputError
from sim2real.executor.job import read_job

PATIENCE_S = 30.0  # to wait for an earlier process to release the folder


def main(folder: Path) -> int:
    """Run the job of a folder, unless it is done."""
    _end_with_parent()
    try:
        job = read_job(folder)
        with locked(folder):
            if not job.is_done():
                job.begin()
                name, _, function = job.function.partition(":")
                work = getattr(importlib.import_module(name), function, None)
                if not callable(work):
                    found = f"no {function} in {name}"
                    raise InputError(job.name, "function", found, "a function")
                work(folder, **job.options)
                job.end()
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock the folder, or ``InputError`` after ``PATIENCE_S``; ``lock`` names the process."""
    with (folder / "lock").open("a+") as lock:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    lock.seek(0)
                    held = f"in use by process {lock.read()}"
                    raise InputError(folder, "", held, "no process") from None
                time.sleep(0.1)
        lock.truncate(0)
        lock.write(f"{os.getpid()} on {os.uname().nodename}")
        lock.flush()
        yield


def _end_with_parent() -> None:
    """Kill this process group when the parent closes standard input or has ended."""
    lifeline = os.dup(0)  # a descriptor that no process started by the job inherits
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
