"""Simulate the commands of a sealed set in the library's fluid: ``sim.inference.in_water``.

    python datasets/pool/sealed_water.py SET WATER [--device cuda:0] [--heldout HELD_OUT]
    python datasets/pool/sealed_water.py SET WATER --law
    python datasets/pool/sealed_water.py SET WATER --again VERDICTS AGAIN [--heldout HELD_OUT]

Uses robots, bench models and commands, no measurements. Existing files are kept. ``--heldout``:
also the held-out swims, in a folder of their own, for the grader. ``--again``: with the effects
that were found in each case, of those that the fluid can simulate.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from sim.inference.in_water import (
    CELL_M,
    key,
    read_water_swims,
    simulate_again,
    simulate_in_water,
    with_nearest_law,
    write_water,
)
from sim.inference.swims import swim_of
from sim2real.model import read_model
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot


def again(options: argparse.Namespace, folder: Path, robot: Robot) -> None:
    """Simulate the swims of a robot's cases with the effects that were found in each."""
    verdicts, target = options.again
    out = target / f"{folder.name}.npz"
    start, models, swims = time.perf_counter(), [], []
    for case in sorted(path.parent for path in folder.glob("case_*/case.json")):
        there = verdicts / case.name / "resimulated.json"
        held = [options.set / "heldout" / case.name / "b.csv"] if options.heldout else []
        for path in [case / "a.csv", *held] if there.exists() else []:
            models.append(read_model(there))
            swims.append(swim_of(read_recording(path), robot))
    if not swims or out.exists():
        return
    folders = [options.water, *([options.heldout] if options.heldout else [])]
    water = read_water_swims(*(place / out.name for place in folders))
    made = simulate_again(robot, models, swims, water, cell_m=options.cell_m, device=options.device)
    write_water(out, made)
    print(f"{folder.name}: {len(swims)} again, {time.perf_counter() - start:.0f} s", flush=True)


def main() -> None:
    """Simulate and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("water", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cell-m", type=float, default=CELL_M)
    parser.add_argument("--heldout", type=Path)
    parser.add_argument("--law", action="store_true", help="fit the twin's law to existing files")
    parser.add_argument("--most", type=int, help="swims of a robot and part, for a trial")
    parser.add_argument(
        "--share", default="0/1", metavar="K/N", help="every Nth robot from the Kth"
    )
    parser.add_argument("--only", default="robot_*", help="robots by name")
    parser.add_argument("--again", type=Path, nargs=2, metavar=("VERDICTS", "AGAIN"))
    options = parser.parse_args()
    first, step = (int(x) for x in options.share.split("/"))
    for folder in sorted((options.set / "inputs").glob(options.only))[first::step]:
        out = options.water / f"{folder.name}.npz"
        start = time.perf_counter()
        robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
        if options.again:
            again(options, folder, robot)
            continue
        if options.law:
            known = read_water_swims(out)
            if not known.law:
                write_water(out, with_nearest_law(robot, model, known, threads=1))
                print(f"{folder.name}: law, {time.perf_counter() - start:.0f} s", flush=True)
            continue
        cases = sorted(path.parent.name for path in folder.glob("case_*/case.json"))
        paths = {options.water: [*sorted(folder.glob("ref_*.csv")),
                                 *(folder / name / "a.csv" for name in cases)]}  # fmt: skip
        if options.heldout:
            paths[options.heldout] = [options.set / "heldout" / name / "b.csv" for name in cases]
        parts = {
            target: [swim_of(read_recording(path), robot) for path in part[: options.most]]
            for target, part in paths.items()
            if not (target / out.name).exists()
        }
        swims = [swim for part in parts.values() for swim in part]
        if not swims:
            continue
        water = simulate_in_water(robot, model, swims, cell_m=options.cell_m, device=options.device)
        for target, part in parts.items():
            own = {key(swim): water.steps[key(swim)] for swim in part}
            write_water(target / out.name, replace(water, steps=own))
        print(f"{folder.name}: {len(swims)} swims, {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
