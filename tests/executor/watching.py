"""Look at running jobs from outside, and kill them in the middle."""

import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from random_walk import walk

from sim2real.executor import Job

RELEASED = "released"


def walks(folder, *, steps, count=4, held=()):
    """A sweep over seeds; the walks of the seeds ``held`` stay at step 30, see ``release``."""
    jobs = []
    for seed in range(count):
        options = {"seed": seed, "steps": steps, "pause_s": 0.1}
        if seed in held:
            options["held_until"] = str(folder / RELEASED)
        jobs.append(Job(f"seed{seed}", "random_walk:walk", options, folder / str(seed)))
    return jobs


def uninterrupted(folder, **given):
    """Results of the same sweep, walked in this process at one go."""
    for job in walks(folder, **given):
        job.folder.mkdir(parents=True)
        walk(job.folder, **job.options | {"pause_s": 0.0})
    return results(folder)


def release(folder):
    """Let the walks in ``folder`` that are held go on."""
    (folder / RELEASED).touch()


def wait_for(what, patience_s=100.0):
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


def process_of(folder):
    """The process at work in a run folder."""
    return int((folder / "lock").read_text().split()[0])


def status_of(process):
    """State and parent of a process, as the kernel tells them."""
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[:2]


def parent_of(process):
    return int(status_of(process)[1])


def is_alive(process):
    try:
        return status_of(process)[0] != "Z"
    except FileNotFoundError:
        return False


def reached(folder, step):
    """Whether the walk in ``folder`` has come as far as ``step``."""
    return bool(json.loads((folder / "walk.json").read_text())["step"] >= step)


def in_background(act):
    pool = ThreadPoolExecutor(1)
    future = pool.submit(act)
    pool.shutdown(wait=False)
    return future


def kill_in_the_middle(folder, whom=int):
    """Once the walk in ``folder`` is on its way, SIGKILL its process, or ``whom`` it leads to."""

    def act():
        wait_for(lambda: reached(folder, 30))
        process = process_of(folder)
        os.kill(whom(process), signal.SIGKILL)
        return process

    return in_background(act)


def results(folder):
    return [json.loads(path.read_text()) for path in sorted(folder.glob("*/result.json"))]


def starts(folder):
    """The steps from which the processes of a walk went on."""
    return [int(line) for line in (folder / "starts.txt").read_text().split()]
