"""Grade three parts of the report that decide no verdict: black box, best knockoff and formula.

    python datasets/foreign/make_foreign.py CASES --null 10 --single 10 --double 4 --outside 12
    python benchmarks/page_parts.py CASES DIAGNOSES RESULTS.json

The parts failed and were deleted: run it on the sources of commit 36e3dae, the last to have them.
For each case it compares a reader's conclusion with a part, the one without it, and the truth:

- black box: "something is still missing". With it: its held-out error is below 90 % of the
  enriched model's. Without it: the verdict says so; or that error exceeds the noise by 10 %.
- knockoff: "the effect named first is there". With it: the enriched model's held-out error is 5 %
  below that of the plain servo and of the best knockoff. Without it: 5 % below the plain servo's.
- formula: "the missing torque depends on this state", any state in it; wrong where nothing
  is hidden in the joint. Without it: the state in the report's sentence on the mismatch, or none.

A part corrects where only the conclusion with it is right, and misleads where only that is wrong.
It is kept if it corrects 10 % of the cases more than it misleads, the black box against both.
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.diagnose.diagnose import diagnose
from sim2real.output import write_json

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets" / "concealed"))
from grade import DETECTABLE, GIVEN_UP, SHARED, judge  # noqa: E402
from solve import _case, _write, plain_model  # noqa: E402

Row = dict[str, Any]
Pair = tuple[bool | None, bool | None]
BLACK_BOX, NOISE, GAIN, KEEP_SHARE = 0.9, 1.1, 0.95, 0.1
TRUE_STATES = {"speed_sign": {"speed"}, "jam": {"time", "speed"}}  # else the driver itself
SENTENCES = [("angle", "position"), ("joint speed", "speed"), ("position error", "load"),
             ("time", "time"), ("segments", "time"), ("vibration", "time"), ("instant", "time"),
             ("another joint", "other_joint")]  # fmt: skip


def main(cases: Path, diagnoses: Path, results: Path) -> None:
    """Diagnose what is not on disk yet, grade and write."""
    rows, truths = [], json.loads((cases / "answers.json").read_text())
    for truth in truths:
        folder = diagnoses / truth["case"]
        if not folder.exists():
            answer(cases / "inputs" / truth["case"], folder)
        judged = judge(truth, folder, cases / "heldout" / truth["case"])
        rows.append(graded(truth, judged, json.loads((folder / "diagnosis.json").read_text())))
    parts = {name: summary([row["parts"][name] for row in rows]) for name in rows[0]["parts"]}
    joints = separation([joint for row in rows for joint in row["joints"]])
    seed = str(truths[0]["seed"][0])
    write_json(results, {"seed": seed, "parts": parts, "joints": joints, "cases": rows})


def answer(inputs: Path, folder: Path) -> None:
    """Diagnose one case with all that a report shows, and write what ``judge`` reads."""
    case = _case(inputs)
    found = diagnose(case.recordings, case.robot, model=case.model)
    _write(folder, found, plain_model(found))


def graded(truth: Row, judged: Row, said: Row) -> Row:
    """One case: for each part whether the conclusion is right with it and without it."""
    missing = still_missing(truth, judged["entries"])
    ladders = {name.partition(".")[0]: x for name, x in said["heldout_ladder"].items()}
    where = {entry["component"]: entry["where"] for entry in said["mismatch"]}
    shown = {j: ladders[j] for j in where if j in ladders}
    lower = {j: x["black_box"] < BLACK_BOX * x["enriched"] for j, x in ladders.items()}
    noisy = any(x["enriched"] > NOISE * x["noise"] for x in ladders.values())
    parts: Row = {}
    for name, without in (("verdict", said["verdict"] in GIVEN_UP), ("noise", noisy)):
        # A joint without a mismatch has no ladder in the report: nothing changes for the reader.
        told = any(lower[j] for j in shown) if shown else without
        for which, conclusion in (("", told), (" of all joints", any(lower.values()))):
            right = conclusion == bool(missing), without == bool(missing)
            parts[f"black box{which} against {name}"] = right
    parts["best knockoff"] = knockoff(judged["entries"], shown)
    parts["formula"] = formula(truth, said["hypothesis"], where)
    joints = [{"joint": j, "shown": j in shown, "missing": bool({j, *SHARED} & missing), **x}
              for j, x in ladders.items()]  # fmt: skip
    row = {key: judged[key] for key in ("case", "kind", "plant", "truth", "verdict", "entries")}
    return row | {"joints": joints, "formulas": said["hypothesis"], "where": where, "parts": parts}


def still_missing(truth: Row, entries: list[Row]) -> set[str]:
    """Components of hidden physics that can be detected and has no right name."""
    hidden, oracle = truth["effects"], truth["oracle"]
    if truth["kind"] == "outside" or not hidden:
        return {one["component"] for one in hidden}
    ratios = oracle.get("llr_of_each", {0: oracle["llr_total"]}).values()
    useful = oracle.get("practical_of_each", {0: oracle["practical"]}).values()
    named = [name for entry in entries for name in entry["group"]]
    return {one["component"] for one, ratio, use in zip(hidden, ratios, useful, strict=True)
            if ratio >= DETECTABLE and use and one["effect"] not in named}  # fmt: skip


def knockoff(entries: list[Row], shown: Row) -> Pair | None:
    """Whether the first name is rightly believed, with the knockoff and without; None if none."""
    some = [x for j, x in shown.items() if entries and entries[0]["component"] in (j, *SHARED)]
    if not some:
        return None
    gains = [x for x in some if x["enriched"] < GAIN * x["baseline"]]
    beats = any(x["enriched"] < GAIN * float(x["best_knockoff"]) for x in gains)
    return beats == entries[0]["right"], bool(gains) == entries[0]["right"]


def formula(truth: Row, formulas: Row, where: Row) -> Pair | None:
    """Whether the formula's states, and the sentence's, are right; None where there is none."""
    true: dict[str, set[str]] = {}
    for one in truth["effects"]:
        states = TRUE_STATES.get(one["effect"]) or TRUE_STATES.get(one["driver"], {one["driver"]})
        true[one["component"]] = true.get(one["component"], set()) | states
    found = []
    for joint, text in formulas.items():
        told = [state for words, state in SENTENCES if words in where[joint]]
        there = set().union(*(true.get(part, set()) for part in (joint, *SHARED)))
        own = re.sub(r"(speed|acceleration) of \w+", "other_joint", text)
        states = set(re.findall(r"position|speed|load|time|other_joint", own))
        found.append((bool(there & states), told[0] in there if told else None))
    return max(found, key=lambda pair: pair[0]) if found else None


def summary(pairs: list[Pair | None]) -> Row:
    """Cases that a part corrects and misleads, and whether it is kept."""
    shown = [pair for pair in pairs if pair is not None]
    corrected = sum(a is True and b is not True for a, b in shown)
    misled = sum(a is False and b is not False for a, b in shown)
    return {"of": len(pairs), "shown": len(shown), "corrected": corrected, "misled": misled,
            "kept": (corrected - misled) / len(pairs) >= KEEP_SHARE}  # fmt: skip


def separation(joints: list[Row]) -> Row:
    """How black box and noise tell joints that miss something from those that miss nothing."""
    found: Row = {"all": joints, "shown": [x for x in joints if x["shown"]]}
    for name, some in found.items():
        two = [[x for x in some if x["missing"] == missing] for missing in (True, False)]
        lower = [sum(x["black_box"] < BLACK_BOX * x["enriched"] for x in y) for y in two]
        found[name] = {"missing": len(two[0]), "nothing": len(two[1]), "black_box_lower": lower}
        for part in ("black_box", "noise"):
            a, b = (np.array([x["enriched"] / x[part] for x in y]) for y in two)
            found[name][f"auc_{part}"] = float((a[:, None] > b).mean()) if a.size * b.size else None
    return found


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:]))
