"""Look at running jobs from outside, and kill them in the middle."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Collection
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from sim2real.executor import Job

RELEASED = "released"


def walks(folder: Path, *, steps: int, count: int = 4, held: Collection[int] = ()) -> list[Job]:
    """A sweep over seeds; the walks of the seeds ``held`` stay at step 30, see ``release``."""

    def options(seed: int) -> dict[str, Any]:
        found = {"seed": seed, "steps": steps, "pause_s": 0.1}
        return found | ({"held_until": str(folder / RELEASED)} if seed in held else {})

    return [
        Job(f"seed{seed}", "random_walk:walk", options(seed), folder / str(seed))
        for seed in range(count)
    ]


def release(folder: Path) -> None:
    """Let the walks in ``folder`` that are held go on."""
    (folder / RELEASED).touch()


def wait_for(what: Callable[[], Any], patience_s: float = 100.0) -> Any:
    """The first true answer of ``what``."""
    last = time.monotonic() + patience_s
    while time.monotonic() < last:
        try:
            if answer := what():
                return answer
        except (FileNotFoundError, ValueError):
            pass
        time.sleep(0.01)
    raise TimeoutError("it did not happen")


def process_of(folder: Path) -> int:
    """The process at work in a run folder."""
    return int((folder / "lock").read_text().split()[0])


def parent_of(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def reached(folder: Path, step: int) -> bool:
    """Whether the walk in ``folder`` has come as far as ``step``."""
    return bool(json.loads((folder / "walk.json").read_text())["step"] >= step)


def in_background(act: Callable[[], Any]) -> Future[Any]:
    pool = ThreadPoolExecutor(1)
    future = pool.submit(act)
    pool.shutdown(wait=False)
    return future


def kill_in_the_middle(folder: Path, whom: Callable[[int], int] = int) -> Future[Any]:
    """Once the walk in ``folder`` is on its way, SIGKILL its process, or ``whom`` it leads to."""

    def act() -> int:
        wait_for(lambda: reached(folder, 30))
        process = process_of(folder)
        os.kill(whom(process), signal.SIGKILL)
        return process

    return in_background(act)


def results(folder: Path) -> list[Any]:
    return [json.loads(path.read_text()) for path in sorted(folder.glob("*/result.json"))]


def starts(folder: Path) -> list[int]:
    """The steps from which the processes of a walk went on."""
    return [int(line) for line in (folder / "starts.txt").read_text().split()]
