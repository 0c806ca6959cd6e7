"""Examine cases whose answers are known: one line a joint with all that a decision may look at.

    python -m benchmarks.decision_rows SET ROWS.jsonl VERDICTS --processes 28 --seconds 450
    python -m benchmarks.decision_rows SET STEPS.jsonl --steps

SET is a set of ``datasets/concealed`` or ``datasets/foreign``, of development seeds. The verdicts
are written along. What is in the file already is not examined again. Of a set without answers only
the verdicts are written.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import time
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.harness import read_lines

if TYPE_CHECKING:
    from sim2real.diagnose.case import Case
    from sim2real.diagnose.joint_result import JointFindings

Row = dict[str, Any]
SHARED = ("supply", "link")


def main() -> None:
    """Examine the cases of a set until the time is over."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("rows", type=Path, metavar="ROWS.jsonl")
    parser.add_argument("verdicts", type=Path, nargs="?", metavar="VERDICTS")
    parser.add_argument("--steps", action="store_true", help="only how finely sensors read, of all")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="on the processor")
    parser.add_argument("--device", action="append", default=[], help="further ones, each a Warp"
                        " device such as cuda:0; may be repeated")  # fmt: skip
    parser.add_argument("--together", type=int, default=12, metavar="N", help="cases of a launch")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="then stop starting")
    options = parser.parse_args()
    deadline = time.perf_counter() + options.seconds
    told = options.set / "answers.json"
    names = sorted(folder.name for folder in (options.set / "inputs").iterdir())
    answers = json.loads(told.read_text()) if told.exists() else [{"case": name} for name in names]
    if options.steps:
        lines = [json.dumps(row) for one in answers for row in stepped(options.set, one)]
        options.rows.write_text("\n".join(lines) + "\n")
        return
    known = {row["case"] for row in read_lines(options.rows)}
    left = [answer for answer in answers if answer["case"] not in known]
    # The first one compiles the kernels for all: the shortest, as the others wait for it.
    inputs = options.set / "inputs"
    left.sort(key=lambda one: (inputs / one["case"] / "a.csv").stat().st_size)
    left = alike(options.set, left[:1], 1) + alike(options.set, left[1:], options.together)
    spawn = multiprocessing.get_context("spawn")
    lock, place = spawn.Lock(), spawn.Value("i", 0)
    devices = [*["cpu"] * options.processes, *options.device]
    workers = [
        spawn.Process(
            target=work,
            args=(options, left, device, 1 if device == "cpu" else options.together),
            kwargs={"place": place, "lock": lock, "seconds": deadline - time.perf_counter()},
        )
        for device in devices
    ]
    workers[0].start()
    while not read_lines(options.rows) and workers[0].is_alive() and time.perf_counter() < deadline:
        time.sleep(1.0)
    for worker in workers[1:]:
        worker.start()
    for worker in workers:
        worker.join()
    print(f"{len({row['case'] for row in read_lines(options.rows)})} of {len(answers)} cases")


def alike(challenge: Path, answers: Sequence[Row], together: int) -> list[Row]:
    """In random order, but so many of like sampling period together: they share launches."""

    def period(answer: Row) -> float:
        lines = (challenge / "inputs" / answer["case"] / "a.csv").read_text().splitlines()
        return float(lines[-1].partition(",")[0]) / (len(lines) - 2)

    ranked = sorted(answers, key=period)
    chunks = [ranked[k : k + together] for k in range(0, len(ranked), together)]
    random.Random(0).shuffle(chunks)
    return [answer for chunk in chunks for answer in chunk]


def work(
    options: argparse.Namespace,
    left: list[Row],
    device: str,
    together: int,
    *,
    place: Any,  # noqa: ANN401 - multiprocessing's proxies
    lock: Any,  # noqa: ANN401
    seconds: float,
) -> None:
    """Take the next cases and examine them, until none is left or the time is over."""
    deadline = time.perf_counter() + seconds
    while time.perf_counter() < deadline:
        with place.get_lock():
            begin = place.value
            place.value += together
        some = left[begin : begin + together]
        if not some:
            return
        try:
            rows = measured(options.set, some, options.verdicts, device)
        except Exception as error:
            print(f"failed: {error!r}", flush=True)
            traceback.print_exception(error)
            continue
        with lock, options.rows.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
        print(f"{device}: {', '.join(one['case'] for one in some)}", flush=True)


def measured(
    challenge: Path, answers: Sequence[Row], verdicts: Path, device: str = "cpu"
) -> list[Row]:
    """What is known of each joint of some cases; their verdicts are written along."""
    from sim2real.diagnose.decision import DECISION
    from sim2real.diagnose.diagnose import examined
    from sim2real.diagnose.result import write_diagnosis
    from sim2real.diagnose.wording import diagnosis
    from sim2real.model import write_model

    start, begin = time.process_time(), time.perf_counter()
    cases = [_case(challenge / "inputs" / answer["case"]) for answer in answers]
    rows = []
    for answer, given in zip(answers, cases, strict=True):
        case, joints = examined(given, device=device)
        found = diagnosis(case, joints, DECISION.negligible, 0)
        target = verdicts / answer["case"]
        target.mkdir(parents=True, exist_ok=True)
        write_diagnosis(found, target / "diagnosis.json", "enriched.json")
        write_model(found.model, target / "enriched.json")
        if found.baseline is not None:
            write_model(found.baseline, target / "baseline.json")
        if "effects" not in answer:
            rows.append({**answer, "verdict": found.verdict})
            continue
        rows += [
            {**_row(answer, one, case), "verdict": found.verdict, "varied": varied}
            for one, varied in zip(joints, _varied(joints), strict=True)
        ]
    cost = {
        "cpu_s": (time.process_time() - start) / len(answers),
        "wall_s": (time.perf_counter() - begin) / len(answers),
        "device": device,
    }
    for answer in answers:
        (verdicts / answer["case"] / "cost.json").write_text(json.dumps(cost) + "\n")
    return [{**row, **cost} for row in rows]


def stepped(challenge: Path, answer: Row) -> list[Row]:
    """How finely each joint's sensor reads, relative to what its data sheet states."""
    case = _case(challenge / "inputs" / answer["case"])
    outside = answer["kind"] == "outside"
    return [
        {
            "case": answer["case"],
            "joint": joint.name,
            "truth": [] if outside else [
                h["effect"] for h in answer["effects"] if h["component"] in (joint.name, *SHARED)
            ],
            "step": step,
        }
        for joint in case.robot.joints if (step := _step(case, joint)) is not None
    ]  # fmt: skip


def _step(case: Case, joint: Any) -> float | None:  # noqa: ANN401 - imported late
    """Step of a sensor as recorded, relative to the stated one; None where nothing moves."""
    from sim2real.servo.trace import traces

    given, stated = traces(case.recordings, joint.name), joint.servo.position_step_rad
    if not given or stated <= 0:
        return None
    steps = [trace.quantization_step() for trace in given]
    # One that differs between recordings is no grid.
    return float(min(steps) / stated) if max(steps) < 1.1 * min(steps) else 0.0


def _case(folder: Path) -> Case:
    from sim2real.diagnose.case import Case
    from sim2real.model import read_model
    from sim2real.recording import read_recording
    from sim2real.robot import read_robot

    given = folder / "model.json"
    return Case(
        [read_recording(path) for path in sorted(folder.glob("[abd-q]*.csv"))],
        read_robot(folder / "robot.toml"),
        read_model(given) if given.exists() else None,
        [read_recording(path) for path in sorted(folder.glob("ref_*.csv"))],
    )


def _row(answer: Row, one: JointFindings, case: Case) -> Row:
    from sim2real.diagnose.calibrated_odds import odds_features
    from sim2real.diagnose.effect_search import size_in_noise
    from sim2real.effects import named

    finding, best = one.finding, one.finding.best
    tried, hidden = finding.tried, answer["effects"]
    outside = answer["kind"] == "outside"
    link, tries = finding.link, tried.tried
    # What was judged has the curve's probabilities; the curve looks at those before.
    before = {g.members[0]: g.probability for g in finding.posterior.groups(tried.base)}
    raw = tuple(
        replace(g, probability=before.get(g.members[0], g.probability)) for g in finding.groups
    )
    told = odds_features(replace(finding, groups=raw), one.unseen)
    errors = [one.unseen[m].rmse if m in one.unseen else None for m in (tried.base, best.members)]
    small = {
        name: size_in_noise(h, name, one.joint.noise)
        for h in (tried.plain, best)
        for name in h.members
        if named(name).everywhere
    }
    alone = {e: float(tries[s].fit.loglikelihood[0]) for e in (h["effect"] for h in hidden)
             if (s := tried.base | {e}) in tries}  # fmt: skip
    likely = sorted(tries.values(), key=lambda h: -h.evidence)
    return {
        "case": answer["case"],
        "set": answer.get("plant", "concealed"),
        "kind": answer["kind"],
        "joint": one.name,
        "joints": len(case.robot.joints),
        "truth": [
            h["effect"] for h in hidden if h["component"] in (one.name, *SHARED) and not outside
        ],
        "always": [n["effect"] for n in answer.get("nuisances", ())
                   if n["component"] in (one.name, *SHARED)],
        "outside": outside and hidden[0]["component"] == one.name,
        "nuisances": small,
        "in_base": sorted(tried.base),
        "law": int((tried.plain.fit.servos.columns[0] >= 0).sum()),
        "noise_rad": one.joint.noise,
        "unseen": errors,
        "excess_plain": finding.unmodelled.excess,
        "excess": finding.excess,
        "left": finding.search.remaining_gain(tried, tried.base),
        "alone": {e: x - float(tried.plain.fit.loglikelihood[0]) for e, x in alone.items()},
        "tried": [
            [sorted(h.members - tried.base), h.evidence, float(h.fit.loglikelihood[0])]
            for h in likely if h.evidence > likely[0].evidence - FAR
        ],
        "count": float(best.fit.count[0]),
        "error_over_noise": one.error / one.joint.noise,
        "step": _step(case, next(j for j in case.robot.joints if j.name == one.name)) or 0.0,
        "whole": told.whole,
        "groups": [
            {
                "members": group.members,
                "p": group.probability,
                "changes": min(finding.changes(one.unseen, group.members[0]), 1e9),
                "features": features,
            }
            for group, features in told.groups
        ],
        "link": link and {
            "effect": link.effect, "gain": link.gain, "value": link.value, "shares": link.shares,
            "changes": finding.changes(one.unseen, link.effect), "features": told.link,
        },
        "said": [[list(g.members), g.probability] for g in finding.groups],
        "unknown": finding.unknown,
        "mismatch": finding.mismatch,
    }  # fmt: skip


FAR = 60.0
"""Evidence behind the likeliest set from which a set is not taken down."""
VARIED = {"law_error": (0.0, 0.01, 0.1), "group_share": (0.03, 0.3)}
"""Other values of numbers whose decisions can be taken again from the sets that were tried."""


def _varied(joints: Sequence[JointFindings]) -> list[Row]:
    """For each joint, by number and value, the likeliest set and the groups of it."""
    import numpy as np

    from sim2real.diagnose import effect_probabilities as posterior
    from sim2real.diagnose.decision import DECISION

    found: list[Row] = [{} for _ in joints]
    tried = [one.finding.tried for one in joints]
    every = [("", 0.0), *((name, x) for name, values in VARIED.items() for x in values)]
    for name, value in every:
        posterior.DECISION = replace(DECISION, **{name: value}) if name else DECISION
        some = posterior.posteriors(tried, np.random.default_rng(0))
        for row, one, probable in zip(found, tried, some, strict=True):
            groups = [[g.members, g.probability] for g in probable.groups(one.base)]
            row[f"{name}={value:g}" if name else ""] = [sorted(probable.sets[0]), groups]
    posterior.DECISION = DECISION
    return found


if __name__ == "__main__":
    main()
