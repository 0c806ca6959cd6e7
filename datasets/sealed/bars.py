"""What was to be reached in each tier, and what was."""

from __future__ import annotations

from measures import Row

from sim2real.report.page import Section, Table

ONE_CASE = -1.0
"""Stands for a bar of at most one case."""
TIERS = {
    "T1": "simulated",
    "T2": "injected into real recordings",
    "T3": "real changes",
    "T1'": "independent simulators",
    "T4": "swims",
}
BARS: tuple[tuple[str, str, str, tuple[float | None, ...]], ...] = (
    ("False positives at probability 0.9", "false_alarm", "≤", (0.01, 0.02, ONE_CASE, 0.01, 0.02)),
    ("Detectable effects flagged", "detection", "≥", (0.98, 0.95, 0.90, 0.96, 0.95)),
    ("True effect in the first group", "group_first", "≥", (0.95, 0.70, 0.80, 0.93, 0.90)),
    ("True effect ranked first", "exact_first", "≥", (0.88, 0.80, None, None, None)),
    ("Correct component", "component", "≥", (0.98, 0.95, 0.90, None, None)),
    ("False discoveries at probability 0.9", "confident_wrong", "≤",
     (0.01, 0.05, ONE_CASE, 0.02, 0.03)),
    ("Expected calibration error", "ece", "≤", (0.05, 0.07, None, 0.05, 0.07)),
    ("Abstains where the catalogue lacks the effect", "outside_abstains", "≥",
     (0.90, 0.85, None, 0.88, 0.85)),
    ("Windows: intersection over union, median", "window_iou", "≥", (0.80, 0.75, 0.75, None, None)),
    ("Recoverable error removed, median", "recovered_median", "≥", (0.95, 0.90, None, None, None)),
    ("Held-out error removed, median", "heldout_drop_median", "≥", (None, None, 0.25, None, None)),
    ("Null cases whose held-out error grows by over 1 %", "harm", "≤",
     (0.01, 0.01, None, None, 0.02)),
    ("Cases whose held-out error does not grow by over 1 %", "no_worse", "≥",
     (None, None, None, None, 0.98)),
    ("Null cases with the verdict consistent", "nulls_quiet", "≥", (None, 0.90, 0.90, 0.95, None)),
    ("Held-out error at the noise (within 10 %, of swims 50 %)", "at_noise", "≥",
     (None, None, None, 0.95, 0.80)),
    ("Both of two effects named", "doubles_both", "≥", (0.80, 0.50, None, 0.80, 0.75)),
    ("Coverage of the 90 % intervals", "parameter_covered", "≥", (None, None, None, None, 0.80)),
)  # fmt: skip
"""What is measured, and the bars of the tiers, of T2 and T3 from the third sets on; None is only
reported. In T2 what counts as detectable is what an oracle could see."""
SINCE_SIXTH = {
    "detection": 0.97, "group_first": 0.94, "outside_abstains": 0.90, "at_noise": 0.92,
    "doubles_both": 0.85,
}  # fmt: skip
BARS_OF_SET = dict.fromkeys(("sixth", "seventh", "eighth"), SINCE_SIXTH)
"""Bars of a set by itself, where they differ from those of its tier."""
ALSO = (
    ("Null cases with another verdict", "nulls_flagged"),
    ("Flagged, undetectable effects included", "detection_all"),
    ("True effect in the first group, undetectable included", "group_first_all"),
    ("First name in the oracle's group", "first_in_oracle_group"),
    ("Mean size of the first group", "group_size"),
    ("Brier score", "brier"),
    ("Outside the catalogue: a name at 0.9", "outside_confident_wrong"),
    ("Recoverable error removed, tenth percentile", "recovered_p10"),
    ("The same without jitter and packet loss", "recovered_p10_but_chance"),
    ("Null cases: mean change of the held-out error", "harm_mean"),
    ("Both of two effects named, undetectable included", "doubles_both_all"),
    ("Two effects: F1", "doubles_f1"),
    ("Parameters of exact names: median relative error", "parameter_error_median"),
)
IN_FULL = ("window_iou", "recovered_median", "recovered_p10", "recovered_p10_but_chance")
WEAKEST_PLANT = 0.9
"""What a plant must reach, relative to the mean of all."""
BY_PLANT = (
    "false_alarm", "nulls_quiet", "detection", "group_first", "confident_wrong", "ece",
    "outside_abstains", "at_noise", "doubles_both",
)  # fmt: skip
"""Measures that are shown for each plant."""


def done(found: list[Row]) -> Section:
    """All sets side by side, a row a measure."""
    header, columns, captions = [""], [], []
    for one in found:
        for tier, results in one["tiers"].items():
            header.append(f"{set_name(one, tier)}\n{TIERS.get(tier, tier)}")
            columns.append((tier, results["metrics"], BARS_OF_SET.get(str(one["set"]), {})))
            cases = ", ".join(f"{n} {kind}" for kind, n in results["counts"].items())
            captions.append(f"{set_name(one, tier)}: {cases.replace('_', ' ')}.")
    rows = [(bar[0], *(_against(*bar[1:], *column) for column in columns)) for bar in BARS]
    also = [
        (label, *(_plain(metrics[name], name) for _, metrics, _ in columns)) for label, name in ALSO
    ]
    cells = [cell.partition("\n")[0] for row in rows for cell in row[1:]]
    met, missed = (sum(cell.startswith(start) for cell in cells) for start in ("met", "MISSED"))
    lead = f"{met} of {met + missed} bars are met" + (f", {missed} missed." if missed else ".")
    every = [h.partition("\n")[0] for h, (_, m, _) in zip(header[1:], columns, strict=True)
             if m["nulls_flagged"]["value"] == 1]  # fmt: skip
    if every:
        captions.append(
            f"In {' and '.join(every)} all null cases were flagged as well: flagging means little."
        )
    captions.append("Intervals are 95 %; of shares by Clopper and Pearson.")
    tables = [Table(header, rows, " ".join(captions)), Table(["Also measured", *header[1:]], also)]
    return Section("Done when", lead, tables)


def by_plant(one: Row) -> Section | None:
    """The plants of a set side by side; None where it has one."""
    plants = one.get("plants") or {}
    if len(plants) < 2:
        return None
    labels = {name: label for label, name, *_ in BARS}
    rows, weak = [], []
    for name in BY_PLANT:
        metrics = [plants[plant]["metrics"][name] for plant in plants]
        rows.append((labels[name], *(_plain(metric, name) for metric in metrics)))
        known = [m["value"] for m in metrics if m["value"] is not None]
        higher = {bar[1]: bar[2] for bar in BARS}[name] == "≥"
        if higher and known and min(known) < WEAKEST_PLANT * sum(known) / len(known):
            weak.append(labels[name].lower())
    said = f" Below {WEAKEST_PLANT:g} of the mean: {', '.join(weak)}." if weak else ""
    title = f"By plant: {set_name(one, next(iter(one['tiers'])))}"
    return Section(title, f"Each plant by itself.{said}", [Table(["", *plants], rows)])


def set_name(one: Row, tier: str) -> str:
    """As the page calls the cases of a tier in a set."""
    name = str(one["set"]).replace("_", " ")
    return name if name.startswith(tier) else f"{tier}, {name}"


def _against(
    name: str,
    relation: str,
    bars: tuple[float | None, ...],
    tier: str,
    metrics: Row,
    of_set: dict[str, float],
) -> str:
    """A cell: what was measured and whether that is enough; below it bar, interval and counts."""
    bar = of_set.get(name, bars[list(TIERS).index(tier) if tier in TIERS else 0])
    metric = metrics.get(name, {"value": None})  # of results from before it was measured
    first, _, below = value(metric, name).partition("\n")
    if metric.get("value") is None:
        return "–" if bar is None else f"–\nbar {_bar_text(name, relation, bar)}; {first}"
    if bar is None:
        return f"{first}\nno bar; {below}"
    verdict = "met" if _reached(name, relation, bar, metric) else "MISSED"
    return f"{verdict}, {first}\nbar {_bar_text(name, relation, bar)}; {below}"


def _plain(metric: Row, name: str) -> str:
    return "–" if metric.get("value") is None else value(metric, name)


def _reached(name: str, relation: str, bar: float, metric: Row) -> bool:
    if bar == ONE_CASE:
        return bool(metric["count"] <= 1)
    if name == "heldout_drop_median" and not metric["interval"][0] > 0:
        return False  # the interval must exclude 0, too
    return bool(metric["value"] <= bar if relation == "≤" else metric["value"] >= bar)


def _bar_text(name: str, relation: str, bar: float) -> str:
    if bar == ONE_CASE:
        return "≤ 1 case"
    decimal = name in IN_FULL or name == "ece"
    return f"{relation} {bar:.2f}" if decimal else f"{relation} {100 * bar:.0f} %"


def value(metric: Row, name: str = "") -> str:
    """A metric as a cell: its value, and below it interval and counts."""
    if metric.get("value") is None:
        return "not measured"
    counted = "count" in metric
    percent = counted or name in ("heldout_drop_median", "harm_mean", "parameter_error_median")
    factor, digits, unit = (100, 1, " %") if percent else (1, 3, "")
    ends = metric.get("interval")
    text = f"{factor * metric['value']:.{digits}f}{unit}\n"
    if ends:
        text += f"{factor * ends[0]:.{digits}f} to {factor * ends[1]:.{digits}f}{unit}, "
    return text + (f"{metric['count']} of {metric['of']}" if counted else f"n = {metric['of']}")
