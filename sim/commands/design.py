"""``sim2real design``."""

from __future__ import annotations

import argparse

from sim import verbs
from sim2real.commands.verb import arguments_of
from sim2real.design.plan import Design
from sim2real.design.tell_apart import RivalDesign
from sim2real.errors import InputError, if_installed
from sim2real.output import beside, check_writable
from sim2real.recording import write_recording
from sim2real.verbs import robot_of


def run(options: argparse.Namespace) -> int:
    """Design the next recording; write its commands, what they promise, and a page."""
    if options.out.suffix != ".csv":
        raise InputError("--out", "", str(options.out), "a file name ending in .csv")
    out = check_writable(options.out)
    design = verbs.design(**arguments_of(verbs.design, options))
    print(design)
    if isinstance(design, RivalDesign) and not design.informative:
        return 0
    recording = design.recording(out.stem)
    write_recording(recording, out, measured=False)
    options.result = {k: v for k, v in recording.metadata.items() if k in ("design", "rivals")}
    print(f"{out}: {design.t.size} set-points in {design.t[-1]:.1f} s; play it by")
    print(f"  sim2real record {out} --robot {options.robot} --port PORT --ids IDS --out RECORDING")
    if not options.no_page:
        with if_installed("page"):
            _write_page(design, options)
    return 0


def _write_page(design: Design | RivalDesign, options: argparse.Namespace) -> None:
    from sim2real.report.design_plot import design_section
    from sim2real.report.page import write_page
    from sim2real.report.rival_plots import rivals_section

    page = beside(options.out, f"{options.out.stem}.html")
    if isinstance(design, RivalDesign):
        sections = [rivals_section(design)]
    else:
        sections = [design_section(design, joint) for joint in design.joints]
    title = f"The next recording of {robot_of(options.robot).name}"
    write_page(page, title, "The most informative commands", sections, design.provenance)
    print(f"page: {page}")
