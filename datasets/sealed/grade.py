"""Grade the answers to a sealed set, of servos or of swims: every measure, a line for every case.

    python datasets/sealed/grade.py SET VERDICTS --out RESULTS.json [--csv cases.csv] [--answered]
    python datasets/sealed/grade.py SET VERDICTS --out FILE --water IN HELD_OUT --again AGAIN

Models are scored on recordings that no tool was given. Swims are scored in the twin, on the speed
over ground; with ``--water`` corrected by simulations of their commands in the fluid
(``datasets/pool/sealed_water.py``), with ``--again`` also by those with the effects found.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from measures import (
    HARM,
    LIKELY,
    NOTHING,
    NULLS,
    SWIMS,
    detectable,
    shown,
    summarize,
    sure_of,
    table,
)
from tqdm import tqdm

from sim.inference.coordinates import signals_of
from sim.inference.in_water import by_twin_in_water, read_water_swims, robot_in_water
from sim.inference.swims import SwimSimulator, swim_of
from sim2real.model import Model, read_model
from sim2real.output import write_json, write_whole
from sim2real.recording import Recording, read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

Row = dict[str, Any]

SHARED = ("supply", "link")
"""Components of servos that show on any joint."""
RECOVERABLE = 1.05
"""Held-out error over its floor from which on a share of it can be told."""
GIVEN_UP = ("unexplained", "partly_explained")


def main(arguments: Sequence[str] | None = None) -> None:
    """Grade, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--out", type=Path, required=True, metavar="RESULTS.json")
    parser.add_argument("--csv", type=Path, metavar="CASES.csv")
    parser.add_argument("--answered", action="store_true", help="leave out cases with no verdict")
    parser.add_argument("--water", type=Path, nargs=2, default=(), metavar=("INPUTS", "HELD_OUT"))
    parser.add_argument("--again", type=Path, help="simulations with the effects that were found")
    options = parser.parse_args(arguments)
    water = (options.water, options.again)
    results = grade(options.set, options.verdicts, answered=options.answered, water=water)
    write_json(options.out, results)
    if options.csv:
        write_whole(options.csv, table(results["cases"]))
    for tier, found in [*results["tiers"].items(), *results["plants"].items()]:
        print(tier, found["counts"], found["by_effect"])
        for name, metric in found["metrics"].items():
            print(f"  {name:32s} {shown(metric)}")


def grade(
    challenge: Path,
    verdicts: Path,
    *,
    answered: bool = False,
    water: tuple[Sequence[Path], Path | None] = ((), None),
) -> dict[str, Any]:
    """All results of a set; of swims, or where so wished, only of the cases that have a verdict."""
    sealed = (challenge / "answers.json").read_bytes()
    content = json.loads(sealed)
    answers = content if isinstance(content, list) else content["cases"]
    tier = "T1" if isinstance(content, list) else content.get("tier", "T1")
    rows = []
    later = challenge / "oracle.json"  # worked out after the answers were published
    oracles = json.loads(later.read_text()) if later.exists() else {}
    for truth in tqdm(answers, disable=None):
        truth["oracle"] = truth.get("oracle") or oracles.get(truth["case"], {})
        truth.setdefault("tier", tier)
        folder = verdicts / truth["case"]
        if (folder / "diagnosis.json").exists() or not (answered or tier == SWIMS):
            rows.append(judge(truth, folder, challenge, water))
    path = challenge / "hashes.json"
    published = json.loads(path.read_text()) if path.exists() else {}
    digest = hashlib.sha256(sealed).hexdigest()

    def by(key: str) -> dict[str, Any]:
        names = sorted({str(row[key]) for row in rows if row[key]})
        return {name: summarize([row for row in rows if row[key] == name]) for name in names}

    return {
        "schema": "sim2real.grade/1",
        "set": challenge.name,
        "verdicts": verdicts.name,
        "answers_as_published": published.get("answers.json") == digest if published else None,
        "grader": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(),
        "hashes": published,
        "tiers": by("tier"),
        "plants": by("plant"),
        "cases": rows,
    }


def judge(truth: Row, folder: Path, challenge: Path, water: Any = ((), None)) -> Row:  # noqa: ANN401
    """What was said of one case beside what is true of it."""
    said = json.loads((folder / "diagnosis.json").read_text())
    hidden, oracle, kind = truth["effects"], truth["oracle"], truth["kind"]
    swims, held_out = truth["tier"] == SWIMS, challenge / "heldout" / truth["case"]
    # What every servo has a little of is there, too.
    there = [*([] if kind == "outside" else hidden), *truth.get("nuisances", [])]
    given = _named(said)
    entries = [_entry(one, there, swims=swims) for one in given]
    first = entries[0] if entries else None
    likely = [entry for entry in entries if entry["probability"] >= LIKELY]
    llr = oracle.get("llr_total", sum(oracle["llr"].values()) if "llr" in oracle else None)
    cost = folder / "cost.json"
    row: Row = {
        "case": truth["case"],
        "tier": truth["tier"],
        "kind": kind,
        "plant": truth.get("plant"),
        "robot": truth.get("robot"),
        "references": truth.get("references"),
        "practical": _practical(oracle),
        "truth": [f"{one['effect']}@{one['component']}" for one in hidden] or [truth.get("trap")],
        "strength": hidden[0].get("strength") if len(hidden) == 1 else None,
        "llr": llr,
        "llr_least": min(oracle["llr_of_each"].values()) if "llr_of_each" in oracle else llr,
        "oracle_group": oracle.get("group"),
        "verdict": said["verdict"],
        "flagged": said["verdict"] not in NOTHING or bool(said.get("negligible")),
        "entries": entries,
        "component_right": None,
        "iou": _windows(truth, said, held_out) if hidden and not swims else [],
        "cost": json.loads(cost.read_text()) if cost.exists() else None,
        "parameters": [],
    }
    row["heldout"] = (
        _swim_held_out(truth, folder, challenge, *water)
        if swims
        else _held_out(truth, folder, held_out)
    )
    parts = [entry["component"] for entry in entries[:1] or said.get("mismatch", [])[:1]]
    if hidden:
        row["component_right"] = any(_same(h["component"], p) for h in hidden for p in parts)
    if kind == "single":
        row["group_right"] = bool(first and first["right"])
        row["exact"] = bool(first and first["right"] and _exact(first, hidden[0], swims=swims))
        group = row["oracle_group"]
        placed = bool(first and _same(hidden[0]["component"], first["component"]))
        inside = placed and bool(first and first["effect"] in (group or []))
        row["in_oracle_group"] = inside if group else None
        if row["exact"] and not swims:
            row["parameters"] = _parameters(given[0], hidden[0]["parameters"])
    if swims:
        row["parameters"] = [
            estimate for one in given if one["probability"] >= LIKELY for true in hidden
            if _exact(one, true, swims=True) for estimate in _parameters(one, true["parameters"])
        ]  # fmt: skip
    if kind == "double":
        row |= _both(hidden, likely, swims=swims)
    if kind == "outside":
        row["abstains"] = said["verdict"] in GIVEN_UP and not likely
    return row | {"failures": _failures(row)}


def _practical(oracle: Row) -> bool:
    """Whether all that is hidden changes the held-out error by a share that somebody would act on.

    True where that was not worked out.
    """
    if each := oracle.get("practical_of_each"):
        return all(each.values())
    if "practical" not in oracle and (plain := oracle.get("heldout_plain_rad")):
        floor = oracle["heldout_floor_rad"]
        return any(plain[joint] > RECOVERABLE * floor[joint] for joint in plain)
    return bool(oracle.get("practical", True))


def _named(said: Row) -> list[Row]:
    """What a verdict names, likeliest first, that which hardly matters included."""
    every = [*said["effects"], *said.get("negligible", [])]
    return sorted(every, key=lambda one: -one["probability"])


def _entry(given: Row, hidden: list[Row], *, swims: bool) -> Row:
    group = list(dict.fromkeys([*given.get("group", []), given["effect"]]))
    kept = {name: given[name] for name in ("effect", "component", "probability")}
    entry = {**kept, "group": group}
    return entry | {"right": any(_right(entry, one, swims=swims) for one in hidden)}


def _right(entry: Row, true: Row, *, swims: bool) -> bool:
    """Whether a group contains an effect; of a swim only a group of one needs its component too."""
    if true["effect"] not in entry["group"]:
        return False
    if swims:
        return len(entry["group"]) > 1 or entry["component"] == true["component"]
    return _same(true["component"], entry["component"])


def _exact(given: Row, true: Row, *, swims: bool) -> bool:
    same = given["component"] == true["component"] or not swims
    return bool(given["effect"] == true["effect"] and same)


def _same(true: str, named: str) -> bool:
    return true in SHARED or true == named


def _both(hidden: list[Row], likely: list[Row], *, swims: bool) -> Row:
    """Whether each of several effects has an entry of its own, and what F1 needs."""

    def met(order: Sequence[Row]) -> int:
        return sum(_right(e, one, swims=swims) for e, one in zip(order, hidden, strict=False))

    padded = likely + [{"group": [], "component": ""}] * len(hidden)
    found = max(met(order) for order in permutations(padded[: len(hidden) + 4], len(hidden)))
    wrong = sum(not entry["right"] for entry in likely)
    return {"both": found == len(hidden), "found": found, "wrong": wrong, "of": len(hidden)}


def _parameters(given: Row, true: dict[str, float]) -> list[Row]:
    """Relative error of each parameter, and whether its 90 % interval holds the truth.

    Answers state the gain of a sensor, a diagnosis its difference from 1.
    """
    found = []
    for name, answered in true.items():
        value = answered - (name == "gain")
        estimate = given.get("parameters", {}).get(name)
        if estimate is None or "phase" in name:
            continue
        error = abs(estimate["mean"] - value) / max(abs(value), 1e-12)
        covered = estimate["q05"] <= value <= estimate["q95"]
        found.append({"parameter": name, "error": float(error), "covered": bool(covered)})
    return found


def _windows(truth: Row, said: Row, held_out: Path) -> list[float]:
    """Intersection over union of true and stated windows, one number a recording that has any."""
    shares = []
    for recording, true in (truth.get("windows_s") or {}).items():
        if not true or (held_out / f"{recording}.csv").exists():
            continue
        stated: list[Sequence[float]] = []
        for one in said.get("mismatch", []):
            if any(_same(hidden["component"], one["component"]) for hidden in truth["effects"]):
                stated += one.get("windows_by_recording", {}).get(recording, [])
        shares.append(overlap(true, stated))
    return shares


def overlap(one: Iterable[Sequence[float]], other: Iterable[Sequence[float]]) -> float:
    """Intersection over union of two sets of segments."""
    first, second = [list(map(tuple, segments)) for segments in (one, other)]
    edges = np.unique([end for segment in first + second for end in segment])
    both = either = 0.0
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        inside = [any(a <= start and stop <= b for a, b in each) for each in (first, second)]
        both += float(stop - start) * all(inside)
        either += float(stop - start) * any(inside)
    return both / either if either else 0.0


def _held_out(truth: Row, folder: Path, held_out: Path) -> Row | None:
    """Error on recordings not given, rad: of the plain model, the enriched one, the best there is.

    Over the joints that the hidden physics acts on; over all where there is none.
    """
    files = sorted(held_out.glob("*.csv"))
    if not files or not (folder / "baseline.json").exists():
        return None
    models = [read_model(folder / f"{name}.json") for name in ("baseline", "enriched")]
    squares: dict[str, list[float]] = defaultdict(list)
    for path in files:
        recording = read_recording(path)
        parts = {one["component"] for one in truth["effects"]}
        joints = [j for j in recording.joints if not parts or parts & {j, *SHARED}]
        joints = [j for j in joints if all(j in model.joints for model in models)]
        for name, model in zip(("base", "enriched"), models, strict=True):
            squares[name] += _mean_squares(recording, model, joints)
        floors = [_floor(truth, joint, path.stem) for joint in joints]
        squares["floor"] += [floor**2 for floor in floors if floor is not None]
    if not squares["base"]:
        return None
    errors = {name: float(np.sqrt(np.mean(x))) if x else None for name, x in squares.items()}
    base, rich, floor = errors["base"], errors["enriched"], errors.get("floor")
    assert base is not None and rich is not None
    if len(squares["floor"]) < len(squares["base"]):
        floor = None
    return _recovered(base, rich, floor)


def _recovered(base: float, rich: float, floor: float | None) -> Row:
    recoverable = floor is not None and base > RECOVERABLE * floor
    eta = (base - rich) / (base - floor) if recoverable and floor is not None else None
    return {"base": base, "enriched": rich, "floor": floor, "eta": eta, "drop": 1 - rich / base}


def _mean_squares(recording: Recording, model: Model, joints: list[str]) -> list[float]:
    column = {joint: recording.joints.index(joint) for joint in joints}
    command = {joint: recording.command[:, column[joint]] for joint in joints}
    angles = predict(model, recording.t, command, recording.loads)
    return [float(np.nanmean((angles[j] - recording.position[:, column[j]]) ** 2)) for j in joints]


def _floor(truth: Row, joint: str, recording: str) -> float | None:
    """Of the noise of a joint on a held-out recording, rad; None where nobody knows."""
    known = (truth.get("oracle") or {}).get("heldout_floor_rad", {})
    if joint in known and recording == "c":
        return float(known[joint])
    noise = truth.get("joints", {}).get(joint, {}).get("noise")
    if noise is None:
        return None
    coarse = [e["parameters"] for e in truth["effects"] if e["effect"] == "encoder_quantization"]
    step = max([noise["step_rad"], *(p["step_rad"] for p in coarse)])
    return float(np.sqrt(noise["white_rad"] ** 2 + noise["wander_rad"] ** 2 + step**2 / 12))


def _swim_held_out(
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
        simulated = read_model(folder / "resimulated.json")
        best = by_twin_in_water(robot, simulated, water, threads=1)

    def error(file: str, simulator: SwimSimulator) -> float:
        predicted = signals_of([read_model(folder / file)], swim, simulator)[0]
        return float(np.hypot(*np.sqrt(np.mean((predicted - swim.signals) ** 2, axis=0))[:2]))

    base = error("baseline.json", simulate)
    same = (folder / "enriched.json").read_bytes() == (folder / "baseline.json").read_bytes()
    rich = base if same else error("enriched.json", best)
    noise = float(np.hypot(*np.broadcast_to(swim.noise, swim.signals.shape[-1:])[:2]))
    kept = folder / "raw.json"
    tried = [
        {"names": one["names"], "error": error(f"tried_{k}.json", best)}
        for k, one in enumerate(json.loads(kept.read_text())["held"] if kept.exists() else ())
        if one["names"]
    ]
    return _recovered(base, rich, noise) | {"tried": tried}


def _failures(row: Row) -> list[str]:
    """What a reader would want to know went wrong."""
    kind, seen, held = row["kind"], detectable(row), row["heldout"] or {}
    eta, sure = held.get("eta"), sure_of(row)
    single, servos = kind == "single", row["tier"] != SWIMS
    wrong = [
        ("false alarm", kind in NULLS and any(not e["right"] for e in sure)),
        ("flagged", kind in NULLS and row["flagged"] and not sure),
        ("confidently wrong", kind not in NULLS and any(not e["right"] for e in sure)),
        ("missed", kind not in NULLS and seen and not row["flagged"]),
        ("not first", single and seen and row["flagged"] and not row["group_right"]),
        ("wrong component", single and servos and row["flagged"] and not row["component_right"]),
        ("does not abstain", kind == "outside" and row["flagged"] and not row["abstains"]),
        ("not both", kind == "double" and detectable(row, "llr_least") and not row["both"]),
        ("windows", any(x < 0.5 for x in row["iou"])),
        ("harm", bool(held) and held["drop"] < -HARM and (kind in NULLS or not servos)),
        ("error left", single and servos and seen and eta is not None and eta < 0.8),
    ]
    return [name for name, failed in wrong if failed]


if __name__ == "__main__":
    main()
