"""Read the numbers that decide a verdict or a name off cases of development seeds.

    python datasets/foreign/make_foreign.py SET --seed 22 --no-oracle
    python -m benchmarks.decision_rows SET ROWS.jsonl VERDICTS --processes 16 --seconds 540
    python -m benchmarks.decision_rows SET STEPS.jsonl --steps
    python -m benchmarks.calibrate_decisions ROWS.jsonl... --steps STEPS.jsonl

Writes ``sim2real/diagnose/decision.json`` and ``reports/decisions.json``, the curves that they were
read from. No sealed set is looked at before it is answered. Four logistic curves
(``decision_curves``) say how likely a finding is: an effect, anything missing, something without a
name, an uneven link. A number or a curve with too few cases behind it stays as it was; one that
is a choice ("chosen"), or was read elsewhere, is none that these cases could make, and what is
"kept" was set by hand: values of either sort, those of groups ("change.same_command") included,
stay as they are.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.decision_curves import Curve, Sample, curve, least_sure
from benchmarks.harness import ROOT, command_line, read_lines
from sim2real.diagnose.decision import Odds
from sim2real.effects import CATALOGUE

QUIET = 0.96
"""Share of robots with nothing missing of which nothing must be said."""
MEASURED_WITH = ("structured_excess", "noise_like_excess", "coarse_step_ratio", "most_certain")
"""Numbers by which the rows themselves are measured: with others the curves would not be theirs."""
LARGEST_NUISANCE = 8.0
"""Noise levels up to which a wave in a foreign servo may be one of its nuisances."""

Row = dict[str, Any]
Array = NDArray[np.float64]
Reading = tuple[float, int, str]
"""A value, how many joints it was read off, and how."""

FEWEST = 20
UNFITTED = frozenset(e.name for e in CATALOGUE if not e.fitted)


def main() -> None:
    """Read off and write."""
    measures = "also write the numbers that rows are measured with; examine the cases anew then"
    parser = command_line(
        __doc__, dry=(False, "only say what would be written"), measures=(False, measures),
        steps=(Path, "how finely sensors read, JSON lines"),
    )  # fmt: skip
    parser.add_argument("rows", type=Path, nargs="+", metavar="ROWS.jsonl")
    options = parser.parse_args()
    rows = []
    for k, path in enumerate(options.rows):
        rows += [{**row, "case": f"{k}/{row['case']}"} for row in read_lines(path)]
    steps = read_lines(options.steps) if options.steps else ()
    write(rows, steps, dry=options.dry, measures=options.measures)


def samples(rows: Sequence[Row], negligible: float) -> dict[str, list[Sample]]:
    """For each curve what speaks for its findings, and whether they were so."""
    found: dict[str, list[Sample]] = {"effect": [], "mismatch": [], "uncatalogued": [], "link": []}
    for row in rows:
        truth = set(row["truth"])
        known = truth | set(row.get("always", ()))
        known |= {name for name, x in row["nuisances"].items() if 1 < x < LARGEST_NUISANCE}

        def add(name: str, features: dict[str, float], right: bool, row: Row = row) -> None:
            found[name].append(Sample(row["set"], row["case"], features, right))

        # How likely a name is, given that what is missing has one.
        for group in () if row["outside"] else row["groups"]:
            add("effect", group["features"], bool(known & set(group["members"])))
        matters = row["outside"] or bool(truth - {"encoder_quantization"})
        # What nobody could see, or would act on, is no example of something there.
        right = [g["changes"] for g in row["groups"] if truth & set(g["members"])]
        if not matters or row["outside"] or max(right, default=0.0) >= negligible:
            add("mismatch", row["whole"], matters)
        add("uncatalogued", row["whole"], row["outside"])
        if row["link"]:
            add("link", row["link"]["features"], row["link"]["effect"] in known)
    return found


def _quiet(there: Curve, given: Sequence[Sample], rows: Sequence[Row]) -> tuple[float, int, str]:
    """The probability below which most robots that miss nothing are, by curves of other plants."""
    largest = {row["case"]: 0.0 for row in rows if row["kind"] in ("null", "trap")}
    for p, one in zip(there.predicted, given, strict=True):
        if one.case in largest:
            largest[one.case] = max(largest[one.case], p)
    why = f"{100 * QUIET:g} % of robots that miss nothing, on plants left out, are below"
    return float(np.clip(np.quantile([*largest.values()], QUIET), 0.05, 0.95)), len(largest), why


def _stated(fitted: Curve | None, given: Sequence[Sample], weights: Row) -> tuple[Array, Array]:
    """Probabilities of findings, and whether they were right, by a fitted or a kept curve, (N,)."""
    if fitted is not None:
        return fitted.predicted, fitted.right
    kept = [Odds(weights).probability(one.features) for one in given]
    return np.array(kept), np.array([one.right for one in given], dtype=float)


def write(rows: Sequence[Row], steps: Sequence[Row] = (), *, dry: bool, measures: bool) -> None:
    """Write decision.json and the curves."""
    target = ROOT / "sim2real" / "diagnose" / "decision.json"
    content = json.loads(target.read_text())
    values = content["values"]
    cases = len({row["case"] for row in rows})
    report: Row = {"cases": cases, "joints": len(rows), "odds": {}, "values": {}}
    given = samples(rows, values["negligible"]["value"])
    curves = {name: curve(some) for name, some in given.items()}
    for name, fitted in curves.items():
        n = len(given[name])
        if fitted is None:
            report["odds"][name] = {"samples": n, "kept": True}
            continue
        content["odds"][name], report["odds"][name] = fitted.weights, fitted.report()
        content["odds_from"][name] = (
            f"logistic curve of {n} samples, {fitted.right.sum():.0f} true, of {cases} cases,"
            " straightened on plants left out"
        )
    read_off = values_of(rows) | of_sensors(steps or rows)
    there = curves["mismatch"]
    if there is not None:
        read_off["mismatch_probability"] = _quiet(there, given["mismatch"], rows)
    names = [_stated(curves[k], given[k], content["odds"][k]) for k in ("effect", "link")]
    level = least_sure([p for p, _ in names], [right for _, right in names])
    if level is not None:
        n = sum(right.size for _, right in names)
        read_off["min_certain_probability"] = (
            level,
            n,
            "98.5 % of the findings stated with more are right on plants left out",
        )
    for name, (value, n, why) in read_off.items():
        before = values[name]["value"]
        report["values"][name] = {"before": before, "value": value, "count": n, "how": why}
        if name in MEASURED_WITH and not measures:
            continue
        read = {"value": float(f"{value:.3g}"), "from": f"{why}; {n} of {len(rows)} joints"}
        values[name] |= read
    content["made_by"], content["cases"] = "benchmarks/calibrate_decisions.py", cases
    order = ("schema", "made_by", "cases", "values", "odds", "odds_from")
    if not dry:
        target.write_text(json.dumps({key: content[key] for key in order}, indent=1) + "\n")
        (ROOT / "reports" / "decisions.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    print(json.dumps(content["odds"], indent=1))


def values_of(rows: Sequence[Row]) -> dict[str, Reading]:
    """Numbers that are quantiles of what was measured where nothing is missing."""
    nothing = [row for row in rows if row["kind"] in ("null", "trap")]
    excess = [row["excess_plain"] for row in nothing]
    found = {}
    if len(excess) >= FEWEST:
        found["structured_excess"] = (
            max(float(np.quantile(excess, 0.99)), 1.05), len(excess),
            "99 % of joints that miss nothing leave less",
        )  # fmt: skip
        found["noise_like_excess"] = (
            max(float(np.quantile(excess, 0.9)), 1.02), len(excess),
            "90 % of joints that miss nothing leave less",
        )  # fmt: skip
    return found | _of_gains(rows)


def of_sensors(rows: Sequence[Row]) -> dict[str, Reading]:
    """From which step on a sensor is coarser than stated, and how sure that is."""
    coarse = [row["step"] for row in rows if "encoder_quantization" in row["truth"]]
    fine = [row["step"] for row in rows if "encoder_quantization" not in row["truth"]]
    if len(coarse) < FEWEST / 4:
        return {}
    middle = np.sqrt(float(np.quantile(fine, 0.995)) * float(np.quantile(coarse, 0.02)))
    level = float(np.clip(middle, 1.2, 3.0))
    right, wrong = sum(x > level for x in coarse), sum(x > level for x in fine)
    why = f"{right} of {right + wrong} found are there; the rule of succession"
    return {
        "coarse_step_ratio": (level, len(coarse), "between sensors as stated and coarser"),
        "most_certain": ((right + 1) / (right + wrong + 2), right + wrong, why),
    }


def _of_gains(rows: Sequence[Row]) -> dict[str, Reading]:
    """The gain at which half of the effects that are there alone are named."""
    seen = [
        (row["alone"].get(effect, 0.0), any(effect in m and p >= 0.5 for m, p in row["said"]))
        for row in rows if row["kind"] == "single" and "alone" in row for effect in row["truth"]
        if effect not in UNFITTED
    ]  # fmt: skip
    y = np.array([named for _, named in seen], dtype=float)
    if min(y.sum(), (1 - y).sum()) < FEWEST / 2:
        return {}
    gain = np.log1p(np.maximum([g for g, _ in seen], 0.0))
    # Where most that gain less are not named and most that gain more are.
    order = np.argsort(gain)
    wrong = np.cumsum(np.append(0, y[order])) + np.cumsum(np.append(0, 1 - y[order][::-1]))[::-1]
    edges = np.concatenate([gain[order][:1], gain[order]])
    half = float(np.expm1(edges[int(wrong.argmin())]))
    return {"detection_gain": (half, y.size, "half of the single effects that gain this are named")}


if __name__ == "__main__":
    main()
