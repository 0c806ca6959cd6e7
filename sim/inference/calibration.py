"""A body calibrated to swims, in the reduced-order twin and then in the fluid.

Intervals take the larger one of two covariances: that of the normal model, and the sandwich of
White, Econometrica 48 (1980) 817, with the scores of blocks of some seconds. In the twin those of
servos and drag areas have everything else marginalised (``law_error.marginalised``). In the fluid
they include the shift of a parameter relative to cells of twice the size (Roache, J. Fluids Eng.
116 (1994) 405).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm

from sim.inference.coordinates import (
    Coordinates,
    effect_parameters,
    servo_parameters,
    signals_at,
    twin_parameters,
    varied,
    water_parameters,
)
from sim.inference.in_water import emulator
from sim.inference.law_error import marginalised
from sim.inference.swim_problem import SwimPrior, SwimProblem
from sim.inference.swims import (
    HELD_OUT_SHARE,
    Swim,
    SwimSimulator,
    by_followed_twin,
    by_twin,
    signals_of_robot,
    simulated,
    with_values,
)
from sim.twin.twin import SUBSTEPS
from sim2real.arrays import Array
from sim2real.display import NotebookDisplay
from sim2real.errors import InputError
from sim2real.inference.correlated_noise import correlation_samples, long_run
from sim2real.inference.parameters import Parameter
from sim2real.inference.selection import Members
from sim2real.model import Model
from sim2real.report.notebook import result_section
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import Quantity, change_text, quantity_table
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim2real.report.series import Panel


@dataclass(frozen=True)
class Calibrated:
    """Parameters fitted to swims."""

    model: Model  # the calibrated model
    free: tuple[Parameter, ...]  # the F fitted parameters
    best: Array  # their values, shape (F,)
    centre: Array  # centre of their intervals, shape (F,)
    covariance: Array  # covariance of their errors about the centre, shape (F, F)
    # held-out root mean square error of each signal, before and after, shape (2, 3 + J)
    rmse: Array
    train: Array  # likewise on the fitted part
    noise: Array  # standard deviation of the recordings' noise, shape (3 + J,); 0 in the twin
    # in the fluid, shift of each parameter relative to cells of twice the size, shape (F,); None if
    # such cells stop the robot
    grid: Array | None = None

    def interval(self, level: float = 0.9) -> Array:
        """Central intervals, wide enough to contain the fitted values, shape (F, 2)."""
        sd = np.sqrt(np.diag(self.covariance) + (0.0 if self.grid is None else self.grid**2))
        reach = float(norm.ppf(0.5 + level / 2)) * sd
        low, high = self.centre - reach, self.centre + reach
        return np.stack([np.minimum(low, self.best), np.maximum(high, self.best)], axis=1)


def calibrate(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    simulator: SwimSimulator,
    *,
    held_out: float = HELD_OUT_SHARE,
) -> Calibrated:
    """Fit ``free`` parameters to swims in the twin; the last share ``held_out`` is scored."""
    parts = [swim.first(1 - held_out) for swim in swims]
    result, best, covariance = _fit(parts, model, free, simulator)
    before = with_values(model, {p.name: p.nominal for p in free})
    errors = _errors(swims, [before, result], simulator, held_out)
    noise = np.zeros(errors[0].shape[1])
    return Calibrated(result, tuple(free), best, best, covariance, *errors, noise)


def _fit(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    simulate: SwimSimulator,
    share: float | None = None,
) -> tuple[Model, Array, Array]:
    """The fitted model, its parameters (F,), and the larger one of their covariances, (F, F).

    The error is the residual, or a ``share`` of the signal in a block, with noise; a signal counts
    as one sample per autocorrelation time.
    """
    c, finest = Coordinates(model, tuple(varied(free))), 1e-6  # a fit may be exact
    variance = np.diag(c.each("prior_sd") ** 2)
    prior = SwimPrior(c.nominal, variance, np.zeros(len(free)), np.ones((4, 3)))
    problem = SwimProblem(c, swims, simulate, prior)
    nothing: Members = frozenset()
    x = problem.centre(nothing)
    for again in (False, True):
        errors = [signals_at(c, swim, x[None], simulate)[0] - swim.signals for swim in swims]
        rms = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
        problem.weights = []
        for swim, blocks, error in zip(swims, problem.blocks, errors, strict=True):
            size = np.tile(np.maximum(rms, finest), (swim.t.size, 1))
            for a, b in blocks.edges if share is not None else ():
                signal = np.sqrt(np.mean(swim.signals[a:b] ** 2, axis=0))
                size[a:b] = np.hypot(swim.noise_sd, share * signal) + finest
            relative = np.nan_to_num(error / size)
            if again or share is not None:
                size *= np.sqrt([correlation_samples(one) for one in relative.T])
            # signals that were not measured count nothing
            problem.weights.append(np.nan_to_num(1 / size))
        fit = problem.plain(x).fit
        x = fit.x
    normal, meat = problem.covariance(nothing, fit), problem.precision(nothing)
    scores = problem.of_swims(fit.slope * fit.rows[:, None])
    for blocks, score in zip(problem.blocks, scores, strict=True):
        of_blocks = np.add.reduceat(score.sum(axis=1), [a for a, _ in blocks.edges], axis=0)
        meat = meat + long_run(of_blocks, min(2, len(of_blocks)))
    covariance = normal @ meat @ normal
    return c.model_at(x), x, _widened(covariance, np.diag(normal))


def _widened(covariance: Array, variance: Array) -> Array:
    """A covariance (F, F) with at least these variances (F,) and the same correlations."""
    wider = np.sqrt(np.maximum(variance / np.diag(covariance), 1.0))
    return np.asarray(covariance * np.outer(wider, wider))


def _errors(
    swims: Sequence[Swim], models: Sequence[Model], simulator: SwimSimulator, held_out: float
) -> tuple[Array, Array]:
    """Root mean square errors in the held-out and in the fitted part, each (M, 3 + J)."""
    squares = []
    for swim in swims:
        error = simulated(swim, models, simulator) - swim.signals
        cut = round(swim.t.size * (1 - held_out))
        parts = np.split(error**2, [cut], axis=1)
        squares.append([np.nanmean(part, axis=1) for part in parts])
    train, held = np.sqrt(np.mean(squares, axis=0))
    return held, train


@dataclass(frozen=True)
class Calibration(NotebookDisplay):
    """Result of a calibration."""

    model: Model  # the calibrated model, with intervals (``body``) and errors (``fit``)
    before: Model  # the model before the calibration
    robot: Robot  # the robot
    swims: tuple[Swim, ...]  # the fitted swims, whose last parts were held out
    simulator: SwimSimulator  # the twin, or the fluid if there was a fit in the fluid
    twin: Calibrated  # parameters, covariance and errors of the fit in the twin
    in_fluid: Calibrated | None = None  # likewise for the fit in the fluid

    @property
    def fitted(self) -> Calibrated:
        """The fit in the fluid if there was one, else that in the twin."""
        return self.in_fluid or self.twin

    def plot(self, swim: int = 0) -> Figure:
        """One swim: measured, and simulated before and after the calibration."""
        from sim2real.report.series import series_figure

        name = self.swims[swim].name
        return series_figure(self.panels(swim), f"{name}: measured and simulated")

    def panels(self, swim: int) -> list[Panel]:
        """The signals of that plot."""
        from sim.view.swim_page import swim_panels

        models = self.before, self.fitted.model
        return swim_panels(self.swims[swim], models, self.simulator, self.robot)


def calibrate_in_twin(
    swims: Sequence[Swim], model: Model, robot: Robot, *, gains: bool, held_out: float
) -> Calibration:
    """Fit the body to swims in the twin, from a model with servos and perhaps a body."""
    free, simulator = twin_parameters(model, robot, gains=gains), by_twin(robot)
    twin = calibrate(swims, model, free, simulator, held_out=held_out)
    # the twin as it is used later: larger sub-steps act as another latency and another damping
    followed = by_followed_twin(robot, substeps=SUBSTEPS)
    parts = [swim.first(1 - held_out) for swim in swims]
    mean, covariance = marginalised(parts, model, robot, free, twin.best, followed)
    # coefficients of the law keep their intervals: the twin swims with them, and they are not true
    law = np.array([p.name.startswith("twin.") for p in free])
    wider = _widened(twin.covariance, np.where(law, 0.0, np.diag(covariance)))
    twin = replace(twin, centre=np.where(law, twin.best, mean), covariance=wider)
    return Calibration(_with_errors(twin, robot), model, robot, tuple(swims), simulator, twin)


def calibrate_in_fluid(
    begun: Calibration,
    by: Callable[[float], SwimSimulator],
    *,
    cell_m: float,
    rollouts: int,
    gains: bool,
    held_out: float,
    seed: int,
) -> Calibration:
    """Fit water, centre of mass and servos in the fluid, by an ``emulator``, from that in the twin.

    ``by`` gives the fluid in cells of a size. Its error, in cells of 1 cm, is a fifth of the
    signal: a swimmer is up to 12 % too fast or too slow there (``reports/resolution``).
    """
    swims, model, robot, twin = begun.swims, begun.before, begun.robot, begun.twin
    parts = [swim.first(1 - held_out) for swim in swims]
    water, fluid = water_parameters(robot, cell_m), by(cell_m)
    known = zip((p.name for p in twin.free), twin.best.tolist(), strict=True)
    centre = with_values(model, {name: value for name, value in known if "latency" in name})
    centre = replace(centre, body={**model.body, "twin": twin.model.body["twin"]})
    centre = with_values(centre, {water[-1].name: water[-1].nominal})
    servos = servo_parameters(centre, robot, gains=gains)
    free = [*servos, *water, *effect_parameters("com_offset")]

    def fitted(simulator: SwimSimulator, centre: Model, seed: int) -> tuple[Model, Array, Array]:
        near = emulator(simulator, parts, centre, free, count=rollouts, seed=seed)
        return _fit(parts, centre, free, near, 0.2)

    result, best, covariance = fitted(fluid, fitted(fluid, centre, seed)[0], seed + 1)
    grid = None
    with suppress(InputError):
        grid = np.abs(fitted(by(2 * cell_m), result, seed)[1] - best)
    errors = _errors(swims, [model, result], fluid, held_out)
    if not np.isfinite(errors[0]).all():
        raise InputError("calibrate", "fluid", "the robot is stopped", "finer cells, more rollouts")
    noise = np.sqrt(np.mean([swim.noise_sd**2 for swim in swims], axis=0))
    found = Calibrated(result, tuple(free), best, best, covariance, *errors, noise, grid)
    calibrated = _with_errors(found, robot, cell_m)
    return replace(begun, model=calibrated, simulator=fluid, in_fluid=found)


@result_section.register
def _calibration(calibration: Calibration) -> Section:
    twin = calibration.twin
    blocks = _tables(twin, "the twin", calibration.robot)
    shift, sd = np.abs(twin.centre - twin.best), np.sqrt(np.diag(twin.covariance))
    off = shift > np.maximum(3.0 * sd, 0.05 * twin.best)
    if off.any():
        names = ", ".join(p.name for p, one in zip(twin.free, off, strict=True) if one)
        text = "the fitted values make up for gains that are held or for effects that are missing"
        blocks.append(Note("warn", f"{names}: {text}; diagnose these swims"))
    if calibration.in_fluid is not None:
        where = f"the fluid, cells of {calibration.model.body['posterior']['cell_m']:g} m"
        blocks += _tables(calibration.in_fluid, where, calibration.robot)
        if calibration.in_fluid.grid is None:
            text = "the intervals do not include the discretisation error: cells of twice the size"
            blocks.append(Note("warn", f"{text} stop the robot"))
    return Section("Calibration", "", blocks)


def calibration_section(calibration: Calibration) -> Section:
    """The section of a notebook with the first swim plotted, for a page."""
    from sim2real.report.series import series_block

    name, section = calibration.swims[0].name, result_section(calibration)
    caption = f"{name}: measured (simulated with other physics), before and after."
    plot = series_block(calibration.panels(0), name, caption)
    lead = "A swim in the reduced-order twin; the fit does not use its last third."
    return replace(section, lead=lead, blocks=(plot, *section.blocks))


def _tables(fit: Calibrated, where: str, robot: Robot) -> list[Block]:
    """Parameters with intervals, and held-out errors before and after, also without known noise."""
    rows = [
        (p.name, Quantity("value", "", float(best), (float(low), float(high))))
        for p, best, (low, high) in zip(fit.free, fit.best, fit.interval(), strict=True)
    ]
    errors = []
    signals = zip(signals_of_robot(robot).values(), *fit.rmse, fit.noise, strict=True)
    for (name, unit), before, after, noise in signals:
        change, of_it = change_text(before, after), ""
        if noise > 0:
            beyond = (float(np.sqrt(max(x**2 - noise**2, 0.0))) for x in (before, after))
            of_it = f"{change_text(*beyond)} beyond {noise:.4f}"
        errors.append((name, f"{before:.4f}", f"{after:.4f}", unit, change, of_it))
    header = ("held-out error", "before", "after", "unit", "change", "of it beyond the noise")
    parameters = quantity_table(rows, "parameter")
    return [Text("", heading=f"In {where}"), parameters, Table(header, errors)]


def _with_errors(fit: Calibrated, robot: Robot, cell_m: float | None = None) -> Model:
    """The calibrated model with the intervals of its parameters and its errors."""
    if not np.all(np.isfinite(fit.best)):
        raise InputError("calibrate", "fit", "no finite parameters", "recordings that move")
    figures = (row.tolist() for row in (fit.train[1], fit.rmse[1], fit.rmse[0]))
    errors = {
        name: {"train": train, "heldout": after, "heldout_before": before}
        for name, train, after, before in zip(signals_of_robot(robot), *figures, strict=True)
    }
    names, covariance = [p.name for p in fit.free], fit.covariance.tolist()
    of_names = {"names": names, "mean": fit.centre.tolist(), "covariance": covariance}
    posterior = {"cell_m": cell_m, **of_names}
    interval = dict(zip(names, fit.interval().tolist(), strict=True))
    body = {**fit.model.body, "interval": interval, "posterior": posterior}
    joints = dict(fit.model.joints)
    for name, (low, high) in zip(names, fit.interval(fit.model.interval_level), strict=True):
        joint, _, kind = name.partition(".")
        if joint in joints:  # those of a bench are not about the fitted value
            ends = {kind: (max(float(low), 0.0), float(high))}
            joints[joint] = replace(joints[joint], interval={**joints[joint].interval, **ends})
    return replace(fit.model, joints=joints, body=body, fit={**fit.model.fit, **errors})
