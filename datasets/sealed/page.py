"""One page of all results: what was to be reached, what was, and every case that failed.

python datasets/sealed/page.py RESULTS.json... --out PAGE.html
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bars import by_plant, done, set_name
from measures import NULLS, SURE, Row, detectable

from sim2real.output import provenance
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, new_figure, svg
from sim2real.report.page import Block, Figure, Section, Table, Text, write_page


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description="All results on one page.")
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULTS.json")
    parser.add_argument("--out", type=Path, default=Path("reports/missing_physics.html"))
    options = parser.parse_args(arguments)
    found = [json.loads(p.read_text()) for p in options.results]
    sections = [done(found), *(section for one in found if (section := by_plant(one)))]
    for one in found:
        for tier in one["tiers"]:
            rows = [row for row in one["cases"] if row["tier"] == tier]
            sections += _of_tier(set_name(one, tier), one["tiers"][tier], rows)
    sections += [_failures(found), _hashes(found)]
    write_page(
        options.out,
        "Find the missing physics",
        "Sealed cases, graded by script: acceptance thresholds, results, and every failed case.",
        sections,
        provenance(options.results, None),
    )


def _of_tier(label: str, results: Row, rows: list[Row]) -> list[Section]:
    single = [row for row in rows if row["kind"] == "single"]
    outside = [row for row in rows if row["kind"] == "outside"]
    naming: list[Block] = [
        Figure(
            _confusion_figure(confusion(rows)),
            "Rows: what is there. Columns: the first name. A dot's area is its share of the row; "
            "red is wrong.",
        ),
        _effects_table(single, "group_right", "group right"),
    ]
    if outside:
        naming.append(_effects_table(outside, "abstains", "says unlisted"))
    sure: list[Block] = [
        Figure(
            _probability_figure(results["reliability"], single, outside),
            "Left: of the groups named at a probability, the share that is there, with 95 % "
            "intervals. Right: accuracy of the first names if only the surer cases are answered "
            "(detectable single effects and physics outside the catalogue).",
        )
    ]
    return [
        Section(f"Names: {label}", "Which effect was named first.", naming),
        Section(f"Probabilities: {label}", "Whether they mean what they say.", sure),
    ]


def confusion(rows: list[Row]) -> dict[str, dict[str, int]]:
    """First name by what is there; cases with two effects are left out."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        if row["kind"] == "double":
            continue
        true = _name(row) if row["kind"] == "single" else row["kind"]
        named = row["entries"][0]["effect"] if row["entries"] else "unlisted"
        table["nothing" if true in NULLS else true][named if row["flagged"] else "nothing"] += 1
    return {true: dict(said) for true, said in sorted(table.items())}


def risk_coverage(rows: list[Row]) -> list[tuple[float, float]]:
    """Share answered and accuracy, if only first names of at least some probability are given."""
    firsts = [row["entries"][0] for row in rows if row["entries"]]
    points = []
    for least in sorted({round(e["probability"], 3) for e in firsts}, reverse=True):
        right = [e["right"] for e in firsts if round(e["probability"], 3) >= least]
        points.append((len(right) / len(rows), sum(right) / len(right)))
    return points


def _name(row: Row) -> str:
    return str(row["truth"][0]).partition("@")[0]


def _effects_table(rows: list[Row], right: str, heading: str) -> Table:
    kinds: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        kinds[_name(row)].append(row)
    lines = []
    for name, some in sorted(kinds.items()):
        seen = [row for row in some if detectable(row)]
        sure = sum(any(e["probability"] >= SURE and not e["right"] for e in r["entries"])
                   for r in some)  # fmt: skip
        counts = [sum(bool(row[key]) for row in seen) for key in ("flagged", right)]
        lines.append([name, *map(str, [len(some), len(seen), *counts, sure])])
    header = ("", "cases", "detectable", "flagged", heading, "wrong at 0.9")
    return Table(header, lines, "Counts; flagged and right are those of the detectable cases.")


def _confusion_figure(said: Row) -> str:
    rows = sorted(said, key=lambda name: (name in ("nothing", "outside"), name))
    others = {name for counts in said.values() for name in counts} - {"nothing", "unlisted"}
    columns = [*sorted(others | set(rows) - {"nothing", "outside"}), "unlisted", "nothing"]
    with new_figure(110 + 13 * len(rows), "first name by concealed effect") as figure:
        axes = figure.subplots()
        for y, true in enumerate(rows):
            total = sum(said[true].values())
            for name, count in said[true].items():
                right = name == {"outside": "unlisted"}.get(true, true)
                colour, area = INK if right else ACCENT, 70 * count / max(total, 1)
                axes.scatter(columns.index(name), y, s=area, color=colour, linewidths=0)
        axes.set_xticks(range(len(columns)), columns, rotation=90, size=7.5)
        axes.set_xlim(-0.7, len(columns) - 0.3)
        axes.set_yticks(range(len(rows)), rows, size=8)
        axes.set_ylim(len(rows) - 0.4, -0.6)
    return svg(figure)


def _probability_figure(bins: list[Row], single: list[Row], outside: list[Row]) -> str:
    with new_figure(300, "reliability, and accuracy against abstention") as figure:
        left, right = figure.subplots(1, 2)
        left.plot([0, 1], [0, 1], color=FAINT, linewidth=0.8)
        full = [one for one in bins if one["of"]]
        _whiskers(left, [one["stated"] for one in full], full, INK)
        for one in full:
            at = (one["stated"], one["value"])
            left.annotate(str(one["of"]), at, (5, -11), textcoords="offset points", size=8.5,
                          color=MUTED)  # fmt: skip
        points = risk_coverage([row for row in single if detectable(row)] + outside)
        right.plot([p[0] for p in points], [p[1] for p in points], color=INK, linewidth=1.4)
        for axes, title in ((left, "share present, by stated probability"),
                            (right, "accuracy, by share answered")):  # fmt: skip
            axes.set(xlim=(0, 1.03), ylim=(0, 1.03), title=title)
    return svg(figure)


def _whiskers(axes: Any, at: list[float], shares: list[Row], colour: str) -> None:  # noqa: ANN401
    axes.plot(at, [one["value"] for one in shares], "o", color=colour, markersize=4)
    for x, one in zip(at, shares, strict=True):
        axes.plot([x, x], one["interval"], color=colour, linewidth=0.8)


def _failures(found: list[Row]) -> Section:
    lines = []
    for one in found:
        for row in one["cases"]:
            if row["failures"]:
                said = [f"{' | '.join(e['group'])} at {e['component']}, {e['probability']:.2f}"
                        for e in row["entries"]]  # fmt: skip
                llr = "" if row["llr"] is None else f"\nlog-ratio {row['llr']:.0f}"
                true = ", ".join(filter(None, row["truth"])).replace("@", " at ")
                lines.append((
                    f"{row['case'].replace('case_', '')}\n{row['tier']}",
                    (true or "nothing") + ("\n" + row["kind"] + llr.replace("\n", ", ")),
                    row["verdict"] + ("\n" + "; ".join(said) if said else ""),
                    ", ".join(row["failures"]),
                ))  # fmt: skip
    total = sum(len(one["cases"]) for one in found)
    lead = f"{len(lines)} of {total} cases failed in some respect. All of them:"
    return Section(
        "Every failed case", lead, [Table(("case", "concealed", "diagnosis", "failed"), lines)]
    )


def _hashes(found: list[Row]) -> Section:
    blocks: list[Block] = []
    for one in found:
        published = one["hashes"]
        rows = [(name, published[name]) for name in ("answers.json", "recordings")
                if name in published]  # fmt: skip
        rows += [(name, digest) for name, digest in published.get("generator", {}).items()]
        rows.append(("grade.py, as it graded", one["grader"]))
        same = {True: "The answers graded are those published before the run.",
                False: "The answers graded are NOT those published.",
                None: "No hashes were published."}[one["answers_as_published"]]  # fmt: skip
        blocks += [Text(same, one["set"]), Table(("file", "SHA-256"), rows)]
    return Section("Hashes", "Committed before the run.", blocks)


if __name__ == "__main__":
    main()
