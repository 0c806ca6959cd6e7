"""Grade the answers to a sealed set of swims: every measure, and a line for every case.

    python datasets/pool/sealed_grade.py SET VERDICTS --out RESULTS.json

The measures are those of the servos' grader (``datasets/concealed/grade.py``), by its own functions
where they are of shares and of calibration. The other swim of each case, which no tool was given,
is used to score the models: in the twin, on the speed over ground; with ``--water`` corrected by
simulations of its commands in the fluid (``sealed_water.py --heldout``), with ``--again`` also by
those with the effects that were found.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
from collections import Counter
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from sim.inference.coordinates import signals_of
from sim.inference.in_water import by_twin_in_water, read_water_swims, robot_in_water
from sim.inference.swims import SwimSimulator, swim_of
from sim2real.model import read_model
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.robot import read_robot

Row = dict[str, Any]
Array = NDArray[np.float64]

DETECTABLE, SURE, LIKELY = 10.0, 0.9, 0.5
WORSE, NOISES = 0.01, 1.5
BARS = (
    ("An effect named at 0.9 where nothing is missing", "false_alarm", "<=", 0.02),
    ("Detectable effects flagged", "detection", ">=", 0.95),
    ("Right group first", "group_first", ">=", 0.90),
    ("Both of two", "doubles_both", ">=", 0.75),
    ("Outside the catalogue: abstains", "outside_abstains", ">=", 0.85),
    ("Wrong among names at 0.9", "confident_wrong", "<=", 0.03),
    ("Expected calibration error", "ece", "<=", 0.07),
    ("90 % intervals that hold the truth", "parameter_covered", "80 to 97 %", 0.80),
    ("Held out: the enriched model no worse", "no_worse", ">=", 0.98),
    ("Held out: within 1.5 times the noise, effects of the catalogue", "within_noise", ">=", 0.80),
    ("Held out: harm where nothing is missing", "harm", "<=", 0.02),
)
"""Of the issue."""


def servo_grader() -> ModuleType:
    """``datasets/concealed/grade.py``."""
    path = Path(__file__).parents[1] / "concealed" / "grade.py"
    spec = importlib.util.spec_from_file_location("servo_grade", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def judge(
    truth: Row,
    folder: Path,
    challenge: Path,
    waters: Sequence[Path] = (),
    again: Path | None = None,
    *,
    predict: bool = True,
) -> Row:
    """Scores of one case; ``predict``: also of its held-out swim."""
    answer = json.loads((folder / "diagnosis.json").read_text())
    hidden, kind = truth["effects"], truth["kind"]
    entries = [_entry(one, [] if kind == "outside" else hidden) for one in answer["effects"]]
    first = entries[0] if entries else None
    likely = [one for one in entries if one["probability"] >= LIKELY]
    row: Row = {
        "case": truth["case"], "robot": truth["robot"], "kind": kind,
        "references": truth["references"],
        "truth": [f"{one['effect']}@{one['component']}" for one in hidden],
        "parameters_true": [one["parameters"] for one in hidden],
        "strength": [one["strength"] for one in hidden],
        "llr": truth["oracle"]["llr_total"], "verdict": answer["verdict"],
        "unlisted": answer["unknown"].get("body"), "flagged": answer["verdict"] != "consistent",
        "entries": entries, "cost": json.loads((folder / "cost.json").read_text()),
        "heldout": _held_out(truth, folder, challenge, waters, again) if predict else None,
    }  # fmt: skip
    if kind == "single":
        row["group_right"] = bool(first and first["right"])
        row["exact"] = bool(
            first and first["right"] and (first["effect"], first["component"]) ==
            (hidden[0]["effect"], hidden[0]["component"])
        )  # fmt: skip
    if kind == "double":
        padded = likely + [{"named": []}] * 2
        row["found"] = max(
            sum(_same(e, one) for e, one in zip(order, hidden, strict=True))
            for order in permutations(padded[:5], 2)
        )
        row["both"] = row["found"] == 2
    row["intervals"] = [
        one for given, entry in zip(answer["effects"], entries, strict=True)
        if entry["probability"] >= LIKELY for one in _intervals(given, hidden)
    ]  # fmt: skip
    if kind == "outside":
        row["abstains"] = answer["verdict"] in ("unexplained", "partly_explained") and not likely
    return row | {"failures": _failures(row)}


def _entry(given: Row, hidden: list[Row]) -> Row:
    named = [[name, given["component"]] for name in given["group"]]
    entry = {
        "effect": given["effect"], "component": given["component"],
        "probability": given["probability"], "group": given["group"], "named": named,
    }  # fmt: skip
    return entry | {"right": any(_same(entry, one) for one in hidden)}


def _same(entry: Row, true: Row) -> bool:
    """Whether the effect is in the group; a group of one effect needs the component, too."""
    names = [name for name, _ in entry["named"]]
    if true["effect"] not in names:
        return False
    alone = len(names) == 1
    return not alone or entry["named"][0][1] == true["component"]


def _intervals(given: Row, hidden: list[Row]) -> list[Row]:
    """Whether the intervals of an exactly right name hold the truth."""
    for one in hidden:
        if (one["effect"], one["component"]) == (given["effect"], given["component"]):
            return [
                {"parameter": f"{one['effect']}.{name}", "true": value,
                 "mean": given["parameters"][name]["mean"],
                 "covered": given["parameters"][name]["q05"] <= value
                 <= given["parameters"][name]["q95"]}
                for name, value in one["parameters"].items() if name in given["parameters"]
            ]  # fmt: skip
    return []


def _held_out(
    truth: Row, folder: Path, challenge: Path, waters: Sequence[Path], again: Path | None
) -> Row:
    """Errors of surge and sway together on the held-out swim, m/s, and the camera's noise.

    Also those of every set of effects with a fit that was tried on the end of the other swim.
    """
    place = challenge / "inputs" / truth["robot"]
    robot, model = read_robot(place / "robot.toml"), read_model(place / "model.json")
    files = [water / f"{truth['robot']}.npz" for water in waters]
    _, simulate = robot_in_water(robot, model, files, threads=1)
    swim = swim_of(read_recording(challenge / "heldout" / truth["case"] / "b.csv"), robot)
    best = simulate
    if again and "again" in json.loads((folder / "cost.json").read_text()):
        water = read_water_swims(again / f"{truth['robot']}.npz")
        simulated_model = read_model(folder / "resimulated.json")
        best = by_twin_in_water(robot, simulated_model, water, threads=1)

    def error(file: str, simulator: SwimSimulator) -> Array:
        predicted = signals_of([read_model(folder / file)], swim, simulator)[0]
        return np.asarray(np.sqrt(np.mean((predicted - swim.signals) ** 2, axis=0)))

    base = error("baseline.json", simulate)
    same = (folder / "enriched.json").read_bytes() == (folder / "baseline.json").read_bytes()
    rich = base if same else error("enriched.json", best)
    noise = float(np.hypot(*np.broadcast_to(swim.noise, base.shape)[:2]))
    kept = folder / "raw.json"
    tried = [
        {
            "names": one["names"],
            "error": float(np.hypot(*error(f"tried_{k}.json", best)[:2])),
        }
        for k, one in enumerate(json.loads(kept.read_text())["held"] if kept.exists() else ())
        if one["names"]
    ]
    return {
        "base": float(np.hypot(*base[:2])), "enriched": float(np.hypot(*rich[:2])), "noise": noise,
        "joints": [float(np.sqrt(np.mean(e[3:] ** 2))) for e in (base, rich)], "tried": tried,
    }  # fmt: skip


def _failures(row: Row) -> list[str]:
    kind, seen = row["kind"], row["llr"] >= DETECTABLE
    sure = [e for e in row["entries"] if e["probability"] >= SURE]
    held = row["heldout"]
    wrong = [
        ("false alarm", kind == "null" and bool(sure)),
        ("flagged", kind == "null" and row["flagged"] and not sure),
        ("confidently wrong", kind != "null" and any(not e["right"] for e in sure)),
        ("missed", kind in ("single", "double") and seen and not row["flagged"]),
        ("not first", kind == "single" and seen and row["flagged"] and not row["group_right"]),
        ("not both", kind == "double" and not row["both"]),
        ("does not abstain", kind == "outside" and not row["abstains"]),
        ("worse held out", bool(held) and held["enriched"] > (1 + WORSE) * held["base"]),
    ]
    return [name for name, failed in wrong if failed]


def summarize(rows: list[Row], grader: ModuleType) -> Row:
    """All measures."""
    share = grader.share
    of = {
        kind: [r for r in rows if r["kind"] == kind]
        for kind in ("null", "single", "double", "outside")
    }
    seen = [r for r in of["single"] if r["llr"] >= DETECTABLE]
    both = [r for r in of["double"] if r["llr"] >= DETECTABLE]
    sure = [e for r in rows for e in r["entries"] if e["probability"] >= SURE]
    calibrated, bins = grader.calibration([e for r in rows for e in r["entries"]])
    intervals = [one for r in rows for one in r["intervals"]]
    held = lambda r: r["heldout"]  # noqa: E731
    scored = {kind: [r for r in each if held(r)] for kind, each in of.items()}
    listed = scored["single"] + scored["double"]
    metrics = {
        "false_alarm": share(
            any(e["probability"] >= SURE for e in r["entries"]) for r in of["null"]
        ),
        "nulls_flagged": share(r["flagged"] for r in of["null"]),
        "detection": share(r["flagged"] for r in seen + both),
        "detection_all": share(r["flagged"] for r in of["single"] + of["double"]),
        "group_first": share(r["group_right"] for r in seen),
        "group_first_of_flagged": share(r["group_right"] for r in seen if r["flagged"]),
        "exact_first": share(r["exact"] for r in seen),
        "group_size": grader.plain([len(r["entries"][0]["group"]) for r in seen if r["entries"]]),
        "doubles_both": share(r["both"] for r in both),
        "doubles_one": share(r["found"] >= 1 for r in both),
        "outside_abstains": share(r["abstains"] for r in of["outside"]),
        "outside_flagged": share(r["flagged"] for r in of["outside"]),
        "outside_confident_wrong": share(
            any(e["probability"] >= SURE for e in r["entries"]) for r in of["outside"]
        ),
        "confident_wrong": share(not e["right"] for e in sure),
        **calibrated,
        "parameter_covered": share(one["covered"] for one in intervals),
        "no_worse": share(
            held(r)["enriched"] <= (1 + WORSE) * held(r)["base"] for r in rows if held(r)
        ),
        "within_noise": share(held(r)["enriched"] <= NOISES * held(r)["noise"] for r in listed),
        "harm": share(held(r)["enriched"] > (1 + WORSE) * held(r)["base"] for r in scored["null"]),
        "enriched_over_noise": grader.quantile(
            [held(r)["enriched"] / held(r)["noise"] for r in listed], 0.5
        ),
        "wall_s": grader.quantile([r["cost"]["wall_s"] for r in rows], 0.5),
        "cpu_s": grader.quantile([r["cost"]["cpu_s"] for r in rows], 0.5),
    }
    counts = dict(Counter(r["kind"] for r in rows)) | {"detectable_singles": len(seen)}
    by_effect: dict[str, list[bool]] = {}
    for r in seen:
        by_effect.setdefault(r["truth"][0], []).append(r["group_right"])
    return {
        "counts": counts, "metrics": metrics, "reliability": bins,
        "by_effect": {k: f"{sum(v)}/{len(v)}" for k, v in sorted(by_effect.items())},
    }  # fmt: skip


def grade(
    challenge: Path, verdicts: Path, waters: Sequence[Path] = (), again: Path | None = None
) -> Row:
    """All results of a set, of the cases that were answered."""
    sealed = (challenge / "answers.json").read_bytes()
    published = json.loads((challenge / "hashes.json").read_text())
    grader = servo_grader()
    cases = [
        one
        for one in json.loads(sealed)["cases"]
        if (verdicts / one["case"] / "cost.json").exists()
    ]
    rows = [
        judge(one, verdicts / one["case"], challenge, waters, again)
        for one in tqdm(cases, disable=None)
    ]
    return {
        "schema": "sim2real.grade/1", "tier": "T4", "set": challenge.name,
        "answers_as_published": published["answers.json"] == hashlib.sha256(sealed).hexdigest(),
        "hashes": published, "results": summarize(rows, grader), "cases": rows,
    }  # fmt: skip


def main() -> None:
    """Grade, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("verdicts", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--water", type=Path, nargs=2, default=(), metavar=("INPUTS", "HELD_OUT"))
    parser.add_argument("--again", type=Path, help="simulations with the effects that were found")
    options = parser.parse_args()
    results = grade(options.set, options.verdicts, options.water, options.again)
    write_json(options.out, results)
    shown = servo_grader().shown
    found = results["results"]
    print(found["counts"], found["by_effect"])
    for name, metric in found["metrics"].items():
        bar = next((f"  bar {rel} {bar}" for _, key, rel, bar in BARS if key == name), "")
        print(f"  {name:28s} {shown(metric)}{bar}")


if __name__ == "__main__":
    main()
