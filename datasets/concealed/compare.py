"""Two gradings of the same cases side by side, each difference with its interval.

python datasets/concealed/compare.py BEFORE.json AFTER.json

Cases that both answered are drawn anew, the same for both (a paired bootstrap: Efron, Tibshirani,
An Introduction to the Bootstrap, Chapman & Hall 1993, section 8.3); the interval holds 95 % of the
differences. A measure is worse where its whole interval is on the wrong side of 0.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from grade import summarize

DRAWS = 400
SMALLER_IS_BETTER = frozenset(
    ("false_alarm", "nulls_flagged", "group_size", "confident_wrong", "ece", "brier",
     "outside_confident_wrong", "harm", "harm_mean", "parameter_error_median")
)  # fmt: skip


def main() -> None:
    """Print a table, a row a measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    options = parser.parse_args()
    one, other = (
        {row["case"]: row for row in json.loads(path.read_text())["cases"]}
        for path in (options.before, options.after)
    )
    names = sorted(one.keys() & other.keys())
    rng = np.random.default_rng(0)
    usual = [_measures([rows[name] for name in names]) for rows in (one, other)]
    drawn: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        some = rng.choice(names, len(names))
        first, second = (_measures([rows[name] for name in some]) for rows in (one, other))
        for name in first.keys() & second.keys():
            drawn.setdefault(name, []).append(second[name] - first[name])
    print(f"{len(names)} cases\n\n| | before | after | difference | |\n|---|---|---|---|---|")
    for name, value in usual[0].items():
        if name in usual[1] and drawn.get(name):
            low, high = np.quantile(drawn[name], (0.025, 0.975))
            worse = low > 0 if name in SMALLER_IS_BETTER else high < 0
            change = f"{usual[1][name] - value:+.3f} ({low:+.3f} to {high:+.3f})"
            told = "worse" if worse else ""
            print(f"| {name} | {value:.3f} | {usual[1][name]:.3f} | {change} | {told} |")


def _measures(rows: list[dict[str, object]]) -> dict[str, float]:
    found = summarize(rows)["metrics"]
    return {name: x["value"] for name, x in found.items() if x["value"] is not None}


if __name__ == "__main__":
    main()
