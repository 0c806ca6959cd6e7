"""Examine cases whose answers are known: one line a joint with all that a decision may look at.

    python benchmarks/decision_rows.py SET ROWS.jsonl VERDICTS --processes 28 --seconds 450

SET is a set of ``datasets/concealed`` or ``datasets/foreign``, of development seeds. The verdicts
are written along. What is in the file already is not examined again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

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
    waiting, running, done = iter(left), set(), 0
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


def _row(answer: Row, one: Any, robot: Any) -> Row:
    from sim2real.diagnose.investigate import by_evidence, nameless_lead
    from sim2real.diagnose.nuisances import size_in_noise
    from sim2real.effects import named
    from sim2real.noise import quantization_step

    finding, best = one.finding, one.finding.best
    tried, hidden = finding.tried, answer["effects"]
    outside = answer["kind"] == "outside"
    steps = [quantization_step(t.position) for t in one.joint.traces]
    stated = next(j.servo.position_step_rad for j in robot.joints if j.name == one.name)
    count = float(best.fit.count[0])
    unseen = {m: one.unseen[m].rmse if m in one.unseen else None
              for m in (tried.base, best.members)}  # fmt: skip
    groups = by_evidence(tried, finding.posterior.groups(tried.base))
    return {
        "case": answer["case"],
        "set": answer.get("plant", "concealed"),
        "kind": answer["kind"],
        "joint": one.name,
        "joints": len(robot.joints),
        "truth": [
            h["effect"] for h in hidden
            if h["component"] in (one.name, *SHARED) and not outside
        ],
        "outside": outside and hidden[0]["component"] == one.name,
        "base": {name: size_in_noise(tried.plain, name, one.joint.noise) for name in tried.base
                 if named(name).everywhere},
        "law": "motor" if tried.plain.fit.servos.columns.shape[1] > 3 else "pd",
        "period_s": float(np.median(np.diff(one.joint.traces[0].t))),
        "noise_rad": one.joint.noise,
        "innovation_rad": float(np.sqrt(best.fit.error2[0] / count)),
        "speed_rad_s": float(np.sqrt(np.mean([
            np.nanmean(np.gradient(t.command, t.t) ** 2) for t in one.joint.traces]))),
        "count": count,
        "excess_plain": finding.unmodelled.excess,
        "excess": finding.excess,
        "smooth": finding.unmodelled.smooth.evidence(count),
        "windows": max(finding.unmodelled.windows_evidence, -1e9),
        "lead": nameless_lead(tried, best, finding.unmodelled),
        "own": best.evidence - tried.plain.evidence,
        "left": [finding.search.left(tried, tried.base), finding.search.left(tried, best.members)],
        "unseen": [unseen[tried.base], unseen[best.members]],
        "step": min(steps) / stated if stated > 0 else 0.0,
        "mismatch": finding.mismatch,
        "unknown": finding.unknown,
        "groups": [
            {
                "members": group.members,
                "p": group.probability,
                "stability": group.stability,
                "alone": max((tried.tried[tried.base | {e}].evidence - tried.plain.evidence
                              for e in group.members if tried.base | {e} in tried.tried),
                             default=0.0),
                "without": best.evidence - tried.tried[best.members - {group.members[0]}].evidence
                if group.members[0] in best.members
                and best.members - {group.members[0]} in tried.tried else None,
                "changes": min(one.changes(group.members[0]), 1e9),
                "size": size_in_noise(best, group.members[0], one.joint.noise)
                if named(group.members[0]).everywhere and group.members[0] in best.members
                else None,
            }
            for group in groups
        ],
        "said": [[list(g.members), g.probability] for g in finding.groups],
        "link": None if finding.link is None else {
            "effect": finding.link.effect, "gain": finding.link.gain, "value": finding.link.value,
            "shares": finding.link.shares},
    }  # fmt: skip


if __name__ == "__main__":
    main()
