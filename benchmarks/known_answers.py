"""Servos whose answer is known, diagnosed: writes the page ``reports/known_answers``.

    python -m benchmarks.known_answers                   # cases not answered yet, then the page
    python -m benchmarks.known_answers --only missing/emps --again --shared FOLDER

Each case of ``known_answers.toml`` is one call of ``sim2real.diagnose`` and one of ``identify`` on
some recordings, and a ``predict`` of a motion that neither has seen; then it is compared with what
is known. Answers and drawings are kept in ``build/known_answers``, the numbers of the page, without
samples of a recording, in ``reports/known_answers``. A case whose folder is absent is skipped.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import REAL, ROOT, command_line, table
from benchmarks.real_servos import emps_drive
from benchmarks.yardstick import rounded
from sim2real import diagnose, identify, predict
from sim2real.arrays import Array, Mask
from sim2real.errors import InputError
from sim2real.output import provenance, write_json, write_whole
from sim2real.readings import wrong_readings
from sim2real.recording import Recording, read_commands, read_recording
from sim2real.report.diagnosis_plots import plain, sure
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, RULE, new_figure, svg
from sim2real.report.page import Figure, Note, Section, Table, write_page
from sim2real.units import readable, readable_name

REPORT = ROOT / "reports" / "known_answers"
DRAWN_S, DRAWN_POINTS = 3.0, 300
ANSWERS = ("right", "group", "in part", "silent", "wrong", "refused")
COUNTED = ("", "cases", *ANSWERS, "sizes held")
TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
PAGE, KINDS = TABLE.pop("page"), TABLE.pop("kinds")


@dataclass(frozen=True)
class Known:
    """A case of the table, whose comments explain the fields."""

    title: str
    truth: str
    folder: Path
    given: str
    references: str = ""
    unseen: str = ""
    measured: str = ""
    again: str = ""
    robot: str = "robot.toml"
    joint: str = "j1"
    effects: Sequence[str] = ()
    finding: str = ""
    also: Sequence[str] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)

    def read(self, name: str) -> Recording:
        """A recording as of somebody who knows neither the gain nor the new load."""
        if name == "emps":
            return emps_drive(self.folder)[0]
        read = read_recording(self.folder / f"{name}.csv")
        kept = {k: v for k, v in read.metadata.items() if k != "firmware_p_gain"}
        first = next(iter(sorted(self.folder.glob(f"{self.references}.csv"))), read.path)
        return replace(read, metadata=kept, loads=read_recording(first).loads)

    def recordings(self, pattern: str) -> list[Recording]:
        """What the verbs are given: three quarters of a recording, or all but the unseen motion."""
        if pattern and pattern == self.unseen:
            whole = self.read(pattern)
            return [whole.between(0, 3 * whole.t.size // 4)]
        names = (path.stem for path in sorted(self.folder.glob(f"{pattern}.json")))
        return [self.read(name) for name in names if name != self.unseen]

    def motion(self) -> tuple[Recording, Mask, float | None]:
        """The unseen motion, which samples are scored, and what two runs differ by, mrad."""
        if self.measured:
            sent = read_commands(self.folder / f"{self.unseen}.csv")
            data = pd.read_csv(self.folder / f"{self.measured}.csv")
            angles = data[[f"{j}.position_rad" for j in sent.joints]].to_numpy()
            noise = data[f"{self.joint}.position_rad"] - data[f"{self.joint}.clean_rad"]
            return replace(sent, position=angles), np.isfinite(sent.t), mean_mrad(noise)
        whole = self.read(self.unseen)
        on = np.arange(whole.t.size) < whole.powered(whole.joints.index(self.joint))
        if self.given == self.unseen:
            on &= np.arange(whole.t.size) >= 3 * whole.t.size // 4
        if not self.again:
            return whole, on, None
        other = self.read(self.again)
        again = np.interp(whole.t, other.t, cleaned(other.position[:, 0]))
        return whole, on, mean_mrad((again - cleaned(whole.position[:, 0]))[on])


def cleaned(angle: Array) -> Array:
    """Angles (T,) without single readings that are far from their neighbours."""
    return np.where(wrong_readings(angle), np.nan, angle)


def mean_mrad(angle: Array) -> float:
    """Mean absolute value of angles in rad, in mrad."""
    return 1e3 * float(np.nanmean(np.abs(angle)))


def answered(case: Known) -> dict[str, Any]:
    """What the library says of a case, and the errors and the drawing of the unseen motion."""
    robot: Any = emps_drive(case.folder)[1] if case.given == "emps" else case.folder / case.robot
    given, references = case.recordings(case.given), case.recordings(case.references)
    row: dict[str, Any] = {"verdict": "refused", "named": []}
    try:
        found = diagnose(given, robot, references=references)
        fitted = identify(references or given, robot)
    except InputError as error:
        return row | {"said": [str(error).replace(f"{case.folder}/", "")]}
    row |= {"verdict": found.verdict, "said": str(found).splitlines()}
    for effect in found.effects:
        group = [f"{effect.component} {e}" for e in effect.group or (effect.effect,)]
        sizes = {f"{group[0]}.{n}": [x.mean, x.q05, x.q95] for n, x in effect.parameters.items()}
        row["named"].append({"group": group, "probability": effect.probability, "sizes": sizes})
    if case.unseen:
        models = {"plain": found.baseline, "identify": fitted, "diagnosis": found.model}
        motion, on, floor = case.motion()
        j = motion.joints.index(case.joint)
        angles = {n: predict(motion, None, m).angles[0][on, j] for n, m in models.items() if m}
        measured = cleaned(motion.position[on, j])
        noise = found.baseline_fit[f"{case.joint}.position_rad"]["noise"] or 0.0
        row["errors"] = {name: mean_mrad(angle - measured) for name, angle in angles.items()}
        row["errors"]["floor"] = 1e3 * np.sqrt(2 / np.pi) * noise if floor is None else floor
        row["svg"] = drawn(case.title, motion.t[on], measured, angles, row["errors"]["floor"])
    return rounded(row)


def judged(case: Known, row: dict[str, Any]) -> dict[str, Any]:
    """The row with what is known: true sizes, the answer, its most probable wrong name."""
    groups, true = [set(one["group"]) for one in row["named"]], {*case.effects, *case.also}
    odds = [one["probability"] for one in row["named"] if not true & set(one["group"])]
    finding = "".join(re.findall(case.finding, "\n".join(row["said"]))[:1])
    for one in row["named"]:
        one["sizes"] = {n: [*x, case.sizes[n]] for n, x in one["sizes"].items() if n in case.sizes}
    if odds or (not case.effects and row["verdict"] == "unexplained"):
        answer = "wrong"
    elif row["verdict"] == "refused":
        answer = "refused"
    elif not groups:
        answer = ("group" if finding else "silent") if case.effects else "right"
    elif not set(case.effects) <= set().union(*groups):
        answer = "in part"
    else:
        answer = "group" if any(len(group) > 1 for group in groups) else "right"
    known = {"title": case.title, "truth": case.truth, "answer": answer, "finding": finding}
    return row | known | {"false": max(odds, default=0.0)}


def drawn(title: str, t: Array, measured: Array, angles: dict[str, Array], floor: float) -> str:
    """Angles and errors, side by side, of the seconds in which the plain servo is worst."""
    total = np.nancumsum(np.abs(angles["plain"] - measured))
    ends = np.searchsorted(t, t + DRAWN_S).clip(max=t.size - 1)
    first = int(np.argmax((total[ends] - total) * (t <= max(t[0], t[-1] - DRAWN_S))))
    shown = slice(first, ends[first] + 1, max(1, (ends[first] - first) // DRAWN_POINTS))
    looks = {"plain": (INK, "--", "plain servo"), "diagnosis": (ACCENT, "-", "as diagnosed")}
    with new_figure(200, f"{title}: an unseen motion, measured and simulated") as figure:
        angle, error = figure.subplots(1, 2)
        angle.plot(t[shown], measured[shown], color=FAINT, linewidth=4, label="measured")
        error.axhspan(-floor, floor, color=RULE, linewidth=0)
        for name, (colour, dashes, label) in looks.items():
            off, look = angles[name] - measured, {"color": colour, "linewidth": 1.2, "label": label}
            angle.plot(t[shown], angles[name][shown], dashes, **look)
            error.plot(t[shown], 1e3 * off[shown], dashes, **look)
        angle.set(title="angle, rad", xlabel="time, s")
        error.set(title="simulated − measured, mrad", xlabel="time, s")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return svg(figure)


def overview(rows: dict[str, Any]) -> str:
    """Errors before and after, relative to the floor, of all cases on one logarithmic axis."""
    shown = [(row["title"], row["errors"]) for row in rows.values() if "errors" in row]
    with new_figure(70 + 17 * len(shown), "errors on unseen motions, before and after") as figure:
        axes = figure.subplots()
        y = np.arange(len(shown))
        before, _, after, floor = np.array([list(errors.values()) for _, errors in shown]).T
        before, after = before / floor, after / floor
        axes.hlines(y, before, after, FAINT, linewidth=1)
        axes.plot(before, y, "o", color=INK, markerfacecolor="none", markersize=6)
        axes.plot(after, y, "o", color=ACCENT, markersize=5)
        axes.axvline(1.0, color=MUTED, linewidth=0.8)
        axes.set_yticks(y, [title for title, _ in shown], size=9)
        axes.set(xscale="log", ylim=(len(shown) - 0.3, -0.7), title="mean absolute error / floor")
        axes.margins(x=0.03)
        axes.xaxis.set_major_formatter("{x:g}")
    return svg(figure)


def said(row: dict[str, Any]) -> str:
    """What was named with its probability, and below it the sizes that are known."""
    words, sizes = [], []
    for one in row["named"]:
        parts = [name.split(maxsplit=1) for name in one["group"]]
        place = f"{parts[0][0]}: " if parts[0][0] not in ("j1", "pan") else ""
        kinds = " or ".join(plain(effect) for _, effect in parts)
        words.append(f"{place}{kinds}, {sure(one['probability'])}")
        for name, values in one["sizes"].items():
            texts = [readable_name(name.rpartition(".")[2]), *(readable(name, x) for x in values)]
            sizes.append("{} {} ({} to {}), true {}".format(*texts))
    below = sizes if words else [row["verdict"].replace("_", " ")]
    return "; ".join(words or [row["finding"] or "–"]) + "\n" + "; ".join(below)


def counts(rows: dict[str, Any]) -> list[tuple[str, ...]]:
    """Answers by kind of case, and of all."""
    lines = []
    for kind in (*KINDS, ""):
        some = [row for name, row in rows.items() if name.startswith(kind)]
        of = Counter(row["answer"] for row in some)
        sizes = [x for row in some for one in row["named"] for x in one["sizes"].values()]
        inside = sum(low <= true <= high for _, low, high, true in sizes)
        heading, numbers = (
            KINDS[kind]["title"] if kind else "all",
            map(str, (of[a] for a in ANSWERS)),
        )
        lines.append((heading, str(of.total()), *numbers, f"{inside} of {len(sizes)}"))
    return lines


def summary(rows: dict[str, Any]) -> str:
    """What the cases say together, in sentences."""
    of = Counter(row["answer"] for row in rows.values())
    certain = sum(row["false"] >= 0.9 for row in rows.values())
    errors = [row["errors"] for row in rows.values() if "errors" in row]
    ratios = [np.median([x[k] / x["floor"] for x in errors]) for k in ("plain", "diagnosis")]
    told = ", ".join(f"{of[answer]} {answer}" for answer in ANSWERS if of[answer])
    return (
        f"{len(rows)} cases: {told}; a wrong name is given at 90 % or more in {certain}. On "
        f"{len(errors)} motions that no fit saw, the error of the plain servo is {ratios[0]:.1f} "
        f"times the floor, that of the diagnosis {ratios[1]:.1f} times (medians)."
    )


def sections(rows: dict[str, Any]) -> list[Section]:
    """The page: counts, what they prove, and the cases by kind."""
    counted = Table(COUNTED, counts(rows), PAGE["answers"])
    proves = [Note("info", x) for x in PAGE["proves"].strip("- \n").split("\n- ")]
    page = [
        Section("In short", summary(rows), [counted, Figure(overview(rows), PAGE["overview"])]),
        Section(PAGE["limits"], "", proves),
    ]
    for kind, of in KINDS.items():
        some = {name: row for name, row in rows.items() if name.startswith(kind)}
        cells = [(r["title"], r["truth"], said(r), r["answer"]) for r in some.values()]
        scored = {name: row for name, row in some.items() if "errors" in row}
        errors = [
            (r["title"], *map("{:.3g}".format, r["errors"].values())) for r in scored.values()
        ]
        blocks = [Table(("case", "known", "named", "answer"), cells)]
        blocks += [Table(PAGE["models"], errors, PAGE["errors"])] if errors else []
        blocks += [Figure(r["svg"], f"{r['title']}. {PAGE['run']} {n}") for n, r in scored.items()]
        page += [Section(of["title"], of["lead"], blocks)] if cells else []
    return page


def main() -> None:
    """Answer the cases that are not stored, write numbers, page and README."""
    options = command_line(__doc__, shared=REAL.parent, only="", again=False).parse_args()
    rows: dict[str, Any] = {}
    for name, of in ((f"{kind}/{n}", of) for kind in KINDS for n, of in TABLE[kind].items()):
        case = Known(**of | {"folder": options.shared / of["folder"]})
        file = ROOT / "build" / "known_answers" / f"{name}.json"
        if not case.folder.is_dir():
            print(f"{name}: skipped, there is no {case.folder}")
        elif options.only in name and (options.again or not file.exists()):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_json(file, answered(case))
        if file.exists():
            rows[name] = judged(case, json.loads(file.read_text()))
            print(name, rows[name]["answer"], said(rows[name]), rows[name].get("errors"))
    if not any("errors" in row for row in rows.values()):
        raise SystemExit("no motion was predicted: no page")
    numbers = {n: {k: x for k, x in row.items() if k != "svg"} for n, row in rows.items()}
    write_json(REPORT / "known_answers.json", numbers)
    title, about = PAGE["title"], PAGE["subtitle"]
    made = provenance([], 0) | {"command": PAGE["run"].removesuffix(" --only")}
    write_page(REPORT / "index.html", title, about, sections(rows), made)
    words = PAGE | {"summary": summary(rows), "counts": table(COUNTED, counts(rows))}
    write_whole(REPORT / "README.md", PAGE["readme"].format(**words))


if __name__ == "__main__":
    main()
