"""``sim2real export-servo`` and ``sim2real export-ranges``: files for other simulators."""

from __future__ import annotations

import argparse

from sim2real import exchange
from sim2real.commands.command import arguments_of
from sim2real.model import Model, read_model
from sim2real.ranges.entry import Ranges, read_ranges


def export_servo(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator, refitted without effects that it lacks."""
    return _exported(read_model(options.model), options)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    return _exported(read_ranges(options.ranges), options)


def _exported(source: Model | Ranges, options: argparse.Namespace) -> int:
    """Write; print what the text lacks, the errors of refits, and differences of the simulator."""
    export = exchange.export(**arguments_of(exchange.export, options, source=source))
    errors = {name: [vars(one) for one in rows] for name, rows in export.errors.items()}
    left_out = [*map(str, export.left_out)]
    options.result = {"file": str(options.out), "not_expressed": left_out, **errors}
    print(f"{', '.join(map(str, export.files(options.out)))}: for {options.to}")
    if costs := str(export):
        print(costs)
    return 0
