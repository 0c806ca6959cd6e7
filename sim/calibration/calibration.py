"""A body calibrated to swims, in the reduced-order twin and then in the fluid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim.calibration.fluid_calibration import InFluid, calibrate_in_fluid
from sim.calibration.swim_parameters import twin_parameters
from sim.calibration.twin_fit import Calibrated, calibrate
from sim.inference.swims import SIGNALS, UNITS, Simulator, Swim, by_fluid, by_twin, with_values
from sim2real.display import NotebookDisplay
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.progress import progress_bar
from sim2real.report.notebook import result_section
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import Quantity, change_text, quantity_table
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THREADS = 2
"""CPU threads of the fluid."""


@dataclass(frozen=True)
class FluidSettings:
    """Settings of the fluid: side of a cell in m, Warp device, rollouts per batch."""

    cell_m: float = 0.02
    device: str = "cpu"
    rollouts: int = 48


@dataclass(frozen=True)
class Calibration(NotebookDisplay):
    """Result of a calibration.

    Attributes:
        model: The calibrated model, with intervals (``body``) and errors (``fit``).
        before: The model before the calibration.
        robot: The robot.
        swims: The fitted swims, whose last parts were held out.
        twin: Parameters, standard deviations and errors of the fit in the twin.
        in_fluid: Likewise for the fit in the fluid, if there was one.
        fluid: Settings of the fluid.
    """

    model: Model
    before: Model
    robot: Robot
    swims: tuple[Swim, ...]
    twin: Calibrated
    in_fluid: InFluid | None = None
    fluid: FluidSettings = FluidSettings()

    @property
    def fitted(self) -> Calibrated | InFluid:
        """The fit in the fluid if there was one, else that in the twin."""
        return self.in_fluid or self.twin

    def plot(self, swim: int = 0) -> Figure:
        """One swim: measured, and simulated before and after the calibration."""
        from sim.view.swim_page import swim_panels
        from sim2real.report.series import series_figure

        shown, models = self.swims[swim], (self.before, self.fitted.model)
        panels = swim_panels(shown, models, self._simulator, self.robot)
        return series_figure(panels, f"{shown.name}: measured and simulated")

    @property
    def _simulator(self) -> Simulator:
        if self.in_fluid is None:
            return by_twin(self.robot)
        return _by_fluid(self.robot, self.fluid)


def calibrate_body(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    *,
    fit_gains: bool,
    held_out: float,
    fluid: FluidSettings | None = None,
    seed: int = 0,
) -> Calibration:
    """Fit the body to swims in the twin and, if asked, from there in the fluid.

    Args:
        swims: Recordings.
        model: The servos, and a body to start from.
        robot: The robot.
        fit_gains: Whether to fit the servos' gains too, and not only their latencies.
        held_out: Share of each swim, at its end, that is scored and not fitted.
        fluid: How to simulate the fluid; None for the twin alone.
        seed: Seed of the designs of the fluid's batches.

    Raises:
        InputError: If the fluid stops most of a batch, or the calibrated robot.
    """
    free = twin_parameters(model, robot, gains=fit_gains)
    with progress_bar("calibrate, twin") as progress:
        twin = calibrate(swims, model, free, by_twin(robot), held_out=held_out, progress=progress)
    result = Calibration(_with_errors(twin, robot), model, robot, tuple(swims), twin)
    if fluid is None:
        return result
    latencies = {
        p.name: value for p, value in zip(twin.free, twin.best, strict=True) if "latency" in p.name
    }
    start = with_values(model, latencies)
    start = replace(start, body={**model.body, "twin": twin.model.body["twin"]})
    with progress_bar("calibrate, fluid") as progress:
        in_fluid = calibrate_in_fluid(
            swims,
            start,
            robot,
            _by_fluid(robot, fluid),
            cell_m=fluid.cell_m,
            coarser=_by_fluid(robot, replace(fluid, cell_m=2 * fluid.cell_m)),
            gains=fit_gains,
            count=fluid.rollouts,
            held_out=held_out,
            uncalibrated=model,
            seed=seed,
            progress=progress,
        )
    calibrated = _with_errors(in_fluid, robot, fluid.cell_m)
    return replace(result, model=calibrated, in_fluid=in_fluid, fluid=fluid)


def _by_fluid(robot: Robot, fluid: FluidSettings) -> Simulator:
    return by_fluid(robot, cell_m=fluid.cell_m, device=fluid.device, threads=THREADS)


@result_section.register
def _calibration(calibration: Calibration) -> Section:
    blocks = _tables(calibration.twin, "the twin", calibration.robot)
    if calibration.in_fluid is not None:
        where = f"the fluid, cells of {calibration.fluid.cell_m:g} m"
        blocks += _tables(calibration.in_fluid, where, calibration.robot)
    return Section("Calibration", "", blocks)


def _tables(fit: Calibrated | InFluid, where: str, robot: Robot) -> list[Block]:
    """Parameters with intervals, and held-out errors before and after.

    Where the noise of the recordings is known, the change of the error beyond it is shown as well.
    """
    values = [
        (p.name, Quantity("value", "", float(best), (float(low), float(high))))
        for p, best, (low, high) in zip(fit.free, fit.best, fit.interval(), strict=True)
    ]
    blocks: list[Block] = [Text("", heading=f"In {where}"), quantity_table(values, "parameter")]
    if isinstance(fit, InFluid) and fit.grid is None:
        text = "the intervals do not include the discretisation error: cells of twice the size stop"
        blocks.append(Note("warn", f"{text} the robot"))
    names = [*SIGNALS, *(joint.name for joint in robot.joints)]
    units = [*UNITS, *("rad" for _ in robot.joints)]
    noise = fit.noise if isinstance(fit, InFluid) else np.zeros(len(names))
    beyond = np.sqrt(np.maximum(fit.rmse**2 - noise**2, 0.0))
    errors = [
        (
            name,
            *(f"{x:.4f}" for x in fit.rmse[:, k]),
            unit,
            change_text(*fit.rmse[:, k]),
            f"{change_text(*beyond[:, k])} beyond {noise[k]:.4f}" if noise[k] > 0 else "",
        )
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    header = ("held-out error", "before", "after", "unit", "change", "of it beyond the noise")
    return [*blocks, Table(header, errors)]


def _with_errors(fit: Calibrated | InFluid, robot: Robot, cell_m: float | None = None) -> Model:
    """The calibrated model with the intervals of its parameters and its errors."""
    names = [f"body.{name.replace(' ', '_')}" for name in SIGNALS]
    names += [f"{joint.name}.position_rad" for joint in robot.joints]
    errors = {
        name: {
            "train": float(fit.train[1, k]),
            "heldout": float(fit.rmse[1, k]),
            "heldout_before": float(fit.rmse[0, k]),
        }
        for k, name in enumerate(names)
    }
    interval = {
        p.name: [float(low), float(high)]
        for p, (low, high) in zip(fit.free, fit.interval(), strict=True)
    }
    covariance = (fit.fitted if isinstance(fit, InFluid) else fit).covariance
    posterior = {
        "cell_m": cell_m,
        "names": list(interval),
        "mean": [float(x) for x in fit.best],
        "covariance": [[float(x) for x in row] for row in covariance],
    }
    body = {**fit.model.body, "interval": interval, "posterior": posterior}
    if not np.all(np.isfinite(fit.best)):
        raise InputError("calibrate", "fit", "no finite parameters", "recordings that move")
    return replace(fit.model, body=body, fit={**fit.model.fit, **errors})
