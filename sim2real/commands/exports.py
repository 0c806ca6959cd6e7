"""``sim2real export-servo`` and ``sim2real export-ranges``: files for other simulators."""

from __future__ import annotations

import argparse

from sim2real import exchange
from sim2real.exporters.actuator import Export
from sim2real.model import read_model
from sim2real.ranges.entry import read_ranges


def export_servo(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator, refitted without effects that it lacks."""
    source, recordings = read_model(options.model), options.recordings or ()
    more = {"robot": options.robot, "recordings": recordings, "which": options.which}
    more |= {"into": options.into, "joint": options.joint}
    return _said(exchange.export(source, options.to, options.out, **more), options)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    return _said(exchange.export(read_ranges(options.ranges), options.to, options.out), options)


def _said(export: Export, options: argparse.Namespace) -> int:
    """Print what the text lacks, the errors of refits, and differences of the simulator."""
    errors = {name: [vars(one) for one in rows] for name, rows in export.errors.items()}
    left_out = [*map(str, export.left_out)]
    options.result = {"file": str(options.out), "not_expressed": left_out, **errors}
    print(f"{', '.join(map(str, export.files(options.out)))}: for {options.to}")
    if costs := str(export):
        print(costs)
    return 0
