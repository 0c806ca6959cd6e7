"""Read the numbers that decide a verdict or a name off cases of development seeds.

    python datasets/foreign/make_foreign.py SET --seed 22 --no-oracle
    python -m benchmarks.decision_rows SET ROWS.jsonl VERDICTS --processes 16 --seconds 540
    python -m benchmarks.calibrate_decisions ROWS.jsonl...

Writes ``sim2real/diagnose/decision.json`` and ``reports/decisions.json``, the curves that they were
read from, and how many decisions turn on the numbers that are not read off. No sealed set is looked
at. Four logistic curves say how likely a finding is: an effect, anything missing, something without
a name, an uneven link. Their weights have a normal prior about 0, whose spread is the one that
foretells cases left out best. A number with fewer cases behind it than ``FEWEST`` stays as it was,
and says so; one that is a choice ("chosen") is none that data could make, and what is "kept" was
set by hand.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.decision_rows import read
from benchmarks.decision_sensitivity import sensitivity
from benchmarks.decision_values import values_of

ROOT = Path(__file__).resolve().parents[1]
FEWEST = 20
FOLDS = 10
SPREADS = (0.15, 0.3, 0.6, 1.2, 2.4)
QUIET = 0.985
"""Share of joints with nothing missing of which nothing must be said."""
LARGEST_NUISANCE = 8.0
"""Noise levels up to which a wave in a foreign servo may be one of its nuisances."""

Row = dict[str, Any]
Array = NDArray[np.float64]


def main() -> None:
    """Read off and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", type=Path, nargs="+", metavar="ROWS.jsonl")
    parser.add_argument("--dry", action="store_true", help="only say what would be written")
    options = parser.parse_args()
    rows = []
    for k, path in enumerate(options.rows):
        rows += [{**row, "case": f"{k}/{row['case']}"} for row in read(path)]
    write(rows, dry=options.dry)


def samples(rows: Sequence[Row], negligible: float) -> dict[str, list[tuple[str, Row, bool]]]:
    """For each curve the case, what speaks for it and whether it was so."""
    found: dict[str, list[tuple[str, Row, bool]]] = {
        "effect": [], "there": [], "nameless": [], "link": [],
    }  # fmt: skip
    for row in rows:
        case, truth = row["case"], set(row["truth"])
        known = truth | {name for name, x in row["nuisances"].items() if 1 < x < LARGEST_NUISANCE}
        for group in row["groups"]:
            found["effect"].append((case, group["features"], bool(known & set(group["members"]))))
        matters = row["outside"] or bool(truth - {"encoder_quantization"})
        # What nobody could see, or would act on, is no example of something there.
        right = [g["changes"] for g in row["groups"] if truth & set(g["members"])]
        unseen = matters and not row["outside"] and max(right, default=0.0) < negligible
        if not unseen:
            found["there"].append((case, row["whole"], matters))
        found["nameless"].append((case, row["whole"], row["outside"]))
        if row["link"]:
            right = row["link"]["effect"] in truth
            found["link"].append((case, row["link"]["features"], right))
    return found


def matrix(given: Sequence[tuple[str, Row, bool]]) -> tuple[list[str], Array, Array, Array]:
    """Features' names, their values, whether it was so, and the fold of each case."""
    names = sorted({name for _, features, _ in given for name in features})
    names.sort(key=lambda name: name != "one")
    x = np.array([[features.get(name, 0.0) for name in names] for _, features, _ in given])
    y = np.array([right for _, _, right in given], dtype=float)
    cases = sorted({case for case, _, _ in given})
    place = {case: k % FOLDS for k, case in enumerate(np.random.default_rng(0).permutation(cases))}
    return names, x, y, np.array([place[case] for case, _, _ in given])


def logistic(x: Array, y: Array, spread: float) -> Array:
    """Weights of the likeliest curve with a normal prior; the first, of 1, is free (Newton)."""
    scale = np.maximum(x.std(axis=0), 1e-3)
    scale[0] = 1.0
    z = x / scale
    # An effect's own offset stands for few cases: its scale is 1.
    prior = np.full(x.shape[1], spread**-2)
    prior[0] = 1e-4
    w = np.zeros(x.shape[1])
    for _ in range(40):
        p = 1 / (1 + np.exp(-np.clip(z @ w, -30, 30)))
        slope = z.T @ (y - p) - prior * w
        curve = (z * np.maximum(p * (1 - p), 1e-6)[:, None]).T @ z + np.diag(prior)
        step = np.linalg.solve(curve, slope)
        w = w + step * min(1.0, 4.0 / max(float(np.abs(step).max()), 1e-9))
        if np.abs(step).max() < 1e-8:
            break
    return np.asarray(w / scale)


def foretold(x: Array, y: Array, fold: Array, spread: float) -> Array:
    """Probability of each sample by the curve of the other folds."""
    p = np.zeros(y.size)
    for k in range(FOLDS):
        out = fold == k
        if out.any() and (~out).any():
            w = logistic(x[~out], y[~out], spread)
            p[out] = 1 / (1 + np.exp(-np.clip(x[out] @ w, -30, 30)))
    return p


def loss(p: Array, y: Array) -> float:
    """Mean of minus the logarithm of the probability of what was so."""
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return float(-np.mean(y * np.log(p) + (1 - y) * np.log(1 - p)))


def curve(given: Sequence[tuple[str, Row, bool]]) -> tuple[dict[str, float], Row] | None:
    """Weights by feature, and how they do on cases left out; None where the cases are too few."""
    names, x, y, fold = matrix(given)
    if min(y.sum(), (1 - y).sum()) < FEWEST / 2:
        return None
    tried = {spread: foretold(x, y, fold, spread) for spread in SPREADS}
    best = min(tried, key=lambda spread: loss(tried[spread], y))
    p, weights = tried[best], logistic(x, y, best)
    place = np.minimum((p * 10).astype(int), 9)
    bins = [
        {"stated": float(p[place == k].mean()), "true": float(y[place == k].mean()),
         "of": int((place == k).sum())}
        for k in range(10) if (place == k).any()
    ]  # fmt: skip
    sure = p >= 0.9
    report = {
        "samples": int(y.size),
        "true": int(y.sum()),
        "spread": best,
        "loss": {str(s): loss(q, y) for s, q in tried.items()},
        "left_out": bins,
        "calibration_error": float(
            sum(b["of"] * abs(b["stated"] - b["true"]) for b in bins) / y.size
        ),
        "at_0.9": {"of": int(sure.sum()), "wrong": int((1 - y[sure]).sum())},
    }
    return {n: float(f"{w:.4g}") for n, w in zip(names, weights, strict=True)}, report


def write(rows: Sequence[Row], *, dry: bool) -> None:
    """Write decision.json and the curves."""
    target = ROOT / "sim2real" / "diagnose" / "decision.json"
    content = json.loads(target.read_text())
    values = content["values"]
    cases = len({row["case"] for row in rows})
    report: Row = {"cases": cases, "joints": len(rows), "odds": {}, "values": {}}
    given = samples(rows, values["negligible"]["value"])
    for name, some in given.items():
        found = curve(some) if some else None
        if found is None:
            report["odds"][name] = {"samples": len(some), "kept": True}
            content["odds_from"][name] = f"kept, set by hand: {len(some)} samples say too little"
            continue
        content["odds"][name], report["odds"][name] = found
        how = found[1]
        content["odds_from"][name] = (
            f"logistic curve of {how['samples']} samples, {how['true']} true, of {cases} cases"
        )
    weights = content["odds"]["there"]
    quiet = [
        1 / (1 + np.exp(-sum(weights.get(n, 0.0) * v for n, v in features.items())))
        for row in rows if row["kind"] in ("null", "trap") for features in (row["whole"],)
    ]  # fmt: skip
    read_off = values_of(rows)
    if len(quiet) >= FEWEST:
        level = float(np.clip(np.quantile(quiet, QUIET), 0.5, 0.95))
        why = f"{100 * QUIET:g} % of joints that miss nothing are below"
        read_off["there"] = (level, len(quiet), why)
    for name, (value, n, why) in read_off.items():
        before = values[name]["value"]
        values[name] = {"value": float(f"{value:.3g}"), "from": f"{why}; {n} of {len(rows)} joints"}
        report["values"][name] = {"before": before, "value": value, "count": n, "how": why}
    known = {name: entry["value"] for name, entry in values.items()}
    report["sensitivity"] = sensitivity(rows, known, content["odds"])
    content["made_by"], content["cases"] = "benchmarks/calibrate_decisions.py", cases
    order = ("schema", "made_by", "cases", "values", "odds", "odds_from")
    if not dry:
        target.write_text(json.dumps({key: content[key] for key in order}, indent=1) + "\n")
        (ROOT / "reports" / "decisions.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    print(json.dumps(content["odds"], indent=1))


if __name__ == "__main__":
    main()
