"""Calibration in the fluid: fit with an emulator, errors in the fluid, discretisation error.

A second fit in cells of twice the size is a grid-convergence study: for errors of first order in
the size of a cell, the shift of a parameter from coarse to fine cells equals its remaining error
(Roache, J. Fluids Eng. 116 (1994) 405). The order cannot be determined here
(``reports/resolution``), so the whole shift is added to the intervals in quadrature.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from sim.calibration.emulator import ROLLOUTS, Emulator, rollouts
from sim.calibration.fluid_fit import Fitted, fit, rmse
from sim.calibration.swim_parameters import body_parameters, servo_parameters, water_parameters
from sim.calibration.swim_problem import HELD_OUT_SHARE
from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.inference.parameters import Parameter
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.robot import Robot

_ROUNDS = 2


@dataclass(frozen=True)
class InFluid:
    """Result of a calibration in the fluid.

    Attributes:
        fitted: The fit.
        grid: Shift of each parameter relative to cells of twice the size, shape (F,); None if that
            was not requested, or such cells stop the robot.
        rmse: Held-out root mean square errors of simulations in the fluid, before and after, shape
            (2, 3 + J).
        train: Likewise on the fitted part.
        noise: Standard deviation of the recordings' noise, shape (3 + J,).
    """

    fitted: Fitted
    grid: Array | None
    rmse: Array
    train: Array
    noise: Array

    @property
    def model(self) -> Model:
        """The calibrated model."""
        return self.fitted.model

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The fitted parameters."""
        return self.fitted.free

    @property
    def best(self) -> Array:
        """Their values, shape (F,)."""
        return self.fitted.best

    def interval(self, level: float = 0.9) -> Array:
        """Central intervals with the errors of the fit and of the cells, shape (F, 2)."""
        sd = self.fitted.sd if self.grid is None else np.hypot(self.fitted.sd, self.grid)
        reach = float(norm.ppf(0.5 + level / 2)) * sd
        return np.stack([self.best - reach, self.best + reach], axis=1)


def calibrate_in_fluid(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    fluid: Simulator,
    *,
    cell_m: float,
    coarser: Simulator | None = None,
    gains: bool = False,
    count: int = ROLLOUTS,
    held_out: float = HELD_OUT_SHARE,
    uncalibrated: Model | None = None,
    seed: int = 0,
    progress: Progress = lambda share: None,
) -> InFluid:
    """Fit water, centre of mass and servos to swims in the fluid.

    Args:
        swims: Recordings.
        model: Model to start from.
        robot: The robot.
        fluid: The fluid.
        cell_m: Side of its cells.
        coarser: The fluid in cells of twice the size.
        gains: Whether to fit the servos' gains too, and not only their latencies.
        count: Rollouts of a batch.
        held_out: Share of each swim, at its end, that the fit does not use.
        uncalibrated: Model whose errors are those before; ``model`` where None.
        seed: Seed of the batches' designs.
        progress: Called with the share that is done.

    Raises:
        InputError: If the fluid stops most of a batch, or the calibrated robot.
    """
    water = water_parameters(robot, cell_m)
    viscosity = water[-1]
    model = with_values(model, {viscosity.name: viscosity.nominal})
    offset = [p for p in body_parameters(robot) if p.name.startswith("com_offset")]
    free = [*servo_parameters(model, robot, gains=gains), *water, *offset]

    def fitted(simulator: Simulator, start: Model, seed: int) -> Fitted:
        batches = [rollouts(simulator, swim, start, free, count=count, seed=seed) for swim in swims]
        return fit(swims, start, free, Emulator(batches), held_out=held_out)

    result = fitted(fluid, model, seed)
    for done in range(1, _ROUNDS):
        progress(done / (_ROUNDS + 1))
        result = fitted(fluid, result.model, seed + done)
    progress(_ROUNDS / (_ROUNDS + 1))
    grid = None
    if coarser is not None:
        with suppress(InputError):
            grid = np.abs(fitted(coarser, result.model, seed).best - result.best)
    errors, noise = [], []
    for swim in swims:
        signals = simulated(swim, [uncalibrated or model, result.model], fluid)
        errors.append(rmse(swim, signals, held_out=held_out) ** 2)
        noise.append(np.broadcast_to(swim.noise, swim.signals.shape[1]) ** 2)
    train, held = np.sqrt(np.mean(errors, axis=0))
    if not np.isfinite(held).all():
        raise InputError("calibrate", "fluid", "the robot is stopped", "finer cells, more rollouts")
    progress(1.0)
    return InFluid(result, grid, held, train, np.sqrt(np.mean(noise, axis=0)))
