"""``sim2real ranges``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import check_writable, provenance
from sim2real.posterior.sample import joint_sample, write_sample
from sim2real.ranges.entry import write_ranges
from sim2real.ranges.gather import Gathered, Sampling, gather
from sim2real.recording import read_recording
from sim2real.robot import read_robot

POSTERIOR = "posterior.npz"


def run(options: argparse.Namespace) -> int:
    """Make ranges, print them, write them, the posterior sample and a page beside them."""
    out = check_writable(options.out)
    for name in ("steps", "walkers"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name}", "", str(getattr(options, name)), "at least 1")
    robot, model = read_robot(options.robot), read_model(options.model)
    recordings = [read_recording(path) for path in options.recordings]
    total = options.steps * len(model.joints)
    with tqdm(desc="ranges", total=total, unit="step", disable=None) as bar:
        made: dict[str, int] = {}

        def advance(joint: str, steps: int) -> None:
            made[joint] = steps
            bar.update(sum(made.values()) - bar.n)

        sampling = Sampling(
            steps=options.steps,
            walkers=options.walkers,
            seed=options.seed,
            held_out=options.held_out,
            file=lambda joint: chain_file(out, joint),
            progress=advance,
        )
        found = gather(recordings, robot, model, sampling)
    inputs = [*options.recordings, options.robot, options.model]
    name = POSTERIOR if found.posteriors else ""
    ranges = replace(found.ranges, posterior=name, provenance=provenance(inputs, options.seed))
    found = replace(found, ranges=ranges)
    if found.posteriors:
        sample = joint_sample(found.posteriors, np.random.default_rng(options.seed))
        write_sample(sample, out.with_name(POSTERIOR))
    write_ranges(ranges, out)
    print(ranges)
    if not options.no_page:
        _write_page(found, robot.name, out.with_suffix(".html"))
    return 0


def chain_file(out: Path, joint: str) -> Path:
    """Where the chain of a joint lives."""
    return out.with_name(f"{out.stem}.chain.{joint}.npz")


def _write_page(found: Gathered, robot: str, page: Path) -> None:
    from sim2real.report.page import write_page
    from sim2real.report.ranges import posterior_sections, ranges_section

    count = len(found.ranges.entries)
    sections = [ranges_section(found), *posterior_sections(found)]
    title, subtitle = f"Randomization ranges of {robot}", f"{count} parameters, each from data"
    write_page(page, title, subtitle, sections, found.ranges.provenance)
    print(f"\npage: {page}")
