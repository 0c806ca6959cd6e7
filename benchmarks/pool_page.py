"""The page of the sealed swims: what was to be reached, what was, and every case that failed.

    python benchmarks/pool_page.py RESULTS.json [--rivals REGRESSION.json DRAGS.json]
        [--before RESULTS.json] [--out reports/pool_diagnosis]

Writes ``sealed.md``, which the report's README takes in between its marks.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]
GRADER = Path(__file__).parents[1] / "datasets/pool/sealed_grade.py"
MARKS = "<!-- sealed set: begin -->", "<!-- sealed set: end -->"


def bars() -> Sequence[tuple[str, str, str, float]]:
    """Of the grader."""
    spec = importlib.util.spec_from_file_location("sealed_grade", GRADER)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["sealed_grade"] = module
    spec.loader.exec_module(module)
    return module.BARS  # type: ignore[no-any-return]


def cell(metric: Row | None) -> str:
    """A measure with its interval and counts."""
    if metric is None or metric.get("value") is None:
        return "-"
    if "count" in metric:
        low, high = metric["interval"]
        share = f"{100 * metric['value']:.0f} %"
        return (
            f"{share} ({metric['count']} of {metric['of']}; {100 * low:.0f} to {100 * high:.0f} %)"
        )
    return f"{metric['value']:.3f}"


def met(name: str, relation: str, bar: float, metric: Row) -> str:
    """Whether a bar is met."""
    value = metric.get("value")
    if value is None:
        return "-"
    if name == "parameter_covered":
        return "met" if 0.80 <= value <= 0.97 else "**missed**"
    good = value <= bar if relation == "<=" else value >= bar
    return "met" if good else "**missed**"


def table(columns: list[tuple[str, Row]]) -> list[str]:
    """Bars, and what the sealed set and others say."""
    lines = ["| | bar | " + " | ".join(name for name, _ in columns) + " |",
             "|---|---|" + "---|" * len(columns)]  # fmt: skip
    for label, name, relation, bar in bars():
        shown = relation if name == "parameter_covered" else (
            f"{'at most' if relation == '<=' else 'at least'} "
            + (f"{bar:g}" if name == "ece" else f"{100 * bar:.0f} %"))  # fmt: skip
        cells = [cell(r["results"]["metrics"].get(name)) for _, r in columns]
        first = met(name, relation, bar, columns[0][1]["results"]["metrics"][name])
        cells[0] = f"{first}: {cells[0]}"
        lines.append(f"| {label} | {shown} | " + " | ".join(cells) + " |")
    return lines


ALSO = (
    ("Nulls that are flagged", "nulls_flagged"),
    ("Flagged, the undetectable too", "detection_all"),
    ("Right group first, of those flagged", "group_first_of_flagged"),
    ("First name exactly right", "exact_first"),
    ("Mean size of the first group", "group_size"),
    ("One of two", "doubles_one"),
    ("Outside: flagged", "outside_flagged"),
    ("Outside: a name at 0.9", "outside_confident_wrong"),
    ("Enriched error over the camera's noise, median", "enriched_over_noise"),
    ("Seconds of one core a case, median", "cpu_s"),
)


def failures(results: Row) -> list[str]:
    """Every case in which something went wrong."""
    lines = ["| case | kind | concealed (strength) | oracle | diagnosis | held out, m/s | wrong |",
             "|---|---|---|---:|---|---|---|"]  # fmt: skip
    for row in results["cases"]:
        if not row["failures"]:
            continue
        hidden = ", ".join(
            t.replace("@body", "").replace("@camera", "") + (f" ({s:.2f})" if s else "")
            for t, s in zip(row["truth"], row["strength"], strict=True)
        )
        said = "; ".join(
            f"{' or '.join(e['group'])} {e['probability']:.2f}" for e in row["entries"]
        )
        held = row["heldout"]
        errors = f"{held['base']:.3f} to {held['enriched']:.3f}" if held else "not swum"
        lines.append(
            f"| {row['case'].removeprefix('case_')} | {row['kind']} | {hidden or '-'} | "
            f"{row['llr']:.0f} | {row['verdict'].replace('_', ' ')}{': ' + said if said else ''} | "
            f"{errors} | {', '.join(row['failures'])} |"
        )
    return lines


def main() -> None:
    """Write the part of the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("--rivals", type=Path, nargs=2)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--out", type=Path, default=Path("reports/pool_diagnosis"))
    options = parser.parse_args()
    results = json.loads(options.results.read_text())
    columns = [("sealed", results)]
    if options.before:
        columns.append(("set before", json.loads(options.before.read_text())))
    for name, path in zip(("regression", "all drags"), options.rivals or (), strict=False):
        columns.append((name, json.loads(path.read_text())))
    found = results["results"]
    lines = [*table(columns), "", "| also measured | " + " | ".join(n for n, _ in columns) + " |",
             "|---|" + "---|" * len(columns)]  # fmt: skip
    for label, name in ALSO:
        cells = [cell(r["results"]["metrics"].get(name)) for _, r in columns]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    counts = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in found["counts"].items())
    by = ", ".join(
        f"{k.replace('@body', '').replace('@camera', '')} {v}"
        for k, v in found["by_effect"].items()
    )
    lines += ["", f"Cases: {counts}. Right group first, of those detectable, by effect: {by}.", "",
              "### Every case that failed", "", *failures(results)]  # fmt: skip
    page = options.out / "README.md"
    text = page.read_text()
    begin, end = (text.index(mark) for mark in MARKS)
    page.write_text(text[: begin + len(MARKS[0])] + "\n" + "\n".join(lines) + "\n" + text[end:])
    print(page)


if __name__ == "__main__":
    main()
