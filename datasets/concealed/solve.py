"""Let ``sim2real diagnose`` answer every case of a set, from its inputs alone.

python datasets/concealed/solve.py SET VERDICTS [--processes N] [--first K] [--last K]

With ``--processes`` each case is answered by itself, its time and the memory of its process stand
in ``cost.json``, and a case that has been answered is not answered again: what was interrupted goes
on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from sim2real.diagnose.diagnose import Case, diagnose_all
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

TOGETHER = 240
"""Cases whose simulations share their launches."""


def main() -> None:
    """Answer the cases and say how long each took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--processes", type=int, default=0, metavar="N")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int)
    options = parser.parse_args()
    folders = sorted((options.set / "inputs").iterdir())[options.first : options.last]
    start = time.perf_counter()
    if options.processes:
        _one_by_one(folders, options.verdicts, options.processes, start + options.seconds)
        return
    for at in range(0, len(folders), TOGETHER):
        some = folders[at : at + TOGETHER]
        for folder, answer in zip(some, answers(some, options.device), strict=True):
            _write(options.verdicts / folder.name, *answer)
        passed = time.perf_counter() - start
        print(f"{at + len(some)} cases, {passed:.0f} s", flush=True)


def _one_by_one(folders: Sequence[Path], verdicts: Path, processes: int, deadline: float) -> None:
    left = [folder for folder in folders if not (verdicts / folder.name / "cost.json").exists()]
    if not left:
        print("all cases are answered")
        return
    _answer(left[0], verdicts)  # compiles the kernels, once for all processes
    # A process a case, so that its memory is its own.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, max_tasks_per_child=1) as pool:
        running = set()
        for done, folder in enumerate(left[1:], start=1):
            if len(running) >= processes:
                first = next(as_completed(running))
                running.remove(first)
                first.result()
                print(f"{done - len(running)} of {len(left)} cases", flush=True)
            if time.perf_counter() > deadline:
                break
            running.add(pool.submit(_answer, folder, verdicts))
        for rest in as_completed(running):
            rest.result()


def _answer(folder: Path, verdicts: Path) -> None:
    start, before = time.perf_counter(), time.process_time()
    (found,) = answers([folder], "cpu")
    cost = {
        "wall_s": time.perf_counter() - start,
        "cpu_s": time.process_time() - before,
        "memory_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    target = verdicts / folder.name
    _write(target, *found)
    partial = target / f"cost.{os.getpid()}.part"
    partial.write_text(json.dumps(cost) + "\n")
    partial.rename(target / "cost.json")


def _write(target: Path, found: Diagnosis, plain: Model) -> None:
    target.mkdir(parents=True, exist_ok=True)
    write_diagnosis(found, target / "diagnosis.json", "enriched.json")
    write_model(found.model, target / "enriched.json")
    write_model(plain, target / "baseline.json")


def answers(folders: Sequence[Path], device: str) -> list[tuple[Diagnosis, Model]]:
    """The diagnosis and the plain model of each case, against its references where it has some."""
    found = diagnose_all([_case(folder) for folder in folders], device=device)
    return [(one, plain_model(one)) for one in found]


def _case(folder: Path) -> Case:
    recordings, references = (
        [read_recording(path) for path in sorted(folder.glob(pattern))]
        for pattern in ("[abd-q]*.csv", "ref_*.csv")
    )
    given = folder / "model.json"
    model = read_model(given) if given.exists() else None
    return Case(recordings, read_robot(folder / "robot.toml"), model, references)


def plain_model(found: Diagnosis) -> Model:
    """The servos as fitted before anything was added."""
    assert found.baseline is not None
    joints: dict[str, JointModel] = dict(found.baseline.joints)
    return Model(joints=joints)


if __name__ == "__main__":
    main()
