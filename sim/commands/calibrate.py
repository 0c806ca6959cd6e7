"""``sim2real calibrate``."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from sim.calibrate import (
    HELD_OUT_SHARE,
    Calibrated,
    Free,
    body_parameters,
    calibrate,
    law_parameters,
    servo_parameters,
)
from sim.calibration_plot import comparison
from sim.swims import SIGNALS, UNITS, Simulator, Swim, by_fluid, by_twin, swim_of, with_values
from sim2real.errors import InputError
from sim2real.model import Model, read_model, write_model
from sim2real.output import check_writable, provenance
from sim2real.recording import read_recording
from sim2real.report.drawing import save_png
from sim2real.robot import Robot, read_robot

_BODY = ("form_drag", "linear_drag", "surface_friction", "added_mass", "com_offset")


def run(options: argparse.Namespace) -> int:
    """Fit in the twin, then in the fluid if asked, say what it brought, write the model."""
    out = check_writable(options.out)
    robot, model = read_robot(options.robot), read_model(options.model)
    for joint in robot.joints:
        if joint.name not in model.joints:
            known = ", ".join(model.joints) or "none"
            raise InputError(options.model, "joints", known, f"the robot's joint {joint.name}")
    swims = [swim_of(read_recording(path), robot) for path in options.recordings]
    twin = by_twin(robot)
    free = [*law_parameters(), *servo_parameters(model, robot, gains=options.fit_gains)]
    found = _fit(swims, model, free, twin, "twin", options.held_out)
    print(table(found, "twin", robot))
    shown: Simulator = twin
    if options.fluid:
        late = {
            p.name: v for p, v in zip(found.free, found.best, strict=True) if "latency" in p.name
        }
        law = {"twin": found.model.body["twin"]}
        start = replace(with_values(model, late), body={**model.body, **law})
        fluid = by_fluid(robot, device=options.device, cell_m=options.cell_m, threads=2)
        more = [*body_parameters(robot), *servo_parameters(start, robot, gains=options.fit_gains)]
        found = _fit(
            swims, start, more, fluid, "fluid", options.held_out, options.steps, uncalibrated=model
        )
        print(table(found, f"fluid, cells of {options.cell_m:g} m", robot))
        shown = fluid
    inputs = [*options.recordings, options.robot, options.model]
    written = replace(_with_figures(found, robot), provenance=provenance(inputs, options.seed))
    write_model(written, out)
    print(f"\nmodel: {out}")
    if not options.no_plots:
        for swim in swims:
            figure = comparison(swim, model, found.model, shown, robot)
            print(f"plot: {save_png(figure, out.with_name(f'{out.stem}.{swim.name}.png'))}")
    return 0


def _fit(
    swims: list[Swim],
    model: Model,
    free: list[Free],
    simulator: Simulator,
    where: str,
    held_out: float,
    evaluations: int = 12,
    uncalibrated: Model | None = None,
) -> Calibrated:
    with tqdm(total=100, desc=f"calibrate, {where}", unit="%", disable=None) as bar:
        return calibrate(
            swims,
            model,
            free,
            simulator,
            uncalibrated=uncalibrated,
            held_out=held_out,
            evaluations=evaluations,
            progress=lambda share: bar.update(round(100 * share) - bar.n),
        )


def table(found: Calibrated, where: str, robot: Robot) -> str:
    """Parameters with intervals, and errors before and after on what was held out."""
    lines = [f"in the {where}:"]
    ends = found.interval()
    for p, best, (low, high) in zip(found.free, found.best, ends, strict=True):
        lines.append(f"  {p.name:34s} {best:10.4g}   90 % {low:.4g} to {high:.4g}")
    names = [*SIGNALS, *(joint.name for joint in robot.joints)]
    units = [*UNITS, *("rad" for _ in robot.joints)]
    lines.append("  held-out error            before     after")
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        before, after = found.rmse[:, k]
        share = f"{100 * (after / before - 1):+.0f} %"
        lines.append(f"    {name:18s} {before:10.4f} {after:10.4f} {unit:6s} {share}")
    return "\n".join(lines)


def _with_figures(found: Calibrated, robot: Robot) -> Model:
    names = [f"body.{name.replace(' ', '_')}" for name in SIGNALS]
    names += [f"{joint.name}.position_rad" for joint in robot.joints]
    figures = {
        name: {
            "train": float(found.train[1, k]),
            "heldout": float(found.rmse[1, k]),
            "heldout_before": float(found.rmse[0, k]),
        }
        for k, name in enumerate(names)
    }
    interval = {
        p.name: [float(low), float(high)]
        for p, (low, high) in zip(found.free, found.interval(), strict=True)
    }
    body = {**found.model.body, "interval": interval}
    if not np.all(np.isfinite(found.best)):
        raise InputError("calibrate", "fit", "no finite parameters", "recordings that move")
    return replace(found.model, body=body, fit={**found.model.fit, **figures})


__all__ = ["HELD_OUT_SHARE", "run", "table"]
