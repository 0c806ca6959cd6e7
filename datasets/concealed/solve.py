"""Let ``sim2real diagnose`` answer every case of a set, from its inputs alone.

python datasets/concealed/solve.py SET VERDICTS [--processes N] [--first K] [--last K]
python datasets/concealed/solve.py SET VERDICTS --executor ray [--address HOST:PORT]

With ``--processes`` or ``--executor`` each case is answered by itself, its time and the memory of
its process stand in ``cost.json``, and a case that has been answered is not answered again: what
was interrupted goes on where it stopped, and a case whose process or node is lost is answered by
another.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from sim2real.commands.command import EXECUTOR, add_options, where_jobs_run
from sim2real.diagnose.diagnose import Case, diagnose_case
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.executor import Job, run_jobs
from sim2real.executor.job import NOT_STARTED
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

TOGETHER = 240
"""Cases whose simulations share their launches."""


def main() -> int:
    """Answer the cases and say how long each took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--processes", type=int, metavar="N", help="--executor local --jobs N")
    add_options(parser, EXECUTOR.format("all cases together"))
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int)
    options = parser.parse_args()
    folders = sorted((options.set / "inputs").iterdir())[options.first : options.last]
    if options.processes:
        options.executor, options.jobs = options.executor or "local", options.processes
    if options.executor:
        return _one_by_one(folders, options)
    start = time.perf_counter()
    for at in range(0, len(folders), TOGETHER):
        some = folders[at : at + TOGETHER]
        for folder, answer in zip(some, answers(some), strict=True):
            _write(options.verdicts / folder.name, *answer)
        passed = time.perf_counter() - start
        print(f"{at + len(some)} cases, {passed:.0f} s", flush=True)
    return 0


def _one_by_one(folders: Sequence[Path], options: argparse.Namespace) -> int:
    """Answer each case in a process of its own, so that its memory is its own."""
    start = time.perf_counter()
    jobs = [
        Job(case.name, "solve:answer", {"case": str(case.absolute())}, options.verdicts / case.name)
        for case in folders
        if not (options.verdicts / case.name / "cost.json").exists()
    ]
    where = where_jobs_run(options)
    run_jobs(jobs[:1], **where)  # compiles the kernels, once for all processes
    left = options.seconds - (time.perf_counter() - start)
    outcomes = run_jobs(jobs, seconds=left, **where)
    answered = sum(outcome.failure is None for outcome in outcomes)
    print(f"{answered} of {len(jobs)} cases, {time.perf_counter() - start:.0f} s")
    failed = [one for one in outcomes if one.failure not in (None, NOT_STARTED)]
    for outcome in failed:
        print(outcome, file=sys.stderr)
    return 1 if failed else 0


def answer(folder: Path, *, case: str) -> None:
    """Answer one case; a job of ``sim2real.executor``.

    Args:
        folder: Where the answer is written.
        case: Folder of the case.
    """
    start, before = time.perf_counter(), time.process_time()
    (found,) = answers([Path(case)])
    cost = {
        "wall_s": time.perf_counter() - start,
        "cpu_s": time.process_time() - before,
        "memory_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    _write(folder, *found)
    partial = folder / f"cost.{os.getpid()}.part"
    partial.write_text(json.dumps(cost) + "\n")
    partial.rename(folder / "cost.json")


def _write(target: Path, found: Diagnosis, plain: Model) -> None:
    target.mkdir(parents=True, exist_ok=True)
    write_diagnosis(found, target / "diagnosis.json", "enriched.json")
    write_model(found.model, target / "enriched.json")
    write_model(plain, target / "baseline.json")


def answers(folders: Sequence[Path]) -> list[tuple[Diagnosis, Model]]:
    """The diagnosis and the plain model of each case, against its references where it has some."""
    found = [diagnose_case(_case(folder)) for folder in folders]
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
    sys.exit(main())
