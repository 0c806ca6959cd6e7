"""Grade the answers to a sealed set: every number of the proof, and a line for every case.

python datasets/concealed/grade.py SET VERDICTS --out RESULTS.json [--csv cases.csv] [--answered]
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta, binom

from sim2real.model import Model, read_model
from sim2real.output import write_json, write_whole
from sim2real.recording import Recording, read_recording
from sim2real.servo.prediction import predict

Row = dict[str, Any]

DETECTABLE = 10.0
"""Log-likelihood ratio from which on what is hidden ought to be found."""
SURE, LIKELY, STATED = 0.9, 0.5, 0.05
"""Probabilities: claimed; named at all; counted in the calibration."""
SHARED = ("supply", "link")
"""Components that show on any joint."""
CHANCE = ("latency_jitter", "packet_loss")
"""Effects whose dice nobody can predict on another recording."""
RECOVERABLE = 1.05
"""Held-out error over its floor from which on a share of it can be told."""
HARM = 0.01
AT_NOISE = 1.1
"""Held-out error over its floor up to which it is at the noise."""
NULLS = ("null", "trap")
NOTHING = ("consistent", "unchanged")
GIVEN_UP = ("unexplained", "partly_explained")


def main(arguments: Sequence[str] | None = None) -> None:
    """Grade and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--out", type=Path, required=True, metavar="RESULTS.json")
    parser.add_argument("--csv", type=Path, metavar="CASES.csv")
    parser.add_argument("--answered", action="store_true", help="leave out cases with no verdict")
    options = parser.parse_args(arguments)
    results = grade(options.set, options.verdicts, answered=options.answered)
    write_json(options.out, results)
    if options.csv:
        write_whole(options.csv, table(results["cases"]))
    for tier, found in [*results["tiers"].items(), *results["plants"].items()]:
        print(tier)
        for name, metric in found["metrics"].items():
            print(f"  {name:32s} {shown(metric)}")


def grade(challenge: Path, verdicts: Path, *, answered: bool = False) -> dict[str, Any]:
    """All results of a set; only of the cases that have a verdict, where so wished."""
    sealed = (challenge / "answers.json").read_bytes()
    content = json.loads(sealed)
    answers = content if isinstance(content, list) else content["cases"]
    tier = "T1" if isinstance(content, list) else content.get("tier", "T1")
    rows = []
    later = challenge / "oracle.json"  # worked out after the answers were published
    oracles = json.loads(later.read_text()) if later.exists() else {}
    for truth in answers:
        truth["oracle"] = truth.get("oracle") or oracles.get(truth["case"], {})
        folder = verdicts / truth["case"]
        if (folder / "diagnosis.json").exists() or not answered:
            row = judge(truth, folder, challenge / "heldout" / truth["case"])
            rows.append({"tier": truth.get("tier", tier), **row})
    path = challenge / "hashes.json"
    published = json.loads(path.read_text()) if path.exists() else {}
    digest = hashlib.sha256(sealed).hexdigest()
    return {
        "schema": "sim2real.grade/1",
        "set": challenge.name,
        "verdicts": verdicts.name,
        "answers_as_published": published.get("answers.json") == digest if published else None,
        "grader": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(),
        "hashes": published,
        "tiers": {
            name: summarize([row for row in rows if row["tier"] == name])
            for name in sorted({str(row["tier"]) for row in rows})
        },
        "plants": {
            name: summarize([row for row in rows if row["plant"] == name])
            for name in sorted({str(row["plant"]) for row in rows if row["plant"]})
        },
        "cases": rows,
    }


def judge(truth: Row, folder: Path, held_out: Path) -> Row:
    """What was said of one case beside what is true of it."""
    said = json.loads((folder / "diagnosis.json").read_text())
    hidden, oracle, kind = truth["effects"], truth.get("oracle") or {}, truth["kind"]
    # What every servo has a little of is there, too.
    there = [*([] if kind == "outside" else hidden), *truth.get("nuisances", [])]
    entries = [_entry(given, there) for given in _named(said)]
    first = entries[0] if entries else None
    likely = [entry for entry in entries if entry["probability"] >= LIKELY]
    llr = oracle.get("llr_total", sum(oracle["llr"].values()) if "llr" in oracle else None)
    row: Row = {
        "case": truth["case"],
        "kind": kind,
        "plant": truth.get("plant"),
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
        "iou": _windows(truth, said, held_out) if hidden else [],
        "heldout": _held_out(truth, folder, held_out),
    }
    parts = [entry["component"] for entry in entries[:1] or said.get("mismatch", [])[:1]]
    if hidden:
        row["component_right"] = any(_same(h["component"], p) for h in hidden for p in parts)
    if kind == "single":
        row["group_right"] = bool(first and first["right"])
        row["exact"] = bool(first and first["right"] and first["effect"] == hidden[0]["effect"])
        group = row["oracle_group"]
        placed = bool(first and _same(hidden[0]["component"], first["component"]))
        inside = placed and bool(first and first["effect"] in (group or []))
        row["in_oracle_group"] = inside if group else None
        if row["exact"]:
            row["parameters"] = _parameters(_named(said)[0], hidden[0]["parameters"])
    if kind == "double":
        row |= _both(hidden, likely)
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


def _entry(given: Row, hidden: list[Row]) -> Row:
    group = list(dict.fromkeys([*given.get("group", []), given["effect"]]))
    right = any(_right(group, given["component"], one) for one in hidden)
    kept = {name: given[name] for name in ("effect", "component", "probability")}
    return {**kept, "group": group, "right": right}


def _right(group: list[str], component: str, true: Row) -> bool:
    return true["effect"] in group and _same(true["component"], component)


def _same(true: str, named: str) -> bool:
    return true in SHARED or true == named


def _both(hidden: list[Row], likely: list[Row]) -> Row:
    """Whether each of several effects has an entry of its own, and what F1 needs."""

    def met(order: Sequence[Row]) -> int:
        pairs = zip(order, hidden, strict=False)
        return sum(_right(entry["group"], entry["component"], one) for entry, one in pairs)

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


def detectable(row: Row, by: str = "llr") -> bool:
    """Whether one who knows all would see it, and act on it; True where that was not worked out."""
    return row.get("practical", True) and (row[by] is None or row[by] >= DETECTABLE)


def _failures(row: Row) -> list[str]:
    """What a reader would want to know went wrong."""
    kind, seen, held = row["kind"], detectable(row), row["heldout"] or {}
    eta, sure = held.get("eta"), _sure(row)
    wrong = [
        ("false alarm", kind in NULLS and any(not e["right"] for e in sure)),
        ("flagged", kind in NULLS and row["flagged"] and not sure),
        ("confidently wrong", kind not in NULLS and any(not e["right"] for e in sure)),
        ("missed", kind not in NULLS and seen and not row["flagged"]),
        ("not first", kind == "single" and seen and row["flagged"] and not row["group_right"]),
        ("wrong component", kind == "single" and row["flagged"] and not row["component_right"]),
        ("does not abstain", kind == "outside" and row["flagged"] and not row["abstains"]),
        ("not both", kind == "double" and detectable(row, "llr_least") and not row["both"]),
        ("windows", any(x < 0.5 for x in row["iou"])),
        ("harm", kind in NULLS and bool(held) and held["drop"] < -HARM),
        ("error left", kind == "single" and seen and eta is not None and eta < 0.8),
    ]
    return [name for name, failed in wrong if failed]


def _sure(row: Row) -> list[Row]:
    return [entry for entry in row["entries"] if entry["probability"] >= SURE]


def summarize(rows: list[Row]) -> dict[str, Any]:
    """All numbers of the cases of one tier."""
    kinds = NULLS, ("single",), ("double",), ("outside",)
    nulls, single, double, outside = ([r for r in rows if r["kind"] in kind] for kind in kinds)
    seen = [row for row in single if detectable(row)]
    held = [r for r in seen if r["heldout"]]
    recovered = [r for r in held if r["heldout"]["eta"] is not None]
    fair = [r for r in recovered if r["truth"][0].partition("@")[0] not in CHANCE]
    etas, but_chance = ([r["heldout"]["eta"] for r in some] for some in (recovered, fair))
    harmed = [-r["heldout"]["drop"] for r in nulls if r["heldout"]]
    shown_doubles = [r for r in double if detectable(r, "llr_least")]
    estimates = [p for r in single for p in r.get("parameters", [])]
    stated = [r["in_oracle_group"] for r in seen if r["in_oracle_group"] is not None]
    calibrated, bins = calibration([entry for r in rows for entry in r["entries"]])
    hits, misses = sum(r["found"] for r in double), sum(r["of"] - r["found"] for r in double)
    f1 = hits / (hits + (misses + sum(r["wrong"] for r in double)) / 2) if double else None
    metrics = {
        "false_alarm": share(any(not e["right"] for e in _sure(r)) for r in nulls),
        "nulls_quiet": share(r["verdict"] in NOTHING for r in nulls),
        "nulls_flagged": share(r["flagged"] for r in nulls),
        "detection": share(r["flagged"] for r in seen + [d for d in double if detectable(d)]),
        "detection_all": share(r["flagged"] for r in single + double),
        "outside_flagged": share(r["flagged"] for r in outside),
        "group_first": share(r["group_right"] for r in seen),
        "group_first_all": share(r["group_right"] for r in single),
        "first_in_oracle_group": share(stated),
        "exact_first": share(r["exact"] for r in seen),
        "group_size": plain([len(r["entries"][0]["group"]) for r in seen if r["entries"]]),
        "component": share(r["component_right"] for r in single if r["flagged"]),
        "confident_wrong": share(not entry["right"] for r in rows for entry in _sure(r)),
        **calibrated,
        "outside_abstains": share(r["abstains"] for r in outside),
        "outside_confident_wrong": share(bool(_sure(r)) for r in outside),
        "window_iou": quantile([x for r in rows for x in r["iou"]], 0.5),
        "recovered_median": quantile(etas, 0.5),
        "recovered_p10": quantile(etas, 0.1),
        "recovered_p10_but_chance": quantile(but_chance, 0.1),
        "heldout_drop_median": quantile([r["heldout"]["drop"] for r in held], 0.5),
        "at_noise": share(
            r["heldout"]["enriched"] <= AT_NOISE * r["heldout"]["floor"]
            for r in [*seen, *(d for d in double if detectable(d))]
            if r["heldout"] and r["heldout"]["floor"]
        ),
        "harm": share(change > HARM for change in harmed),
        "harm_mean": plain(harmed),
        "doubles_both": share(r["both"] for r in shown_doubles),
        "doubles_both_all": share(r["both"] for r in double),
        "doubles_f1": {"value": f1, "of": len(double)},
        "parameter_error_median": quantile([p["error"] for p in estimates], 0.5),
        "parameter_covered": share(p["covered"] for p in estimates),
    }
    counts = dict(Counter(row["kind"] for row in rows)) | {"detectable_singles": len(seen)}
    return {"counts": counts, "metrics": metrics, "reliability": bins}


def share(outcomes: Iterable[bool]) -> Row:
    """A share with its 95 % interval (Clopper & Pearson, Biometrika 26 (1934) 404-413)."""
    each = [bool(one) for one in outcomes]
    k, n = sum(each), len(each)
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return {"value": k / n if n else None, "count": k, "of": n, "interval": [low, high]}


def quantile(values: Sequence[float], q: float) -> Row:
    """A quantile, with a distribution-free 95 % interval by order statistics."""
    n, ranked = len(values), np.sort(np.asarray(values, dtype=float))
    if not n:
        return {"value": None, "of": 0, "interval": None}
    ends = np.clip([binom.ppf(0.025, n, q) - 1, binom.ppf(0.975, n, q)], 0, n - 1).astype(int)
    return {"value": float(np.quantile(ranked, q)), "of": n, "interval": ranked[ends].tolist()}


def plain(values: Sequence[float]) -> Row:
    """A mean with no interval."""
    return {"value": float(np.mean(values)) if values else None, "of": len(values)}


def calibration(entries: list[Row]) -> tuple[dict[str, Row], list[Row]]:
    """Expected calibration error, Brier score, and the table behind them."""
    given = [e for e in entries if e["probability"] >= STATED]
    stated = np.array([min(e["probability"], 1.0) for e in given])
    right = np.array([float(e["right"]) for e in given])
    place = np.minimum((stated * 10).astype(int), 9)
    bins = []
    for k in range(10):
        inside = place == k
        bins.append({"low": k / 10, "high": (k + 1) / 10, **share(right[inside] > 0)})
        bins[-1]["stated"] = float(stated[inside].mean()) if inside.any() else None
    gaps = [b["of"] * abs(b["stated"] - b["value"]) for b in bins if b["of"]]
    ece = {"value": sum(gaps) / len(given) if given else None, "of": len(given)}
    return {"ece": ece, "brier": plain(((stated - right) ** 2).tolist())}, bins


def shown(metric: Row, digits: int = 3) -> str:
    """A metric as text: value, count, interval."""
    if metric.get("value") is None:
        return "–"
    counts = f"{metric['count']}/{metric['of']}" if "count" in metric else f"n={metric['of']}"
    ends = metric.get("interval")
    between = f" [{ends[0]:.{digits}f}, {ends[1]:.{digits}f}]" if ends else ""
    return f"{metric['value']:.{digits}f}{between} ({counts})"


def table(rows: list[Row]) -> str:
    """One line a case, as CSV."""
    names = ("tier", "case", "kind", "strength", "llr", "verdict")
    lines = []
    for row in rows:
        line = {name: row[name] for name in names} | (row["heldout"] or {})
        line["truth"] = " ".join(filter(None, row["truth"]))
        said = [(e["group"], e["component"], e["probability"]) for e in row["entries"]]
        line["named"] = " ".join(f"{'|'.join(group)}@{at}:{p:.3f}" for group, at, p in said)
        lines.append(line | {"failures": "; ".join(row["failures"])})
    return pd.DataFrame(lines).to_csv(index=False)


if __name__ == "__main__":
    main()
