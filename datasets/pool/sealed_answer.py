"""Answer a sealed set of swims with all devices and cores, from the fluid to the last case.

    python datasets/pool/sealed_answer.py SET OUT [--devices cuda:0,cuda:1] [--processes N]

The steps that the README of this folder lists, in its order: robots on every device at once,
held-out swims in the fluid while cases are answered. Fills ``OUT`` with ``water``, ``heldout``,
``verdicts`` and ``again``; grade with ``datasets/sealed/grade.py``. A stopped run is continued.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
AT_ONCE = 4
"""Robots on one device: while one is prepared another swims."""


def run(script: str, *arguments: object, check: bool = True) -> None:
    """Run one script of this folder; what it prints passes through.

    Raises:
        subprocess.CalledProcessError: If it fails, with ``check``.
    """
    subprocess.run([sys.executable, HERE / script, *map(str, arguments)], check=check)


def everywhere(devices: list[str], robots: list[str], *arguments: object) -> None:
    """``sealed_water.py`` for every robot, several on each device at once."""
    with ThreadPoolExecutor(AT_ONCE * len(devices)) as pool:
        jobs = [
            pool.submit(
                run, "sealed_water.py", *arguments, "--only", robot,
                "--device", devices[k % len(devices)],
            )
            for k, robot in enumerate(robots)
        ]  # fmt: skip
        for job in jobs:
            job.result()


def main() -> None:
    """Answer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--devices", default="cpu", help="with commas between")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--cell-m", type=float, help="of the water, for a trial")
    options = parser.parse_args()
    devices, start = options.devices.split(","), time.perf_counter()
    robots = [path.name for path in sorted((options.set / "inputs").glob("robot_*"))]
    water, heldout, verdicts, again = (
        options.out / name for name in ("water", "heldout", "verdicts", "again")
    )
    cells = ("--cell-m", options.cell_m) if options.cell_m else ()

    def done(what: str) -> None:
        print(f"{what}: {time.perf_counter() - start:.0f} s since the start", flush=True)

    everywhere(devices, robots, options.set, water, *cells)
    done("commands simulated in the fluid")
    background = ThreadPoolExecutor(1)
    kept = background.submit(
        everywhere, devices, robots, options.set, water, "--heldout", heldout, *cells
    )
    with ThreadPoolExecutor(options.processes) as pool:
        laws = [
            pool.submit(run, "sealed_water.py", options.set, water, "--law", "--only", robot)
            for robot in robots
        ]
        for law in laws:
            law.result()
    solve = (options.set, verdicts, "--water", water, "--processes", options.processes)
    run("sealed_solve.py", *solve, check=False)  # a case that fails stays unanswered
    done("answered")
    kept.result()
    done("held-out swims simulated in the fluid")
    found = ("--again", verdicts, again, "--heldout", heldout)
    everywhere(devices, robots, options.set, water, *found, *cells)
    run("sealed_solve.py", *solve, "--again", again, check=False)
    done("answered again with the effects that were found")


if __name__ == "__main__":
    main()
