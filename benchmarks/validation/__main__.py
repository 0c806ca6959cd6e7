"""Run published cases, print their figures beside the published ones, write a page.

    python -m benchmarks.validation [--device cuda:0] [--only cavity ...] [--quick] [--out PAGE]

Exits with 1 if a bar is missed. Finer cells and further bars on a GPU.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.harness import ROOT, command_line
from benchmarks.validation.case import Case, Where
from benchmarks.validation.conservation import hard_commands, momentum
from benchmarks.validation.slender import plate, spheroid
from benchmarks.validation.still import driven_cylinder, settling_sphere, taylor_green
from benchmarks.validation.streams import cavity, moving_cylinder
from benchmarks.validation.swimmers import anguilliform, foil
from sim.fluid.fluid import find_device
from sim2real.output import provenance, write_json
from sim2real.report.page import Section, Table, write_page

CASES: dict[str, Callable[[Where], Case]] = {
    run.__name__: run
    for run in (
        taylor_green, cavity, driven_cylinder, settling_sphere, moving_cylinder,
        spheroid, plate, foil, momentum, hard_commands, anguilliform,
    )
}  # fmt: skip
HEADER = ("", "ours", "published", "error", "bar", "")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases, print and write; the exit status."""
    parser = command_line(
        __doc__, device="cpu", quick=(False, "coarse versions with wider bars, in seconds"),
        out=ROOT / "reports" / "validation.html",
    )  # fmt: skip
    parser.add_argument("--only", nargs="+", choices=CASES, default=[*CASES], metavar="CASE")
    options = parser.parse_args(arguments)
    where = Where(str(find_device(options.device)), quick=options.quick)
    content, sections, missed = [], [], 0
    for name in options.only:
        start = time.perf_counter()
        case = CASES[name](where)
        seconds = time.perf_counter() - start
        print(f"{case.title} ({seconds:.0f} s): {case.setup}", flush=True)
        for figure in case.figures:
            print("  " + "  ".join(filter(None, figure.cells)), flush=True)
        met = sum(figure.met for figure in case.figures)
        missed += len(case.figures) - met
        content.append({"name": name, **asdict(case), "seconds": seconds})
        rows = [figure.cells for figure in case.figures]
        caption = f"Source: {case.source}. {case.setup}; {seconds:.0f} s."
        lead = f"{met} of {len(rows)} figures within their bars."
        sections.append(Section(case.title, lead, [Table(HEADER, rows, caption=caption)]))
    page = Path(options.out)
    write_json(page.with_suffix(".json"), {"device": where.device, "cases": content})
    count = sum(len(case["figures"]) for case in content)
    told = f"{count} figures on {where.device}, {missed} bars missed"
    write_page(page, "Validation", told, sections, provenance([], 0))
    print(f"\n{told}\nreport: {page}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
