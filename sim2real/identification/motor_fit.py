"""Fit of the law of a motor from several starts, with its data sheet as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.identification.fit import WINDOW_S, Fit, errors, plain_row, split_by_trace
from sim2real.identification.motor_prior import MotorPrior
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import (
    OUTLIER_SD,
    Expansion,
    cannot_win,
    minimise,
    robust_scale,
    stacked,
)
from sim2real.inference.parameters import Parameter, column
from sim2real.servo.parameters import BASE, COLUMNS, LOOP, SOFT, motor_of
from sim2real.servo.rollout import Simulator, coarse_substep
from sim2real.servo.trace import Trace

EXPLAINED = 1.15
"""Ratio of residual to noise below which no more parameters are added."""
_CANDIDATES, _STARTS = 64, 4
"""Number of servos drawn from the prior, and of the best ones, from which searches start."""
_ROUNDS = 4
"""Number of rounds, between which the scale of the residual is estimated again."""
_FIRST_STEPS, _LATER_STEPS = 20, 10
"""Largest number of steps of a search in the first and in later rounds."""
_SOFT_S = ((1e-3, 3e-4), (0.01, 1e-3), (0.01, 5e-3))
"""Starting values of stick and creep time: nearly 0, MuJoCo's, and larger ones."""
_DIFFERENCE = 1e-3
"""Step of the derivatives, in units."""
_SETTLED = 1e-3
"""Expected gain in log-likelihood below which a search ends."""
_LONGEST_SUBSTEP_S, _STEPS_PER_RADIAN = 0.002, 32.0
"""Longest sub-step, and sub-steps per radian of the fastest mode."""
_LATENCY, _PERIOD, _PHASE = (COLUMNS.index(name) for name in (BASE[2], *LOOP))


@dataclass(frozen=True)
class MotorProblem:
    """Recordings of a motor, its prior, and which parameters are fitted.

    Attributes:
        traces: The recordings of one joint.
        prior: Prior of the N parameters.
        free: Indices of the F fitted ones.
        substep_s: Longest sub-step of a rollout, s.
        simulator: Simulator of these traces.
    """

    traces: Sequence[Trace]
    prior: MotorPrior
    free: tuple[int, ...]
    substep_s: float
    simulator: Simulator

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return tuple(self.prior.parameters[k] for k in self.free)

    @property
    def box(self) -> tuple[Array, Array, Array]:
        """Smallest and largest values as searched, and units, of the free parameters."""
        ends = [
            (np.log(p.low), np.log(p.high)) if p.log else (p.low, p.high) for p in self.parameters
        ]
        low, high = np.array(ends).T
        return low, high, column(self.parameters, "typical")

    @property
    def coarse(self) -> MotorProblem:
        """This problem with longer sub-steps, see ``rollout.coarse_substep``."""
        return replace(self, substep_s=float(coarse_substep(np.array(self.substep_s))))

    def rows(self, x: Array) -> Array:
        """Rows of the servo's parameters for those searched, (B, F) to (B, P).

        The searched phase of a sampled loop is relative to the latency, so that a change of latency
        shifts both and does not move a set-point to another sample.
        """
        rows = np.tile(plain_row(0.0, 0.0, 0.0), (x.shape[0], 1))
        rows[:, [COLUMNS.index(name) for name in self.prior.names]] = self.prior.values(x)
        period = rows[:, _PERIOD]
        phase = (rows[:, _PHASE] + rows[:, _LATENCY]) % np.where(period > 0, period, 1.0)
        rows[:, _PHASE] = np.where(period > 0, phase, 0.0)
        return rows

    def residuals(self, x: Array) -> Array:
        """Simulated minus measured angles of all traces, shape (B, n)."""
        return np.concatenate(errors(self.simulator, self.rows(x), self.substep_s), axis=1)

    def terms(self, x: Array) -> Array:
        """The prior's residuals, which are 0 for fixed parameters."""
        fixed = np.setdiff1d(np.arange(3, x.shape[1]), self.free)
        replaced = x.copy()
        replaced[:, fixed] = [self.prior.parameters[k].nominal for k in fixed]
        terms = self.prior.terms(replaced)
        terms[:, fixed] = 0.0
        if not {3, 4} <= set(self.free):
            terms[:, -2:] = 0.0
        return terms

    def loss(self, x: Array, error: Array, scale: float, inflation: float) -> Array:
        """Twice the negative log-posterior of ``x`` (B, F) with residuals (B, n), shape (B,)."""
        size = OUTLIER_SD * scale
        data = 2 * OUTLIER_SD**2 * (np.sqrt(1 + (error / size) ** 2) - 1).sum(axis=1) / inflation
        return np.asarray(data + (self.terms(x) ** 2).sum(axis=1))

    def inflation(self, error: Array) -> float:
        """Number of samples of a residual (n,) per independent sample."""
        parts = split_by_trace(error, self.traces)
        times = [correlation_samples(part) for part in parts]
        return float(np.average(times, weights=[part.size for part in parts]))

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives by the free parameters, in units, (n, F)."""
        _, high, unit = self.box
        ahead = x[list(self.free)] + _DIFFERENCE * unit
        step = np.where(ahead > high, -_DIFFERENCE, _DIFFERENCE)
        base, *moved = self.residuals(np.stack([x, *self._perturbed(x, step)]))
        return base, np.asarray((np.array(moved) - base).T / step)

    def prior_slopes(self, x: Array) -> tuple[Array, Array]:
        """The prior's residuals (m,) and derivatives, in units, (m, F)."""
        base, *moved = self.terms(np.stack([x, *self._perturbed(x, np.full(len(self.free), 1e-5))]))
        return base, np.asarray((np.array(moved) - base).T / 1e-5)

    def _perturbed(self, x: Array, step: Array) -> Array:
        """Points that differ from ``x`` by a step of one free parameter each, (F, N)."""
        points = np.tile(x, (len(self.free), 1))
        points[np.arange(len(self.free)), self.free] += step * self.box[2]
        return points


@dataclass(frozen=True)
class MotorFit:
    """A fitted motor.

    Attributes:
        fit: Parameters, residuals and derivatives.
        x: Parameters as searched.
        problem: The problem.
        inflation: Number of samples per independent sample.
    """

    fit: Fit
    x: Array
    problem: MotorProblem
    inflation: float

    @property
    def with_gains(self) -> bool:
        """Whether the gains were fitted as well."""
        return 0 in self.problem.free

    @property
    def values(self) -> dict[str, float]:
        """The motor's parameters by name; those that have no effect are left out."""
        return motor_of(self.fit.row)

    @property
    def units(self) -> Array:
        """Sizes of the free parameters in their own units, shape (F,).

        At least twice the standard deviation of the prior, so that a parameter that only the prior
        determines does not count as undetermined.
        """
        sd = column(self.fit.parameters, "prior_sd")
        prior_width = np.where(np.isfinite(sd), 2 * sd, 0.0)
        unit = np.maximum(column(self.fit.parameters, "typical"), prior_width)
        return np.where(self.log_scale, unit * self.fit.values, unit)

    @property
    def log_scale(self) -> Mask:
        """Which of the free parameters were searched as logarithms, shape (F,)."""
        return np.array([p.log for p in self.fit.parameters])

    def losses(self, x: Array, *, coarse: bool = False) -> Array:
        """Losses of parameters as searched (B, F), with the scale of this fit, shape (B,).

        Args:
            x: The parameters.
            coarse: Whether longer sub-steps do, for the choice of starting points.
        """
        problem = self.problem.coarse if coarse else self.problem
        return problem.loss(x, problem.residuals(x), self.fit.scale_rad, self.inflation)

    def loss_at(self, scale_rad: float, inflation: float) -> float:
        """The loss for residuals of another scale and correlation, to compare fits."""
        error = np.concatenate(self.fit.residuals)[None]
        return float(self.problem.loss(self.x[None], error, scale_rad, inflation)[0])


def fit_motor(
    traces: Sequence[Trace],
    plain: Fit,
    prior: MotorPrior,
    free_names: Sequence[str],
    rng: np.random.Generator,
    *,
    start: Array | None = None,
    starts: Array | None = None,
    gains: bool = True,
) -> MotorFit:
    """Fit gains, latency and ``free_names``; other parameters have no effect.

    Candidates drawn from the prior about the plain servo are ranked by their error. Simultaneous
    Levenberg-Marquardt searches start from the best ones and from the plain servo without a limit.
    The likelihood counts correlated residuals as fewer samples, so that misfit does not outweigh
    the prior; its scale is estimated again between rounds.

    Args:
        traces: The joint's recordings.
        plain: The fit of the plain servo.
        prior: Prior of the parameters.
        free_names: Columns to fit in addition to gains and latency.
        rng: Generator for the candidates.
        start: A further start as searched, shape (F,).
        starts: The only starts as searched, shape (S, F).
        gains: Whether gains and latency are fitted; else those of the plain servo are kept.
    """
    free = tuple(
        k for k, name in enumerate(prior.names) if (gains if k < 3 else name in free_names)
    )
    inertia = traces[0].load.inertia_kgm2
    fastest = np.sqrt(1.5 * max(float(plain.row[0]), 1e-9) / inertia)
    substep = float(min(_LONGEST_SUBSTEP_S, 1 / (_STEPS_PER_RADIAN * fastest)))
    problem = MotorProblem(traces, prior, free, substep, Simulator(traces))
    x = _candidates(problem, plain, rng, start) if starts is None else starts
    if not gains:
        x = x[:1]  # the linear servo fits: one search, from its values
    elif starts is None:
        window = max((trace.window(WINDOW_S) for trace in traces), key=Trace.activity)
        windowed = replace(problem, traces=[window], simulator=Simulator([window]))
        size = np.mean(np.abs(windowed.residuals(x)), axis=1)
        size[0] = 0.0
        x = x[np.argsort(size)[:_STARTS]]
    error = problem.residuals(x)
    error = error[np.argmin(np.mean(np.abs(error), axis=1))]
    scale, inflation = 1.0, 1.0
    for number in range(_ROUNDS):
        before = scale
        scale, inflation = robust_scale(error), problem.inflation(error)
        if number:
            x, loss = _search(problem, x, scale, inflation, _LATER_STEPS)
        else:
            x, loss = _search(problem.coarse, x, scale, inflation, _FIRST_STEPS)
        order = np.argsort(loss)
        x, loss = x[order], loss[order]
        error = problem.residuals(x[:1])[0]
        if number:
            x = x[loss < loss[0] + 30]
        if number and abs(scale / before - 1) < 0.05:
            break
    return _result(problem, x[0], scale, inflation)


def refitted(motor: MotorFit, x: Array, steps: int = _LATER_STEPS) -> MotorFit:
    """The best refit with a sampled loop from starts ``x`` (B, F) as searched."""
    period = motor.problem.prior.index(LOOP[0])
    problem = replace(motor.problem, free=tuple(sorted({*motor.problem.free, period})))
    x, loss = _search(problem, x, motor.fit.scale_rad, motor.inflation, steps)
    best = x[np.argsort(loss)[0]]
    inflation = problem.inflation(problem.residuals(best[None])[0])
    return _result(problem, best, motor.fit.scale_rad, inflation)


def averaged(fits: Sequence[MotorFit]) -> MotorFit:
    """Mean of fits with the same free parameters, evaluated with the prior of the first.

    The mean is that of the searched variables: the logarithms of gains, torque and speed.
    """
    first = fits[0]
    x = np.mean([fit.x for fit in fits], axis=0)
    return _result(first.problem, x, first.fit.scale_rad, first.inflation)


def soft_starts(motor: MotorFit) -> Array:
    """Starts as searched (S, F) from a fit, with gradual friction."""
    x = np.tile(motor.x, (len(_SOFT_S), 1))
    x[:, [motor.problem.prior.index(name) for name in SOFT]] = _SOFT_S
    return x


def _candidates(
    problem: MotorProblem, plain: Fit, rng: np.random.Generator, start: Array | None
) -> Array:
    """Candidates (B, F) as searched; the first is ``start`` or the plain servo."""
    prior = problem.prior
    kp, kd = np.maximum(plain.row[:2], 1e-9)
    latency = float(plain.row[2])
    x = np.full((_CANDIDATES, len(prior.parameters)), -np.inf)
    for k, parameter in enumerate(prior.parameters):
        x[:, k] = -np.inf if parameter.log else 0.0
        if k not in problem.free:
            continue
        width = parameter.prior_sd if np.isfinite(parameter.prior_sd) else 0.0
        drawn = parameter.nominal + width * rng.standard_normal(_CANDIDATES)
        x[:, k] = drawn if parameter.log or parameter.nominal else 0.5 * np.abs(drawn)
    damping = prior.parameters[3].nominal - prior.parameters[4].nominal
    x[:, 0] = np.log(kp) + rng.uniform(0.0, 1.2, _CANDIDATES)
    x[:, 1] = damping + 0.3 * rng.standard_normal(_CANDIDATES)
    x[:, 2] = rng.uniform(0.0, max(latency, 0.01), _CANDIDATES)
    x[: _CANDIDATES // 2, :3] = np.log(kp), np.log(kd), latency
    x[0, 3:5] += np.where(np.isfinite(x[0, 3:5]), 2.0, 0.0)
    if start is not None:
        missing = [k for k in problem.free if np.isneginf(start[k])]
        x[0] = start
        x[0, missing] = x[1, missing]
    low, high, _ = problem.box
    x[:, problem.free] = np.clip(x[:, problem.free], low, high)
    return x


def _search(
    problem: MotorProblem, x: Array, scale: float, inflation: float, steps: int
) -> tuple[Array, Array]:
    """Searches from all of ``x`` (S, F), and their losses (S,)."""
    low, high, unit = problem.box
    free = list(problem.free)
    latest: dict[int, Array] = {}

    def servos_at(points: Array, index: Index) -> Array:
        servos = x[index].copy()
        servos[:, free] = points * unit
        return servos

    def losses(points: Array, index: Index) -> Array:
        servos = servos_at(points, index)
        error = problem.residuals(servos)
        latest.update(zip(index.tolist(), error, strict=True))
        return 0.5 * problem.loss(servos, error, scale, inflation)

    def expand(points: Array, index: Index) -> Expansion:
        if not set(index.tolist()) <= latest.keys():
            losses(points, index)
        servos = servos_at(points, index)
        pairs = zip(servos, index, strict=True)
        return stacked([expansion_at(servo, latest[k]) for servo, k in pairs])

    def expansion_at(servo: Array, error: Array) -> Expansion:
        _, slopes = problem.coarse.slopes(servo)
        prior, prior_slopes = problem.prior_slopes(servo)
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * scale)) ** 2) / scale**2 / inflation
        weighted = slopes * weight[:, None]
        loss = 0.5 * problem.loss(servo[None], error[None], scale, inflation)
        slope = weighted.T @ error + prior_slopes.T @ prior
        curvature = slopes.T @ weighted + prior_slopes.T @ prior_slopes
        return Expansion(loss, slope[None], curvature[None], {})

    minimum = minimise(
        expand,
        x[:, free] / unit,
        np.tile(low / unit, (len(x), 1)),
        np.tile(high / unit, (len(x), 1)),
        evaluations=steps,
        settled=_SETTLED,
        hopeless=cannot_win,
        losses=losses,
        look_every=1,
    )
    return servos_at(minimum.x, np.arange(len(x))), 2 * minimum.expansion.loss


def _result(problem: MotorProblem, x: Array, scale: float, inflation: float) -> MotorFit:
    """The fit, in SI units of the parameters."""
    error, slopes = problem.slopes(x)
    row, unit = problem.rows(x[None])[0], problem.box[2]
    values = problem.prior.values(x)
    factor = np.array([values[k] if problem.prior.parameters[k].log else 1.0 for k in problem.free])
    prior_slope = problem.prior_slopes(x)[1] / unit / factor
    fit = Fit(
        parameters=problem.parameters,
        row=row,
        scale_rad=robust_scale(error),
        residuals=split_by_trace(error, problem.traces),
        jacobians=split_by_trace(slopes / unit / factor, problem.traces),
        converged=True,
        inertia=problem.traces[0].load.inertia_kgm2,
        prior=prior_slope.T @ prior_slope,
        tempering=scale**2 * inflation,
    )
    return MotorFit(fit, x, problem, inflation)
