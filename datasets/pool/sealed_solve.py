"""Let ``sim2real diagnose`` answer every case of a sealed set of swims, from its inputs alone.

    python datasets/pool/sealed_solve.py SET VERDICTS [--processes N] [--water WATER]
    python datasets/pool/sealed_solve.py SET VERDICTS --water WATER --again AGAIN

What a robot's swims in which nothing is missing say of its law is worked out once and kept. Each
case's time stands in ``cost.json``; one that has been answered is not answered again, but with
``--again`` where the fluid has swum with what was found (``sealed_water.py --again``).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from sim.inference.diagnose_swims import diagnosis_of, likely_model
from sim.inference.in_water import (
    by_twin_in_water,
    read_water_swims,
    robot_in_water,
    with_fluid_effects,
)
from sim.inference.law_error import FILE, IN_WATER, LawError, read_law_error
from sim.inference.searched import learned, raw, searched
from sim.inference.swims import swim_of
from sim.inference.twin_search import SwimPrior
from sim2real.body import values
from sim2real.diagnose.result import write_diagnosis
from sim2real.model import read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

BESIDE = "beside.json"
"""With what was found, the fluid swims again."""


def law_of(folder: Path, verdicts: Path, water: Path | None) -> str:
    """What the swims of a robot in which nothing is missing say, kept beside the verdicts."""
    target = verdicts / f"{folder.name}.npz"
    if target.exists():
        return f"{folder.name} known"
    start = time.perf_counter()
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    files = [water / f"{folder.name}.npz"] if water else []
    model, simulate = robot_in_water(robot, model, files, threads=1)
    references = [swim_of(read_recording(p), robot) for p in sorted(folder.glob("ref_*.csv"))]
    belief = learned(references, model, robot, simulate, known_of(water))
    verdicts.mkdir(parents=True, exist_ok=True)
    np.savez(target, **vars(belief))
    return f"{folder.name} learned, {time.perf_counter() - start:.0f} s"


def known_of(water: Path | None) -> LawError:
    """The error of the twin, alone or put right by the fluid."""
    return read_law_error(IN_WATER if water else FILE)


def answer(folder: Path, verdicts: Path, water: Path | None, again: Path | None) -> str:
    """Diagnose one case, or diagnose it again beside what the fluid swam with what was found."""
    start, before = time.perf_counter(), time.process_time()
    place, target = folder.parent, verdicts / folder.name
    robot, model = read_robot(place / "robot.toml"), read_model(place / "model.json")
    files = [water / f"{place.name}.npz"] if water else []
    model, simulate = robot_in_water(robot, model, files, threads=1)
    known = known_of(water)
    referred = json.loads((folder / "case.json").read_text())["references"]
    belief = learned([], model, robot, simulate, known)
    if referred:
        kept = np.load(verdicts / f"{place.name}.npz")
        belief = SwimPrior(**{name: kept[name] for name in kept.files})
    begun = None
    if again:
        begun = read_model(target / BESIDE)
        other = read_water_swims(again / f"{place.name}.npz")
        simulate = by_twin_in_water(robot, begun, other, threads=1)
    swims = [swim_of(read_recording(path), robot) for path in sorted(folder.glob("*.csv"))]
    found = searched(swims, model, robot, simulate, belief, simulated=begun)
    said = diagnosis_of(found, robot, known, referred=referred)
    target.mkdir(parents=True, exist_ok=True)
    write_diagnosis(said, target / "diagnosis.json", "enriched.json")
    assert said.baseline is not None
    if not again:
        write_model(said.baseline, target / "baseline.json")
        there = with_fluid_effects(model, likely_model(found, known, referred=referred))
        if values(there):
            write_model(there, target / BESIDE)
    offered = said.model if values(said.model) else read_model(target / "baseline.json")
    write_model(offered, target / "enriched.json")
    for k, members in enumerate(found.held):
        fit = next(one.fit for one in found.found if one.members == members)
        write_model(found.problem.coordinates.model_at(fit.x), target / f"tried_{k}.json")
    (target / "raw.json").write_text(json.dumps(raw(found, referred=referred)) + "\n")
    cost = {"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - before}
    if again:
        first = json.loads((target / "cost.json").read_text())
        cost = {name: value + first[name] for name, value in cost.items()} | {"again": True}
    (target / "cost.json").write_text(json.dumps(cost) + "\n")
    return f"{folder.name} {said.verdict}, {cost['wall_s']:.0f} s"


def left(folder: Path, verdicts: Path, again: Path | None) -> bool:
    """Whether a case is still to be answered."""
    cost = verdicts / folder.name / "cost.json"
    if not again:
        return not cost.exists()
    return (cost.parent / BESIDE).exists() and "again" not in json.loads(cost.read_text())


def mixed(path: Path) -> int:
    """An order in which robots take turns: what is stopped has seen a part of each."""
    return (37 * int(path.parent.name.removeprefix("case_"))) % 1009


def main() -> None:
    """Answer the cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("verdicts", type=Path)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    parser.add_argument("--water", type=Path, help="what the fluid swam: sealed_water.py")
    parser.add_argument("--again", type=Path, help="what it swam with what was found")
    parser.add_argument("--share", default="0/1", metavar="K/N", help="every Nth case from the Kth")
    options = parser.parse_args()
    deadline = time.monotonic() + options.seconds
    first, step = (int(x) for x in options.share.split("/"))
    robots = sorted((options.set / "inputs").glob("robot_*"))
    cases = sorted((options.set / "inputs").glob("robot_*/case_*/case.json"), key=mixed)
    cases = cases[first::step]
    todo = [p.parent for p in cases if left(p.parent, options.verdicts, options.again)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
        laws = [pool.submit(law_of, folder, options.verdicts, options.water) for folder in robots]
        for done in as_completed(laws):
            print(done.result(), flush=True)
        running: set[Future[str]] = set()
        for folder in [*todo, None]:
            while running and (folder is None or len(running) >= options.processes):
                one = next(as_completed(running))
                running.remove(one)
                print(one.exception() or one.result(), flush=True)
            if folder is None or time.monotonic() > deadline:
                continue
            running.add(pool.submit(answer, folder, options.verdicts, options.water, options.again))


if __name__ == "__main__":
    main()
