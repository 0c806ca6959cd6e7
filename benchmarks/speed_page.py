"""The page of speeds: reports/speed/README.md and speed.png from the JSON files beside them.

    python benchmarks/speed_page.py [--folder reports/speed]

Reads what ``benchmarks/fluid_speed.py --out`` wrote (``h200.json`` on a GPU, ``cpu.json`` on a CPU)
and what ``benchmarks/rival_xlb.py`` wrote (``xlb.json``). What is not there is left out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]

FLUIDX3D = {"float32": 23056.0, "float16": 36610.0}
"""MLUPS of FluidX3D on an H200, D3Q19, an empty box: its own README's table, not run here."""
WANTED = {"control_steps_s": 1300.0, "MLUPS": 12.0, "two_threads": 1.6, "robot_2d": 50.0}
"""Control steps/s of boxes of 1 cm cells on an H200; on a CPU MLUPS of a thread, two threads
against one, and control steps/s of a 2D robot in cells of 2 cm."""
PAPER = 133.0
"""Control steps/s of the paper's simulator, 25 on an RTX 3080 Ti (a million in 11 hours), scaled by
memory bandwidth to an H200."""
HUES = {0.02: "#1b6ca8", 0.01: "#c2571a"}
STYLES = {"float32": ("-", "o"), "float16": ("--", "s")}


def main() -> None:
    """Read, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("reports/speed"))
    folder = parser.parse_args().folder
    gpu, cpu, rival = (read(folder / f"{name}.json") for name in ("h200", "cpu", "xlb"))
    parts = ["# Speed\n", INTRODUCTION, "## Bars\n", table(bars(gpu, cpu, rival), BARS)]
    if gpu:
        draw(gpu["rows"], gpu["device"], folder / "speed.png")
        parts += [f"## {gpu['device']}\n", "![Speed](speed.png)\n", boxes(gpu), robots(gpu)]
    if cpu:
        parts += ["## Two CPU cores\n", boxes(cpu), robots(cpu)]
    if rival:
        parts += ["## Compared with XLB\n", beside(rival)]
    (folder / "README.md").write_text("\n".join(parts))


INTRODUCTION = """\
Made by `python benchmarks/speed_page.py` from the JSON files in this folder; those are made by
`benchmarks/fluid_speed.py` (`h200.json` with `--device cuda:0`, `cpu.json`) and
`benchmarks/rival_xlb.py` (`xlb.json`). MLUPS: million lattice updates a second. The share is of the
bytes a second of a plain copy on the same device in the same run; an update of a cell reads and
writes each population once, and reads a byte of flags. A control step is 0.02 s of the robot.
Rows of the H200 were measured while other programs used its host's CPU and its other GPUs; those of
the CPU are with the wall model before November 2026.
"""
BARS = ("", "asked", "measured", "met")


def read(path: Path) -> Row | None:
    """What a benchmark wrote, or None where there is no file."""
    return json.loads(path.read_text()) if path.exists() else None


def number(x: float) -> str:
    """Three digits or all before the point, never an exponent."""
    return f"{x:,.0f}" if x >= 100 else f"{x:.3g}"


def pick(report: Row, **wanted: Any) -> list[Row]:  # noqa: ANN401 - names and numbers
    """Rows with these values."""
    return [r for r in report["rows"] if all(r.get(k) == v for k, v in wanted.items())]


def bars(gpu: Row | None, cpu: Row | None, rival: Row | None) -> list[Sequence[str]]:
    """What was asked, and the most that was measured."""
    rows: list[Sequence[str]] = []

    def bar(what: str, asked: float, measured: float, unit: str) -> None:
        met = "yes" if measured >= asked else f"no, {100 * measured / asked:.0f} %"
        rows.append((what, f"{number(asked)} {unit}", f"{number(measured)} {unit}", met))

    if gpu:
        for storage, known in FLUIDX3D.items():
            empty = pick(gpu, what="empty", lattice="D3Q19", storage=storage)
            fastest = max(r["MLUPS"] for r in empty)
            bar(f"H200, D3Q19 empty box, {storage}: FluidX3D's table", known, fastest, "MLUPS")
        empty = pick(gpu, what="empty", lattice="D3Q19", storage="float32")
        share = max(r["share_of_copy"] for r in empty)
        bar("H200, D3Q19 empty box, float32, share of the copy", 85, 100 * share, "%")
        fastest = max(r["MLUPS"] for r in empty)
        bar("H200, D3Q19 empty box, float32", 24000, fastest, "MLUPS")
        robots_in = pick(gpu, what="swimming", storage="float32")
        within = max(r["MLUPS"] for r in robots_in) / fastest
        bar("H200, robots in every box, share of the empty box", 75, 100 * within, "%")
        coarse = max(r["control_steps_s"] for r in robots_in if r["cell_m"] == 0.02)
        bar("H200, the same boxes at 2 cm", 15000, coarse, "control steps/s")
        swimming = pick(gpu, what="swimming", cell_m=0.01, storage="float32")
        fastest = max(r["control_steps_s"] for r in swimming)
        asked = WANTED["control_steps_s"]
        bar("H200, robots in 1.5 x 1.0 x 0.4 m at 1 cm, float32", asked, fastest, "control steps/s")
        one = max(r["control_steps_s"] for r in swimming if r["boxes"] == 1)
        bar("H200, one such robot: the paper's simulator, scaled", PAPER, one, "control steps/s")
    if cpu:
        empty = pick(cpu, what="empty", lattice="D3Q19", storage="float32")
        one, two = (next(r["MLUPS"] for r in empty if r["threads"] == k) for k in (1, 2))
        bar("CPU, D3Q19 empty box, one thread", WANTED["MLUPS"], one, "MLUPS")
        bar("CPU, two threads against one", WANTED["two_threads"], two / one, "times")
        robot = max(r["control_steps_s"] for r in pick(cpu, what="swimming", lattice="D2Q9"))
        bar("CPU, 2D robot of 26 cells", WANTED["robot_2d"], robot, "control steps/s")
    if rival:
        others = [r for r in rival["best"] if r["who"] != "sim2real" and r["threads"] == 1]
        least = min(r["ours_is_faster_by_cpu"] for r in others)
        bar("CPU, against the fastest XLB, one thread, by CPU time", 1.0, least, "times")
        one = next(r["per_cpu_second"] for r in rival["best"] if r["who"] == "sim2real")
        bar("CPU, D3Q19 empty box, one thread, by CPU time", WANTED["MLUPS"], one, "MLUPS")
    if not cpu:
        for what, key in (("two threads against one", "two_threads"), ("2D robot", "robot_2d")):
            rows.append((f"CPU, {what}", number(WANTED[key]), "no cpu.json yet", "open"))
    return rows


def table(rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    """A Markdown table; all columns but the first to the right."""
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def boxes(report: Row) -> str:
    """Empty boxes of a device."""
    head = ("empty box", "cells", "storage", "threads", "MLUPS", "share of the copy")
    rows = [
        (
            r["lattice"], " x ".join(str(n) for n in r["size"]), r["storage"], str(r["threads"]),
            number(r["MLUPS"]), f"{100 * r['share_of_copy']:.0f} %",
        )
        for r in pick(report, what="empty")
    ]  # fmt: skip
    copy = pick(report, what="copy")[0]["GB_s"]
    return f"Copy: {number(copy)} GB/s read and written.\n\n" + table(rows, head)


def robots(report: Row) -> str:
    """Batches of robots on a device."""
    head = ("robots", "cell", "cells a box", "storage", "control steps/s", "MLUPS",
            "share of the copy", "MB a box")  # fmt: skip
    rows = [
        (
            f"{r['boxes']} ({r['lattice'][:2]})", f"{100 * r['cell_m']:g} cm", f"{r['cells']:,}",
            r["storage"], number(r["control_steps_s"]), number(r["MLUPS"]),
            f"{100 * r['share_of_copy']:.0f} %", f"{r['MB_per_box']:.1f}",
        )
        for r in pick(report, what="swimming")
    ]  # fmt: skip
    return table(rows, head)


def beside(rival: Row) -> str:
    """The same empty box in XLB and here."""
    n = rival["size"]
    text = (
        f"Periodic D3Q19 box of {n} x {n} x {n} cells, single precision, processes that take turns;"
        f" {', '.join(rival['versions'])}. Busy is the least share of the processors in use"
        " just before. Where it is large, MLUPS and their ratio are chance; those of a CPU"
        " second, all threads added up, still compare the cost of a step, but cannot show whether"
        " two threads run side by side. The viscosity is what the decay of a shear wave shows; 0.1"
        " was asked.\n\n"
    )
    head = ("", "threads", "MLUPS", "MLUPS a CPU second", "ours is faster", "by CPU time",
            "viscosity", "busy")  # fmt: skip
    rows = [
        (
            r["who"], str(r["threads"]), f"{r['MLUPS']:.1f}",
            f"{r['per_cpu_second']:.1f}",
            f"{r['ours_is_faster']:.1f} x", f"{r['ours_is_faster_by_cpu']:.1f} x",
            f"{r['viscosity']:.4f}", f"{100 * r['busy_before']:.0f} %",
        )
        for r in rival["best"]
    ]  # fmt: skip
    return text + table(rows, head)


def draw(rows: list[Row], device: str, path: Path) -> None:
    """Control steps a second against robots, and MLUPS against cells with the memory's limit."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    swimming = [r for r in rows if r["what"] == "swimming" and r["lattice"] == "D3Q19"]
    for cell, storage in sorted({(r["cell_m"], r["storage"]) for r in swimming}, reverse=True):
        mine = [r for r in swimming if (r["cell_m"], r["storage"]) == (cell, storage)]
        line, mark = STYLES[storage]
        look = {"color": HUES.get(cell, "0.4"), "linestyle": line, "marker": mark, "ms": 5}
        label = f"robots, {100 * cell:g} cm cells, {storage}"
        steps = [r["control_steps_s"] for r in mine]
        left.loglog([r["boxes"] for r in mine], steps, label=label, **look)
        updates = [r["MLUPS"] for r in mine]
        right.loglog([r["boxes"] * r["cells"] for r in mine], updates, label=label, **look)
    for storage, (_, mark) in STYLES.items():
        empty = [r for r in rows if r["what"] == "empty" and r["lattice"] == "D3Q19"]
        empty = [r for r in empty if r["storage"] == storage]
        cells = [r["size"][0] * r["size"][1] * r["size"][2] for r in empty]
        right.plot(cells, [r["MLUPS"] for r in empty], mark, color="0.2", ms=7, mfc="none",
                   label=f"empty box, {storage}")  # fmt: skip
    limits(left, right, [r for r in rows if r["what"] == "empty" and r["lattice"] == "D3Q19"])
    left.set(xlabel="robots at once", ylabel="control steps/s, all robots")
    right.set(xlabel="cells, all boxes", ylabel="MLUPS, D3Q19", ylim=(700, 1e5))
    left.legend(frameon=False, fontsize=8)
    right.legend(frameon=False, fontsize=8, loc="lower right")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(which="major", color="0.9", linewidth=0.6)
    figure.suptitle(f"Speed on one {device}", fontsize=11)
    figure.savefig(path, dpi=130)


def limits(left: Any, right: Any, empty: list[Row]) -> None:  # noqa: ANN401 - Matplotlib's
    """Lines for what was asked, and for what the copy's bandwidth would allow."""
    asked = WANTED["control_steps_s"]
    left.axhline(asked, color=HUES[0.01], linewidth=0.8, linestyle=":")
    text = f"asked at 1 cm: {asked:,.0f}"
    left.annotate(text, (1, asked), (-4, 4), xycoords=("axes fraction", "data"), ha="right",
                  textcoords="offset points", fontsize=8, color=HUES[0.01])  # fmt: skip
    for storage in STYLES:
        row = next(r for r in empty if r["storage"] == storage)
        most = row["MLUPS"] / row["share_of_copy"]
        right.axhline(most, color="0.5", linewidth=0.9, linestyle=STYLES[storage][0])
        text = f"the copy's bandwidth, {storage}: {most:,.0f}"
        right.annotate(text, (0.01, most), (0, 3), xycoords=("axes fraction", "data"),
                       textcoords="offset points", fontsize=8, color="0.35")  # fmt: skip


if __name__ == "__main__":
    main()
