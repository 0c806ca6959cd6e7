"""``sim2real validate``: published cases, with computed and published figures."""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import time
from collections.abc import Sequence
from dataclasses import asdict

import sim.cases
from sim.cases.case import Case, Figure
from sim.fluid.fluid import find_device
from sim.view.report import cases_section
from sim2real.errors import InputError, if_installed
from sim2real.output import beside, check_writable, provenance, write_json
from sim2real.report.page import write_page


def run(options: argparse.Namespace) -> int:
    """Run the cases, print a line for each figure, write a page and a JSON file."""
    page = check_writable(options.out)
    device = str(find_device(options.device))
    done: list[tuple[Case, float]] = []
    missed = 0
    for name in chosen(options.only):
        start = time.perf_counter()
        case = importlib.import_module(f"sim.cases.{name}").run(device=device, quick=options.quick)
        done.append((case, time.perf_counter() - start))
        print(f"{case.title} ({done[-1][1]:.0f} s): {case.setup}", flush=True)
        for figure in case.figures:
            print("  " + line(figure), flush=True)
            missed += not figure.met
    content = [asdict(case) | {"seconds": seconds} for case, seconds in done]
    for case in content:
        del case["curves"]
    write_json(beside(page, f"{page.stem}.json"), {"device": device, "cases": content})
    lead = f"{sum(len(c.figures) for c, _ in done)} figures on {device}, {missed} bars missed"
    print(f"\n{lead}")
    with if_installed("page"):
        sections = [cases_section(*result) for result in done]
        write_page(page, "Validation", lead, sections, provenance([], 0))
        print(f"report: {page}")
    return 1 if missed else 0


def chosen(only: Sequence[str]) -> list[str]:
    """Names of the cases to run.

    Raises:
        InputError: If there is no such case.
    """
    names = sorted(m.name for m in pkgutil.iter_modules(sim.cases.__path__) if m.name != "case")
    names = [name for name in names if hasattr(importlib.import_module(f"sim.cases.{name}"), "run")]
    for name in only:
        if name not in names:
            raise InputError("validate", "--only", name, f"one of {', '.join(names)}")
    return [name for name in names if name in only or not only]


def line(figure: Figure) -> str:
    """The printed line of a figure."""
    text = f"{figure.quantity}: {figure.ours:.5g}, reference {figure.reference:.5g}"
    text += f", error {100 * figure.error:.2f} %"
    if figure.bar is None:
        return text
    return f"{text}, bar {100 * figure.bar:g} %: {'met' if figure.met else 'MISSED'}"
