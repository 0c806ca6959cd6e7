"""Fit of the law of a motor from several starts, with its data sheet as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import Fit
from sim2real.identification.initial_guess import WINDOW_S
from sim2real.identification.motor_prior import MotorPrior
from sim2real.identification.motor_problem import MOTOR_SEARCH, MotorProblem, MotorSearch
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import OUTLIER_SD, Expansion, minimise, robust_scale, stacked
from sim2real.inference.multi_start import cannot_win
from sim2real.inference.parameters import Parameter
from sim2real.servo.parameters import LOOP, LOSSES, ROTOR, SOFT, motor_of
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

EXPLAINED = 1.15
"""Ratio of residual to noise below which no more parameters are added."""


@dataclass(frozen=True)
class MotorFit:
    """A fitted motor.

    Attributes:
        fit: Parameters, residuals and derivatives.
        loss: Twice the negative log-posterior for the scale and ``inflation`` of this fit; use
            ``loss_at`` to compare fits.
        x: Parameters as searched.
        problem: The problem.
        inflation: Number of samples per independent sample.
        others: Other minima that fit as well or better, as searched, shape (M, F).
    """

    fit: Fit
    loss: float
    x: Array
    problem: MotorProblem
    inflation: float
    others: Array

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
        unit = self.problem.box[2]
        prior_width = np.where(np.isfinite(self.prior_sd), 2 * self.prior_sd, 0.0)
        unit = np.maximum(unit, prior_width)
        return np.where(self.log, unit * self.fit.values, unit)

    @property
    def log(self) -> NDArray[np.bool_]:
        """Which of the free parameters were searched as logarithms, shape (F,)."""
        return np.array([self.problem.prior.parameters[k].log for k in self.problem.free])

    @property
    def prior_sd(self) -> Array:
        """Prior standard deviation of the free parameters, as searched, shape (F,)."""
        return np.array([self.problem.prior.parameters[k].sd for k in self.problem.free])

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Which of the free parameters lie more than two prior standard deviations off, (F,)."""
        parameters = [self.problem.prior.parameters[k] for k in self.problem.free]
        middle = np.array([b.middle for b in parameters])
        deviation = np.abs(self.x[list(self.problem.free)] - middle)
        return np.asarray(deviation > 2 * self.prior_sd)

    @property
    def other_values(self) -> Array:
        """Free parameters at the other minima, in SI units, shape (M, F)."""
        return self.problem.prior.values(self.others)[:, list(self.problem.free)]

    def losses(self, x: Array) -> Array:
        """Losses of parameters as searched (B, F), with the scale of this fit, shape (B,)."""
        return self._losses(self.problem, x)

    def rough_losses(self, x: Array) -> Array:
        """Losses with longer sub-steps, for the choice of starting points, shape (B,)."""
        return self._losses(self.problem.coarse, x)

    def _losses(self, problem: MotorProblem, x: Array) -> Array:
        return _loss(problem, x, problem.residuals(x), self.fit.scale_rad, self.inflation)

    def loss_at(self, scale_rad: float, inflation: float) -> float:
        """The loss for residuals of another scale and correlation."""
        error = np.concatenate(self.fit.residuals)[None]
        return float(_loss(self.problem, self.x[None], error, scale_rad, inflation)[0])


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
    search: MotorSearch = MOTOR_SEARCH,
) -> MotorFit:
    """Fit gains, latency and ``free_names``; other parameters have no effect.

    Candidates drawn from the prior about the plain servo are ranked by their error. Simultaneous
    Levenberg-Marquardt searches start from the best ones and from the plain servo without a limit.
    With losses among the parameters the loss has many minima, as a servo sticks or just does not;
    of those that fit the recordings the one is taken whose neighbours fit best (``_robust_order``).
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
        search: Settings of the search.
    """
    free = tuple(
        k for k, name in enumerate(prior.names) if (gains if k < 3 else name in free_names)
    )
    inertia = traces[0].load.inertia_kgm2
    fastest = np.sqrt(1.5 * max(float(plain.row[0]), 1e-9) / inertia)
    substep = float(min(search.longest_substep_s, 1 / (search.steps_per_radian * fastest)))
    problem = MotorProblem(traces, prior, free, substep, Simulator(traces), search)
    x = _starts(problem, plain, rng, start) if starts is None else starts
    if not gains:
        x = x[:1]  # the linear servo fits: one search, from its values
    elif starts is None:
        window = max((trace.window(WINDOW_S) for trace in traces), key=Trace.activity)
        windowed = replace(problem, traces=[window], simulator=Simulator([window]))
        size = np.mean(np.abs(windowed.residuals(x)), axis=1)
        size[0] = 0.0
        x = x[np.argsort(size)[: search.starts]]
    error = problem.residuals(x)
    error = error[np.argmin(np.mean(np.abs(error), axis=1))]
    scale, inflation, loss = 1.0, 1.0, np.zeros(x.shape[0])
    for number in range(search.rounds):
        before = scale
        scale, inflation = robust_scale(error), _inflation(error, traces)
        if number:
            x, loss = _search(problem, x, scale, inflation, search.later_steps)
        else:
            x, loss = _search(problem.coarse, x, scale, inflation, search.first_steps)
        order = np.argsort(loss)
        x, loss = x[order], loss[order]
        error = problem.residuals(x[:1])[0]
        if number:
            x, loss = x[loss < loss[0] + search.behind], loss[loss < loss[0] + search.behind]
        if number and abs(scale / before - 1) < 0.05:
            break
    if not set(LOSSES).isdisjoint(free_names):
        order = _robust_order(problem, x, scale, inflation, rng)
        x, loss = x[order], loss[order]
    return _result(problem, x, scale, inflation, loss)


def refitted(motor: MotorFit, x: Array, steps: int | None = None) -> list[MotorFit]:
    """Refit with a sampled loop from starts ``x`` (B, F) as searched, best fit first."""
    steps = motor.problem.search.later_steps if steps is None else steps
    period = motor.problem.prior.index(LOOP[0])
    free = tuple(sorted({*motor.problem.free, period}))
    problem = replace(motor.problem, free=free)
    x, loss = _search(problem, x, motor.fit.scale_rad, motor.inflation, steps)
    order = np.argsort(loss)
    inflation = [_inflation(error, problem.traces) for error in problem.residuals(x)]
    scale = motor.fit.scale_rad
    return [_result(problem, x[[k]], scale, inflation[k], loss[[k]]) for k in order]


def soft_starts(motor: MotorFit) -> Array:
    """Starts as searched (S, F) from a fit, with gradual friction."""
    x = np.tile(motor.x, (len(motor.problem.search.soft_s), 1))
    x[:, [motor.problem.prior.index(name) for name in SOFT]] = motor.problem.search.soft_s
    return x


def _inflation(error: Array, traces: Sequence[Trace]) -> float:
    parts = np.split(error, np.cumsum([np.count_nonzero(t.used) for t in traces])[:-1])
    times = [correlation_samples(part) for part in parts]
    return float(np.average(times, weights=[part.size for part in parts]))


def _loss(problem: MotorProblem, x: Array, error: Array, scale: float, inflation: float) -> Array:
    size = OUTLIER_SD * scale
    data = 2 * OUTLIER_SD**2 * (np.sqrt(1 + (error / size) ** 2) - 1).sum(axis=1) / inflation
    return np.asarray(data + (problem.terms(x) ** 2).sum(axis=1))


def _starts(
    problem: MotorProblem, plain: Fit, rng: np.random.Generator, start: Array | None
) -> Array:
    """Candidates (B, F) as searched; the first is ``start`` or the plain servo."""
    prior = problem.prior
    kp, kd = np.maximum(plain.row[:2], 1e-9)
    latency = float(plain.row[2])
    N = problem.search.candidates
    x = np.full((N, len(prior.parameters)), -np.inf)
    for k, parameter in enumerate(prior.parameters):
        x[:, k] = 0.0 if not parameter.log else -np.inf
        if k not in problem.free:
            continue
        width = parameter.sd if np.isfinite(parameter.sd) else 0.0
        drawn = parameter.middle + width * rng.standard_normal(N)
        x[:, k] = drawn if parameter.log or parameter.middle else 0.5 * np.abs(drawn)
    damping = prior.parameters[3].middle - prior.parameters[4].middle
    x[:, 0] = np.log(kp) + rng.uniform(0.0, 1.2, N)
    x[:, 1] = damping + 0.3 * rng.standard_normal(N)
    x[:, 2] = rng.uniform(0.0, max(latency, 0.01), N)
    half = N // 2
    x[:half, :3] = np.log(kp), np.log(kd), latency
    x[0, 3:5] += np.where(np.isfinite(x[0, 3:5]), 2.0, 0.0)
    if start is not None:
        x[0] = start
        x[0, [k for k in problem.free if np.isneginf(start[k])]] = x[
            1, [k for k in problem.free if np.isneginf(start[k])]
        ]
    low, high, _ = problem.box
    x[:, problem.free] = np.clip(x[:, problem.free], low, high)
    return x


def _search(
    problem: MotorProblem, x: Array, scale: float, inflation: float, steps: int
) -> tuple[Array, Array]:
    """Searches from all of ``x`` (S, F), and their losses (S,)."""
    low, high, unit = problem.box
    free, search = list(problem.free), problem.search
    latest: dict[int, Array] = {}

    def servos_at(points: Array, index: NDArray[np.intp]) -> Array:
        servos = x[index].copy()
        servos[:, free] = points * unit
        return servos

    def losses(points: Array, index: NDArray[np.intp]) -> Array:
        servos = servos_at(points, index)
        error = problem.residuals(servos)
        latest.update(zip(index.tolist(), error, strict=True))
        return 0.5 * _loss(problem, servos, error, scale, inflation)

    def expand(points: Array, index: NDArray[np.intp]) -> Expansion:
        if not set(index.tolist()) <= latest.keys():
            losses(points, index)
        return stacked(
            [
                expansion_at(servo, latest[k])
                for servo, k in zip(servos_at(points, index), index.tolist(), strict=True)
            ]
        )

    def expansion_at(servo: Array, error: Array) -> Expansion:
        _, slopes = problem.coarse.slopes(servo)
        prior, prior_slopes = problem.prior_slopes(servo)
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * scale)) ** 2) / scale**2 / inflation
        weighted = slopes * weight[:, None]
        loss = 0.5 * _loss(problem, servo[None], error[None], scale, inflation)
        slope = weighted.T @ error + prior_slopes.T @ prior
        curvature = slopes.T @ weighted + prior_slopes.T @ prior_slopes
        return Expansion(loss, slope[None], curvature[None], {})

    minimum = minimise(
        expand,
        x[:, free] / unit,
        np.tile(low / unit, (len(x), 1)),
        np.tile(high / unit, (len(x), 1)),
        evaluations=steps,
        settled=search.settled,
        hopeless=partial(
            cannot_win, same=search.same, behind=search.behind, optimism=search.promise
        ),
        losses=losses,
        look_every=1,
    )
    return servos_at(minimum.x, np.arange(len(x))), 2 * minimum.expansion.loss


def _robust_order(
    problem: MotorProblem, x: Array, scale: float, inflation: float, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Indices of minima (M, F) by the mean loss of their neighbours, smallest first.

    Neighbours differ in rotor inertia and losses by a small share of the prior's width. A narrow
    minimum owes its small loss to a coincidence, for instance of the moment at which the shaft
    sticks, and predicts other motions badly; so the expected loss of uncertain parameters is what
    counts (robust optimisation: Beyer and Sendhoff, Computer Methods in Applied Mechanics and
    Engineering 196 (2007) 3190-3218, sec. 2.2).
    """
    search, prior = problem.search, problem.prior
    varied = [k for k in problem.free if prior.parameters[k].name in (ROTOR, *LOSSES)]
    width = search.neighbourhood * np.array([prior.parameters[k].sd for k in varied])
    offset = width * rng.standard_normal((search.neighbours, len(varied)))
    low, high, _ = problem.box
    means = np.empty(len(x))
    for k, minimum in enumerate(x):
        nearby = np.tile(minimum, (search.neighbours, 1))
        nearby[:, varied] += offset
        # A loss below 0 is reflected.
        moved = np.maximum(nearby[:, problem.free], 2 * low - nearby[:, problem.free])
        nearby[:, problem.free] = np.minimum(moved, high)
        error = problem.coarse.residuals(nearby)
        means[k] = _loss(problem, nearby, error, scale, inflation).mean()
    return np.argsort(means)


def _result(
    problem: MotorProblem, minima: Array, scale: float, inflation: float, losses: Array
) -> MotorFit:
    """The fit at the first of some minima (M, F), in SI units of the parameters."""
    prior, free, x = problem.prior, list(problem.free), minima[0]
    error, slopes = problem.slopes(x)
    values = prior.values(x)
    factor = np.array([values[k] if prior.parameters[k].log else 1.0 for k in free])
    unit = problem.box[2]
    _, prior_jacobian = problem.prior_slopes(x)
    prior_slope = prior_jacobian / unit / factor
    counts = np.cumsum([np.count_nonzero(t.used) for t in problem.traces])[:-1]
    parameters = [prior.parameters[k] for k in free]
    fit = Fit(
        parameters=tuple(
            Parameter(b.name, b.low, b.high, u, log=b.log)
            for b, u in zip(parameters, unit * factor, strict=True)
        ),
        row=problem.rows(x[None])[0],
        scale_rad=robust_scale(error),
        residuals=tuple(np.split(error, counts)),
        jacobians=tuple(np.split(slopes / unit / factor, counts)),
        converged=True,
        inertia=problem.traces[0].load.inertia_kgm2,
        prior=prior_slope.T @ prior_slope,
        tempering=scale**2 * inflation,
    )
    as_good = losses[1:] < losses[0] + problem.search.as_good
    return MotorFit(fit, float(losses[0]), x, problem, inflation, minima[1:][as_good])
