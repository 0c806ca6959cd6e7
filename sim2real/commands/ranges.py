"""``sim2real ranges``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim2real import verbs
from sim2real.commands.verb import arguments_of
from sim2real.errors import if_installed
from sim2real.output import beside, check_writable, is_stream
from sim2real.posterior.posteriors import joint_sample, write_sample
from sim2real.ranges.entry import write_ranges
from sim2real.ranges.gather import Gathered
from sim2real.robot import read_robot

POSTERIOR = "posterior.npz"


def run(options: argparse.Namespace) -> int:
    """Generate ranges; print them; write them, the posterior sample and a page."""
    out = check_writable(options.out)
    gathered = verbs.ranges(**arguments_of(verbs.ranges, options, chains=out))
    if gathered.posteriors and not is_stream(out):
        gathered = replace(gathered, ranges=replace(gathered.ranges, posterior=POSTERIOR))
        sample = joint_sample(gathered.posteriors, np.random.default_rng(options.seed))
        write_sample(sample, out.with_name(POSTERIOR))
    write_ranges(gathered.ranges, out)
    print(gathered)
    if not options.no_page:
        with if_installed("page"):
            _write_page(gathered, read_robot(options.robot).name, beside(out, f"{out.stem}.html"))
    return 0


def _write_page(gathered: Gathered, robot: str, page: Path) -> None:
    from sim2real.report.page import write_page
    from sim2real.report.ranges import posterior_sections, ranges_section

    count = len(gathered.ranges.entries)
    sections = [ranges_section(gathered), *posterior_sections(gathered)]
    title, subtitle = f"Randomization ranges of {robot}", f"{count} parameters, each from data"
    write_page(page, title, subtitle, sections, gathered.ranges.provenance)
    print(f"\npage: {page}")
