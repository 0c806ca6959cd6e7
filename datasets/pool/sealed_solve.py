"""Let ``sim2real diagnose`` answer every case of a sealed set of swims, from its inputs alone.

    python datasets/pool/sealed_solve.py SET VERDICTS [--processes N] [--water WATER]
    python datasets/pool/sealed_solve.py SET VERDICTS --executor ray [--address HOST:PORT]
    python datasets/pool/sealed_solve.py SET VERDICTS --water WATER --again AGAIN

The prior from a robot's reference swims is computed once and kept, the time of each case is in
``cost.json``. Cases with answers are skipped; ``--again`` repeats those that the fluid has
simulated with the effects that were found (``sealed_water.py --again``). Jobs of a lost process or
node are run by another.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim.inference.coordinates import Coordinates
from sim.inference.diagnose_swims import diagnosis_of, likely_model
from sim.inference.in_water import (
    by_twin_in_water,
    differs,
    read_water_swims,
    robot_in_water,
    with_fluid_effects,
)
from sim.inference.law_error import FILE, IN_WATER, LawError, learned, read_law_error
from sim.inference.searched import searched
from sim.inference.swim_problem import SwimPrior, SwimProblem
from sim.inference.swims import swim_of
from sim2real.commands.command import EXECUTOR, add_options, where_jobs_run
from sim2real.diagnose.result import write_diagnosis
from sim2real.executor import Job, JobOutcome, run_jobs
from sim2real.executor.job import NOT_STARTED
from sim2real.model import read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

RESIMULATED = "resimulated.json"
"""Model with the effects that the fluid simulates again."""


def learn_law(run: Path, *, robot_folder: str, water_folder: str | None) -> None:
    """Job: compute and keep the prior from a robot's reference swims."""
    folder, water = Path(robot_folder), None if water_folder is None else Path(water_folder)
    start = time.perf_counter()
    robot, model = read_robot(folder / "robot.toml"), read_model(folder / "model.json")
    files = [water / f"{folder.name}.npz"] if water else []
    model, simulate = robot_in_water(robot, model, files, threads=1)
    references = [swim_of(read_recording(p), robot) for p in sorted(folder.glob("ref_*.csv"))]
    prior = learned(references, model, robot, simulate, known_of(water))
    np.savez(run / "part.npz", **vars(prior))
    os.replace(run / "part.npz", run.parent / f"{folder.name}.npz")
    print(f"{folder.name} learned, {time.perf_counter() - start:.0f} s")


def known_of(water: Path | None) -> LawError:
    """The error of the twin, alone or corrected by the fluid."""
    return read_law_error(IN_WATER if water else FILE)


def answer(target: Path, *, case: str, water_folder: str | None, again_folder: str | None) -> None:
    """Job: diagnose one case, or again with simulations of the effects that were found."""
    start, before = time.perf_counter(), time.process_time()
    folder, place, verdicts = Path(case), Path(case).parent, target.parent
    water, again = (None if x is None else Path(x) for x in (water_folder, again_folder))
    robot, model = read_robot(place / "robot.toml"), read_model(place / "model.json")
    files = [water / f"{place.name}.npz"] if water else []
    model, simulate = robot_in_water(robot, model, files, threads=1)
    known = known_of(water)
    referred = json.loads((folder / "case.json").read_text())["references"]
    prior = learned([], model, robot, simulate, known)
    if referred:
        kept = np.load(verdicts / f"{place.name}.npz")
        prior = SwimPrior(**{name: kept[name] for name in kept.files})
    simulated_model = None
    if again:
        simulated_model = read_model(target / RESIMULATED)
        other = read_water_swims(again / f"{place.name}.npz")
        simulate = by_twin_in_water(robot, simulated_model, other, threads=1)
    swims = [swim_of(read_recording(path), robot) for path in sorted(folder.glob("*.csv"))]
    problem = SwimProblem(Coordinates.of(robot, model), swims, simulate, prior)
    found = searched(problem, simulated=simulated_model, referred=referred)
    diagnosis = diagnosis_of(found, robot, known)
    write_diagnosis(diagnosis, target / "diagnosis.json", "enriched.json")
    assert diagnosis.baseline is not None
    if not again:
        write_model(diagnosis.baseline, target / "baseline.json")
        there = with_fluid_effects(model, likely_model(found, known))
        if differs(model, there):
            write_model(there, target / RESIMULATED)
    without = diagnosis.model == diagnosis.baseline
    offered = read_model(target / "baseline.json") if without else diagnosis.model
    write_model(offered, target / "enriched.json")
    for k, members in enumerate(found.held):
        fit = found.found[members].fit
        write_model(found.problem.coordinates.model_at(fit.x), target / f"tried_{k}.json")
    (target / "raw.json").write_text(json.dumps(found.raw) + "\n")
    cost = {"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - before}
    if again:
        first = json.loads((target / "cost.json").read_text())
        cost = {name: value + first[name] for name, value in cost.items()} | {"again": True}
    (target / "cost.json").write_text(json.dumps(cost) + "\n")
    print(f"{folder.name} {diagnosis.verdict}, {cost['wall_s']:.0f} s")


def unanswered(folder: Path, verdicts: Path, again: Path | None) -> bool:
    """Whether a case has no answer yet."""
    cost = verdicts / folder.name / "cost.json"
    if not again:
        return not cost.exists()
    return (cost.parent / RESIMULATED).exists() and "again" not in json.loads(cost.read_text())


def mixed(path: Path) -> int:
    """Key of an order in which robots alternate, so that a stopped run has cases of all robots."""
    return (37 * int(path.parent.name.removeprefix("case_"))) % 1009


def main() -> int:
    """Compute the priors, answer the cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("verdicts", type=Path)
    parser.add_argument("--processes", type=int, default=2, help="--executor local --jobs N")
    add_options(parser, EXECUTOR.format("local"))
    parser.set_defaults(executor="local")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then start no more")
    parser.add_argument("--water", type=Path, help="simulations in the fluid: sealed_water.py")
    parser.add_argument("--again", type=Path, help="those with the effects that were found")
    parser.add_argument("--share", default="0/1", metavar="K/N", help="every Nth case from the Kth")
    options = parser.parse_args()
    deadline = time.monotonic() + options.seconds
    where = {**where_jobs_run(options), "at_once": options.jobs or options.processes}
    first, step = (int(x) for x in options.share.split("/"))
    robots = sorted((options.set / "inputs").glob("robot_*"))
    cases = sorted((options.set / "inputs").glob("robot_*/case_*/case.json"), key=mixed)
    cases = cases[first::step]
    todo = [p.parent for p in cases if unanswered(p.parent, options.verdicts, options.again)]
    water, again = (
        None if x is None else str(x.absolute()) for x in (options.water, options.again)
    )
    laws = [
        Job(
            f"{folder.name}.law",
            "sealed_solve:learn_law",
            {"robot_folder": str(folder.absolute()), "water_folder": water},
            options.verdicts / f"{folder.name}.law",
        )
        for folder in robots
        if not (options.verdicts / f"{folder.name}.npz").exists()
    ]
    call = {"water_folder": water, "again_folder": again}
    answers = [
        Job(
            case.name,
            "sealed_solve:answer",
            {"case": str(case.absolute()), **call},
            options.verdicts / case.name,
        )
        for case in todo
    ]
    failed = ended_badly(run_jobs(laws, **where))
    seconds = deadline - time.monotonic()
    return 1 if ended_badly(run_jobs(answers, seconds=seconds, **where)) or failed else 0


def ended_badly(outcomes: Sequence[JobOutcome]) -> int:
    """Print every outcome; the number of jobs that failed."""
    for outcome in outcomes:
        print(outcome)
    return sum(outcome.failure not in (None, NOT_STARTED) for outcome in outcomes)


if __name__ == "__main__":
    sys.exit(main())
