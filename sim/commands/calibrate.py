"""``sim2real calibrate``."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from sim.inference.calibrate import Calibrated, calibrate
from sim.inference.fluid_calibration import InFluid, calibrate_in_fluid
from sim.inference.parameters import law_parameters, servo_parameters
from sim.inference.swims import (
    SIGNALS,
    UNITS,
    Simulator,
    Swim,
    by_fluid,
    by_twin,
    swim_of,
    with_values,
)
from sim.view.calibration_plot import comparison
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter
from sim2real.model import Model, read_model, write_model
from sim2real.output import check_writable, provenance
from sim2real.recording import read_recording
from sim2real.report.drawing import save_png
from sim2real.report.quantity import change_text
from sim2real.robot import Robot, read_robot


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
    found: Calibrated | InFluid = _in_twin(swims, model, free, twin, options.held_out)
    print(table(found, "twin", robot))
    shown: Simulator = twin
    if options.fluid:
        late = {
            p.name: v for p, v in zip(found.free, found.best, strict=True) if "latency" in p.name
        }
        law = {"twin": found.model.body["twin"]}
        start = replace(with_values(model, late), body={**model.body, **law})
        found, shown = _in_fluid(swims, start, model, robot, options)
        print(table(found, f"fluid, cells of {options.cell_m:g} m", robot))
    inputs = [*options.recordings, options.robot, options.model]
    written = replace(
        with_figures(found, robot, options.cell_m), provenance=provenance(inputs, options.seed)
    )
    write_model(written, out)
    print(f"\nmodel: {out}")
    if not options.no_plots:
        for swim in swims:
            figure = comparison(swim, model, found.model, shown, robot)
            print(f"plot: {save_png(figure, out.with_name(f'{out.stem}.{swim.name}.png'))}")
    return 0


def _in_twin(
    swims: list[Swim], model: Model, free: list[Parameter], twin: Simulator, held_out: float
) -> Calibrated:
    with tqdm(total=100, desc="calibrate, twin", unit="%", disable=None) as bar:
        return calibrate(
            swims,
            model,
            free,
            twin,
            held_out=held_out,
            progress=lambda share: bar.update(round(100 * share) - bar.n),
        )


def _in_fluid(
    swims: list[Swim],
    start: Model,
    uncalibrated: Model,
    robot: Robot,
    options: argparse.Namespace,
) -> tuple[InFluid, Simulator]:
    given = {"device": options.device, "threads": 2}
    fluid = by_fluid(robot, cell_m=options.cell_m, **given)
    with tqdm(total=100, desc="calibrate, fluid", unit="%", disable=None) as bar:
        found = calibrate_in_fluid(
            swims,
            start,
            robot,
            fluid,
            cell_m=options.cell_m,
            coarser=by_fluid(robot, cell_m=2 * options.cell_m, **given),
            gains=options.fit_gains,
            count=options.rollouts,
            held_out=options.held_out,
            uncalibrated=uncalibrated,
            seed=options.seed,
            progress=lambda share: bar.update(round(100 * share) - bar.n),
        )
    return found, fluid


def table(found: Calibrated | InFluid, where: str, robot: Robot) -> str:
    """Parameters with intervals, and errors before and after on what was held out.

    Where the recordings' noise is known, also by how much the error beyond it fell.
    """
    lines = [f"in the {where}:"]
    ends = found.interval()
    for p, best, (low, high) in zip(found.free, found.best, ends, strict=True):
        lines.append(f"  {p.name:34s} {best:10.4g}   90 % {low:.4g} to {high:.4g}")
    if isinstance(found, InFluid) and found.grid is None:
        lines.append(
            "  the intervals lack the cells' share: those of twice the size stop the robot"
        )
    names = [*SIGNALS, *(joint.name for joint in robot.joints)]
    units = [*UNITS, *("rad" for _ in robot.joints)]
    noise = found.noise if isinstance(found, InFluid) else np.zeros(len(names))
    beyond = np.sqrt(np.maximum(found.rmse**2 - noise**2, 0.0))
    lines.append("  held-out error            before     after")
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        before, after = found.rmse[:, k]
        line = f"    {name:18s} {before:10.4f} {after:10.4f} {unit:6s} {change_text(before, after)}"
        if noise[k] > 0:
            line += f"; beyond the noise of {noise[k]:.4f} {change_text(*beyond[:, k])}"
        lines.append(line)
    return "\n".join(lines)


def with_figures(found: Calibrated | InFluid, robot: Robot, cell_m: float | None = None) -> Model:
    """The calibrated model with intervals of what was fitted, and errors, beside it."""
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
    if isinstance(found, InFluid):
        body["posterior"] = {
            "cell_m": cell_m,
            "names": list(interval),
            "mean": [float(x) for x in found.best],
            "covariance": [[float(x) for x in row] for row in found.fitted.covariance],
        }
    if not np.all(np.isfinite(found.best)):
        raise InputError("calibrate", "fit", "no finite parameters", "recordings that move")
    return replace(found.model, body=body, fit={**found.model.fit, **figures})


__all__ = ["run", "table", "with_figures"]
