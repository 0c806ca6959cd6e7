"""Examine cases whose answers are known: one line a joint with all that a decision may look at.

    python -m benchmarks.decision_rows SET ROWS.jsonl VERDICTS --processes 28 --seconds 450

SET is a set of ``datasets/concealed`` or ``datasets/foreign``, of development seeds. The verdicts
are written along. What is in the file already is not examined again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
import traceback
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim2real.diagnose.joint_result import JointResult
    from sim2real.robot import Robot

Row = dict[str, Any]
SHARED = ("supply", "link")


def main() -> None:
    """Examine the cases of a set until the time is over."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("rows", type=Path, metavar="ROWS.jsonl")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    options = parser.parse_args()
    deadline = time.perf_counter() + options.seconds
    answers = json.loads((options.set / "answers.json").read_text())
    known = {row["case"] for row in read(options.rows)}
    left = [answer for answer in answers if answer["case"] not in known]
    running: set[Future[list[Row]]] = set()
    waiting, done = iter(left), 0
    spawn = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(options.processes, mp_context=spawn) as pool,
        options.rows.open("a") as file,
    ):
        while True:
            # The first one alone: it compiles the kernels for all.
            while len(running) < (options.processes if done else 1):
                answer = next(waiting, None) if time.perf_counter() < deadline else None
                if answer is None:
                    break
                running.add(pool.submit(measured, options.set, answer, options.verdicts))
            if not running:
                break
            first = next(as_completed(running))
            running.remove(first)
            done += 1
            try:
                file.writelines(json.dumps(row) + "\n" for row in first.result())
            except Exception as error:
                print(f"failed: {error!r}", flush=True)
                traceback.print_exception(error)
            file.flush()
            print(f"{done} of {len(left)} cases", flush=True)


def read(path: Path) -> list[Row]:
    """The lines of a file; one that was cut off is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def measured(challenge: Path, answer: Row, verdicts: Path) -> list[Row]:
    """What is known of each joint of a case; its verdict is written along."""
    from sim2real.diagnose.decision import DECISION
    from sim2real.diagnose.diagnose import Case, examined
    from sim2real.diagnose.result import write_diagnosis
    from sim2real.diagnose.wording import diagnosis
    from sim2real.model import read_model, write_model
    from sim2real.recording import read_recording
    from sim2real.robot import read_robot

    start, folder = time.process_time(), challenge / "inputs" / answer["case"]
    recordings = [read_recording(path) for path in sorted(folder.glob("[abd-q]*.csv"))]
    references = [read_recording(path) for path in sorted(folder.glob("ref_*.csv"))]
    given = folder / "model.json"
    model = read_model(given) if given.exists() else None
    robot = read_robot(folder / "robot.toml")
    ((case, joints),) = examined([Case(recordings, robot, model, references)])
    found = diagnosis(case, joints, DECISION.negligible, 0)
    target = verdicts / answer["case"]
    target.mkdir(parents=True, exist_ok=True)
    write_diagnosis(found, target / "diagnosis.json", "enriched.json")
    write_model(found.model, target / "enriched.json")
    if found.baseline is not None:
        write_model(found.baseline, target / "baseline.json")
    rows = [_row(answer, one, robot) for one in joints]
    spent = time.process_time() - start
    (target / "cost.json").write_text(json.dumps({"cpu_s": spent}) + "\n")
    return [{**row, "cpu_s": spent, "verdict": found.verdict} for row in rows]


def _row(answer: Row, one: JointResult, robot: Robot) -> Row:
    from sim2real.diagnose.judging import changes, evidence
    from sim2real.diagnose.nuisances import size_in_noise
    from sim2real.effects import named
    from sim2real.noise import quantization_step

    finding, best = one.finding, one.finding.best
    tried, hidden = finding.tried, answer["effects"]
    outside = answer["kind"] == "outside"
    steps = [quantization_step(t.position) for t in one.joint.traces]
    stated = next(j.servo.position_step_rad for j in robot.joints if j.name == one.name)
    told = evidence(finding, one.unseen)
    errors = [one.unseen[m].rmse if m in one.unseen else None for m in (tried.base, best.members)]
    small = {
        name: size_in_noise(h, name, one.joint.noise)
        for h in (tried.plain, best)
        for name in h.members
        if named(name).everywhere
    }
    link = finding.link
    return {
        "case": answer["case"],
        "set": answer.get("plant", "concealed"),
        "kind": answer["kind"],
        "joint": one.name,
        "joints": len(robot.joints),
        "truth": [
            h["effect"] for h in hidden if h["component"] in (one.name, *SHARED) and not outside
        ],
        "outside": outside and hidden[0]["component"] == one.name,
        "nuisances": small,
        "in_base": sorted(tried.base),
        "law": int((tried.plain.fit.servos.columns[0] >= 0).sum()),
        "noise_rad": one.joint.noise,
        "unseen": errors,
        "excess_plain": finding.unmodelled.excess,
        "excess": finding.excess,
        "left": finding.search.left(tried, tried.base),
        "step": min(steps) / stated if stated > 0 else 0.0,
        "whole": told.whole,
        "groups": [
            {
                "members": group.members,
                "p": group.probability,
                "changes": min(changes(finding, one.unseen, group.members[0]), 1e9),
                "features": features,
            }
            for group, features in told.groups
        ],
        "link": link and {
            "effect": link.effect, "gain": link.gain, "value": link.value, "shares": link.shares,
            "changes": changes(finding, one.unseen, link.effect), "features": told.link,
        },
        "said": [[list(g.members), g.probability] for g in finding.groups],
        "unknown": finding.unknown,
        "mismatch": finding.mismatch,
    }  # fmt: skip


if __name__ == "__main__":
    main()
