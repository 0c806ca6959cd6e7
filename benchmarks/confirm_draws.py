"""Draws from the posterior swim a recording's commands in the fluid: does it lie among them?

    python benchmarks/confirm_draws.py [--device cuda:0] [--cell-m 0.02] [--draws 64] [--seconds 30]

All draws are one batch. Prints how long it took and, for each signal, the share of its samples that
the draws' 90 % band holds, the recording's noise added; the spread of the draws; the error of their
mean. Draws of gains and latencies know nothing of what the water's cells get wrong: shares below
90 % are the fluid's error.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import sim2real as s2r
from rl.randomize import draw_models
from sim.inference.swims import SIGNALS, by_fluid, simulated, swim_of
from sim2real.model import read_model
from sim2real.ranges.entry import read_ranges

POOL = Path(__file__).resolve().parents[1] / "datasets" / "pool"
NEIGHBOURS = 5
"""Samples about whose mean the scatter is taken for noise."""


def main() -> None:
    """Draw, swim, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recording", type=Path, default=POOL / "p1.csv")
    parser.add_argument("--model", type=Path, default=POOL / "calibrated.json")
    parser.add_argument("--ranges", type=Path, default=POOL / "ranges.json")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cell-m", type=float, default=0.02)
    parser.add_argument("--draws", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    robot = s2r.read_robot(POOL / "robot.toml")
    swim = swim_of(s2r.read_recording(options.recording), robot)
    keep = swim.t < options.seconds
    swim = replace(swim, t=swim.t[keep], command=swim.command[keep], signals=swim.signals[keep])
    rng = np.random.default_rng(0)
    model, ranges = read_model(options.model), read_ranges(options.ranges)
    models = draw_models(model, ranges, robot, options.draws, rng)
    started = time.perf_counter()
    fluid = by_fluid(robot, device=options.device, cell_m=options.cell_m, threads=2)
    said = simulated(swim, models, fluid)
    spent = time.perf_counter() - started
    print(
        f"{options.draws} draws, {swim.t[-1]:.0f} s, cells of {100 * options.cell_m:g} cm, "
        f"{options.device}: {spent:.1f} s"
    )
    print("signal        inside 90 % band   spread of draws   error of their mean")
    names = [*SIGNALS, *(joint.name for joint in robot.joints)]
    smooth = np.apply_along_axis(
        np.convolve, 0, swim.signals, np.full(NEIGHBOURS, 1 / NEIGHBOURS), mode="same"
    )
    noise = np.nanstd(swim.signals - smooth, axis=0)
    seen = said + rng.standard_normal(said.shape) * noise
    low, high = np.nanquantile(seen, [0.05, 0.95], axis=0)
    inside = ((swim.signals >= low) & (swim.signals <= high)).mean(axis=0)
    error = np.sqrt(np.nanmean((said.mean(axis=0) - swim.signals) ** 2, axis=0))
    for k, name in enumerate(names):
        spread = float(np.nanmean(np.nanstd(said[:, :, k], axis=0)))
        print(f"{name:12s} {100 * inside[k]:12.0f} % {spread:17.4f} {error[k]:20.4f}")


if __name__ == "__main__":
    main()
