"""``sim2real calibrate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim import verbs
from sim.calibration.calibration import Calibration
from sim2real.commands.verb import arguments_of
from sim2real.errors import if_installed
from sim2real.model import write_model
from sim2real.output import beside, check_writable
from sim2real.report.drawing import save_png


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the parameters and errors, write the model and a plot of each swim."""
    out = check_writable(options.out)
    calibration = verbs.calibrate(**arguments_of(verbs.calibrate, options))
    write_model(calibration.model, out)
    print(calibration)
    print(f"\nmodel: {out}")
    if not options.no_plots:
        with if_installed("plots"):
            _plot(calibration, out)
    return 0


def _plot(calibration: Calibration, out: Path) -> None:
    """The fit of each swim."""
    for k, swim in enumerate(calibration.swims):
        plot = save_png(calibration.plot(k), beside(out, f"{out.stem}.{swim.name}.png"))
        print(f"plot: {plot}")
