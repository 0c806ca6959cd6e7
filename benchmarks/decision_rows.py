"""Examine cases whose answers are known: one line a joint with all that a decision may look at.

    python -m benchmarks.decision_rows SET ROWS.jsonl VERDICTS --processes 28 --seconds 450
    python -m benchmarks.decision_rows SET STEPS.jsonl --steps

SET is a set of ``datasets/concealed`` or ``datasets/foreign``, of development seeds. The verdicts
are written along. What is in the file already is not examined again. Of a set without answers only
the verdicts are written.
"""

from __future__ import annotations

import json
import random
import traceback
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.harness import command_line, kept, read_lines, spread

if TYPE_CHECKING:
    from sim2real.diagnose.case import Case
    from sim2real.diagnose.joint_result import JointFindings

Row = dict[str, Any]
SHARED = ("supply", "link")


def main() -> None:
    """Examine the cases of a set until the time is over."""
    parser = command_line(
        __doc__, steps=(False, "only how finely sensors read, of all"), processes=1,
        seconds=(float("inf"), "then stop starting"),
    )  # fmt: skip
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("rows", type=Path, metavar="ROWS.jsonl")
    parser.add_argument("verdicts", type=Path, nargs="?", metavar="VERDICTS")
    options = parser.parse_args()
    told = options.set / "answers.json"
    names = sorted(folder.name for folder in (options.set / "inputs").iterdir())
    answers = json.loads(told.read_text()) if told.exists() else [{"case": name} for name in names]
    if options.steps:
        options.rows.unlink(missing_ok=True)
        list(kept(options.rows, (row for one in answers for row in stepped(options.set, one))))
        return
    known = {row["case"] for row in read_lines(options.rows)}
    left = [answer for answer in answers if answer["case"] not in known]
    examine = partial(measured, options.set, options.verdicts)
    random.Random(0).shuffle(left)
    if left:  # the first alone, as it compiles the kernels for all
        list(kept(options.rows, examine(left[0])))
    each = spread(examine, left[1:], options.processes, in_order=False, seconds=options.seconds)
    list(kept(options.rows, (row for rows in each for row in rows)))
    print(f"{len({row['case'] for row in read_lines(options.rows)})} of {len(answers)} cases")


def measured(challenge: Path, verdicts: Path, answer: Row) -> list[Row]:
    """What is known of each joint of a case; its verdict is written along."""
    from sim2real.diagnose.decision import DECISION
    from sim2real.diagnose.diagnose import examined
    from sim2real.diagnose.result import write_diagnosis
    from sim2real.diagnose.wording import diagnosis
    from sim2real.model import write_model

    try:
        case, joints = examined(read_case(challenge / "inputs" / answer["case"]))
        found = diagnosis(case, joints, DECISION.negligible, 0)
        target = verdicts / answer["case"]
        target.mkdir(parents=True, exist_ok=True)
        write_diagnosis(found, target / "diagnosis.json", "enriched.json")
        write_model(found.model, target / "enriched.json")
        if found.baseline is not None:
            write_model(found.baseline, target / "baseline.json")
        return [_row(answer, one, case) for one in joints] if "effects" in answer else [answer]
    except Exception:
        print(f"failed: {answer['case']}", flush=True)
        traceback.print_exc()
        return []


def stepped(challenge: Path, answer: Row) -> list[Row]:
    """How finely each joint's sensor reads, relative to what its data sheet states."""
    case = read_case(challenge / "inputs" / answer["case"])
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


def read_case(folder: Path) -> Case:
    """What a tool is given of a case."""
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
    groups, whole, of_link = odds_features(replace(finding, groups=raw), one.unseen)
    small = {
        name: size_in_noise(h, name, one.joint.noise)
        for h in (tried.plain, best)
        for name in h.members
        if named(name).everywhere
    }
    alone = {e: float(tries[s].fit.loglikelihood[0]) for e in (h["effect"] for h in hidden)
             if (s := tried.base | {e}) in tries}  # fmt: skip
    here = (one.name, *SHARED)
    return {
        "case": answer["case"],
        "set": answer.get("plant", "concealed"),
        "kind": answer["kind"],
        "joint": one.name,
        "truth": [h["effect"] for h in hidden if h["component"] in here and not outside],
        "always": [n["effect"] for n in answer.get("nuisances", ()) if n["component"] in here],
        "outside": outside and hidden[0]["component"] == one.name,
        "nuisances": small,
        "excess_plain": finding.unmodelled.excess,
        "alone": {e: x - float(tried.plain.fit.loglikelihood[0]) for e, x in alone.items()},
        "step": _step(case, next(j for j in case.robot.joints if j.name == one.name)) or 0.0,
        "whole": whole,
        "groups": [
            {
                "members": group.members,
                "changes": min(finding.changes(one.unseen, group.members[0]), 1e9),
                "features": features,
            }
            for group, features in groups
        ],
        "link": link and {"effect": link.effect, "features": of_link},
        "said": [[list(g.members), g.probability] for g in finding.groups],
    }


if __name__ == "__main__":
    main()
