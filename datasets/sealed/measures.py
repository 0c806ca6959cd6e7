"""The measures of graded cases: shares with their intervals, calibration, held-out errors."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta, binom

Row = dict[str, Any]

DETECTABLE = 10.0
"""Log-likelihood ratio from which on what is hidden ought to be found."""
SURE, LIKELY, STATED = 0.9, 0.5, 0.05
"""Probabilities: claimed; named at all; counted in the calibration."""
CHANCE = ("latency_jitter", "packet_loss")
"""Effects whose dice nobody can predict on another recording."""
HARM = 0.01
"""Share by which a held-out error may grow."""
AT_NOISE = (1.1, 1.5)
"""Held-out error over its floor up to which it is at the noise, of servos and of swims."""
NULLS = ("null", "trap")
NOTHING = ("consistent", "unchanged")
SWIMS = "T4"
"""The tier of swims."""


def detectable(row: Row, by: str = "llr") -> bool:
    """Whether one who knows all would see it, and act on it; True where that was not worked out."""
    return row.get("practical", True) and (row[by] is None or row[by] >= DETECTABLE)


def sure_of(row: Row) -> list[Row]:
    """What was named at the probability of a claim."""
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
    estimates = [p for r in rows for p in r["parameters"]]
    stated = [r["in_oracle_group"] for r in seen if r["in_oracle_group"] is not None]
    calibrated, bins = calibration([entry for r in rows for entry in r["entries"]])
    hits, misses = sum(r["found"] for r in double), sum(r["of"] - r["found"] for r in double)
    f1 = hits / (hits + (misses + sum(r["wrong"] for r in double)) / 2) if double else None
    metrics = {
        "false_alarm": share(any(not e["right"] for e in sure_of(r)) for r in nulls),
        "nulls_quiet": share(r["verdict"] in NOTHING for r in nulls),
        "nulls_flagged": share(r["flagged"] for r in nulls),
        "detection": share(r["flagged"] for r in seen + [d for d in double if detectable(d)]),
        "detection_all": share(r["flagged"] for r in single + double),
        "outside_flagged": share(r["flagged"] for r in outside),
        "group_first": share(r["group_right"] for r in seen),
        "group_first_of_flagged": share(r["group_right"] for r in seen if r["flagged"]),
        "group_first_all": share(r["group_right"] for r in single),
        "first_in_oracle_group": share(stated),
        "exact_first": share(r["exact"] for r in seen),
        "group_size": plain([len(r["entries"][0]["group"]) for r in seen if r["entries"]]),
        "component": share(r["component_right"] for r in single if r["flagged"]),
        "confident_wrong": share(not entry["right"] for r in rows for entry in sure_of(r)),
        **calibrated,
        "outside_abstains": share(r["abstains"] for r in outside),
        "outside_confident_wrong": share(bool(sure_of(r)) for r in outside),
        "window_iou": quantile([x for r in rows for x in r["iou"]], 0.5),
        "recovered_median": quantile(etas, 0.5),
        "recovered_p10": quantile(etas, 0.1),
        "recovered_p10_but_chance": quantile(but_chance, 0.1),
        "heldout_drop_median": quantile([r["heldout"]["drop"] for r in held], 0.5),
        "at_noise": share(
            r["heldout"]["enriched"] <= AT_NOISE[r["tier"] == SWIMS] * r["heldout"]["floor"]
            for r in single + double
            if (detectable(r) or r["tier"] == SWIMS) and (r["heldout"] or {}).get("floor")
        ),
        "no_worse": share(r["heldout"]["drop"] >= -HARM for r in rows if r["heldout"]),
        "harm": share(change > HARM for change in harmed),
        "harm_mean": plain(harmed),
        "doubles_both": share(r["both"] for r in shown_doubles),
        "doubles_both_all": share(r["both"] for r in double),
        "doubles_one": share(r["found"] >= 1 for r in shown_doubles),
        "doubles_f1": {"value": f1, "of": len(double)},
        "parameter_error_median": quantile([p["error"] for p in estimates], 0.5),
        "parameter_covered": share(p["covered"] for p in estimates),
        "wall_s": quantile([r["cost"]["wall_s"] for r in rows if r["cost"]], 0.5),
        "cpu_s": quantile([r["cost"]["cpu_s"] for r in rows if r["cost"]], 0.5),
    }
    counts = dict(Counter(row["kind"] for row in rows)) | {"detectable_singles": len(seen)}
    by_effect: dict[str, list[bool]] = defaultdict(list)
    for r in seen:
        by_effect[r["truth"][0].partition("@")[0]].append(r["group_right"])
    found = {name: f"{sum(right)}/{len(right)}" for name, right in sorted(by_effect.items())}
    return {"counts": counts, "metrics": metrics, "reliability": bins, "by_effect": found}


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
