"""Fit of the law of a motor from several starts, with its data sheet as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.identification.fit import Fit, scale_inertia, split_by_trace
from sim2real.identification.motor_prior import MotorPrior
from sim2real.identification.motor_problem import MotorProblem, robust_order
from sim2real.inference.least_squares import (
    OUTLIER_SD,
    Expansion,
    cannot_win,
    minimise,
    robust_scale,
)
from sim2real.inference.parameters import column
from sim2real.model import FittedEffect, Law
from sim2real.servo.parameters import (
    COLUMNS,
    CURRENT_LIMIT,
    INERTIA_LEFT_OUT,
    LOOP,
    LOSSES,
    ROTOR,
    motor_of,
)
from sim2real.servo.rollout import SHORTEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

EXPLAINED = 1.15
"""Ratio of residual to noise below which no more parameters are added."""
_GAINS = 3
"""Number of the first parameters of a prior: gains and latency."""


@dataclass(frozen=True)
class MotorFit:
    """A fitted motor.

    Attributes:
        fit: Parameters, residuals and derivatives.
        x: Parameters as searched.
        problem: The problem.
        inflation: Number of samples per independent sample.
        others: Other minima that fit as well or better, as searched, shape (M, F).
    """

    fit: Fit
    x: Array
    problem: MotorProblem
    inflation: float
    others: Array

    @property
    def with_gains(self) -> bool:
        """Whether the gains were fitted as well."""
        return 0 in self.problem.free

    @property
    def law(self) -> Law:
        """Name of its law: that of the limit of its torque."""
        return "motor" if self.problem.prior.damping_share is None else "current_limited"

    @property
    def effects(self) -> tuple[FittedEffect, ...]:
        """Effects that state a part of its law: a current limit below the torque-speed line."""
        limit = float(self.fit.row[COLUMNS.index(CURRENT_LIMIT)])
        effect, _, parameter = CURRENT_LIMIT.rpartition(".")
        return (FittedEffect(effect, {parameter: limit}),) if limit else ()

    @property
    def free_names(self) -> tuple[str, ...]:
        """Columns that were fitted in addition to gains and latency."""
        return tuple(self.problem.prior.names[k] for k in self.problem.free if k >= _GAINS)

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

    @property
    def other_values(self) -> Array:
        """Free parameters at the other minima, in SI units, shape (M, F)."""
        return self.problem.prior.values(self.others)[:, list(self.problem.free)]

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

    def evidence(self, scale_rad: float, inflation: float) -> float:
        """Logarithm of the marginal likelihood by Laplace's method, up to a constant.

        MacKay, Information Theory, Inference, and Learning Algorithms (Cambridge, 2003), ch. 27;
        for residuals of a given scale and correlation, so that fits are comparable.
        """
        slopes = np.concatenate(self.fit.jacobians)
        assert self.fit.prior is not None
        curvature = slopes.T @ slopes / (scale_rad**2 * inflation) + self.fit.prior
        size = np.where(self.log_scale, self.fit.values, 1.0)  # by a logarithm, as searched
        _, volume = np.linalg.slogdet(curvature * np.outer(size, size))
        widths = self.problem.prior.widths(self.problem.free)
        freedom = 0.5 * len(self.problem.free) * np.log(2 * np.pi)
        occam = freedom - 0.5 * volume - np.sum(np.log(np.sqrt(2 * np.pi) * widths))
        return float(occam - 0.5 * self.loss_at(scale_rad, inflation))


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
    candidates: int = 64,
    searches: int = 4,
    rounds: int = 4,
    first_steps: int = 20,
    later_steps: int = 10,
    behind: float = 30.0,
    least_gain: float = 0.0,
    longest_substep_s: float = 0.002,
    steps_per_radian: float = 32.0,
) -> MotorFit:
    """Fit gains, latency and ``free_names``; other parameters have no effect.

    Candidates drawn from the prior about the plain servo are ranked by their error. Simultaneous
    Levenberg-Marquardt searches start from the best ones and from the plain servo without a limit.
    With losses among the parameters the loss has many minima, as a servo sticks or just does not;
    of those that fit the recordings the one is taken whose neighbours fit best (``robust_order``).
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
        candidates: Number of servos drawn from the prior.
        searches: Number of the best candidates, from which searches start.
        rounds: Number of rounds, between which the scale of the residual is estimated again.
        first_steps: Largest number of steps of a search in the first round.
        later_steps: Largest number of steps of a search in later rounds.
        behind: Largest difference of log-likelihood to the best search at which one continues.
        least_gain: Decrease of half the loss, from the first start, without which a few steps of
            all searches are enough: their best is returned as it is.
        longest_substep_s: Longest sub-step of a rollout, s.
        steps_per_radian: Sub-steps per radian of the fastest mode.
    """
    free = tuple(
        k for k, name in enumerate(prior.names) if (gains if k < _GAINS else name in free_names)
    )
    inertia = scale_inertia(traces, plain.row)
    fastest = np.sqrt(1.5 * max(float(plain.row[0]), 1e-9) / inertia)
    resolved = max(1 / (steps_per_radian * fastest), SHORTEST_SUBSTEP_S)
    substep = float(min(longest_substep_s, resolved))
    simulator = Simulator(traces)
    problem = MotorProblem(traces, prior, free, substep, simulator, later_steps, behind)
    x = _candidates(problem, plain, rng, start, candidates) if starts is None else starts
    if not gains:
        x = x[:1]  # the linear servo fits: one search, from its values
    elif starts is None:
        window = max((trace.window() for trace in traces), key=Trace.activity)
        windowed = replace(problem, traces=[window], simulator=Simulator([window]))
        size = np.mean(np.abs(windowed.residuals(x)), axis=1)
        size[0] = 0.0
        x = x[np.argsort(size)[:searches]]
    error = problem.residuals(x)
    error = error[np.argmin(np.mean(np.abs(error), axis=1))]
    scale, inflation = 1.0, 1.0
    for number in range(rounds):
        before = scale
        scale, inflation = robust_scale(error), problem.inflation(error)
        searched, steps = (problem, later_steps) if number else (problem.coarse, first_steps)
        least = 0.0 if number else least_gain
        x, loss, gain = _search(searched, x, scale, inflation, steps, least)
        order = np.argsort(loss)
        x, loss = x[order], loss[order]
        if gain < least:
            return _result(problem, x[:1], loss[:1], scale, inflation)
        error = problem.residuals(x[:1])[0]
        if number:
            x, loss = x[loss < loss[0] + behind], loss[loss < loss[0] + behind]
        if number and abs(scale / before - 1) < 0.05:
            break
    if not set(LOSSES).isdisjoint(free_names):
        order = robust_order(problem, x, scale, inflation, rng)
        x, loss = x[order], loss[order]
    return _result(problem, x, loss, scale, inflation)


def refitted(motor: MotorFit, x: Array, steps: int | None = None) -> MotorFit:
    """The best refit with a sampled loop from starts ``x`` (B, F) as searched.

    A search has at most ``steps`` steps, by default those of the motor's later rounds.
    """
    steps = motor.problem.steps if steps is None else steps
    period = motor.problem.prior.index(LOOP[0])
    problem = replace(motor.problem, free=tuple(sorted({*motor.problem.free, period})))
    x, loss, _ = _search(problem, x, motor.fit.scale_rad, motor.inflation, steps)
    best = np.argsort(loss)[:1]
    inflation = problem.inflation(problem.residuals(x[best])[0])
    return _result(problem, x[best], loss[best], motor.fit.scale_rad, inflation)


def _candidates(
    problem: MotorProblem, plain: Fit, rng: np.random.Generator, start: Array | None, B: int
) -> Array:
    """Candidates (B, F) as searched; the first is ``start`` or the plain servo."""
    prior = problem.prior
    kp, kd = np.maximum(plain.row[:2], 1e-9)
    latency = float(plain.row[2])
    x = np.full((B, len(prior.parameters)), -np.inf)
    for k, parameter in enumerate(prior.parameters):
        x[:, k] = -np.inf if parameter.log else 0.0
        if k not in problem.free:
            continue
        width = parameter.prior_sd if np.isfinite(parameter.prior_sd) else 0.0
        drawn = parameter.nominal + width * rng.standard_normal(B)
        x[:, k] = drawn if parameter.log or parameter.nominal else 0.5 * np.abs(drawn)
    damping = prior.parameters[3].nominal - prior.parameters[4].nominal
    x[:, 0] = np.log(kp) + rng.uniform(0.0, 1.2, B)
    x[:, 1] = damping + 0.3 * rng.standard_normal(B)
    x[:, 2] = rng.uniform(0.0, max(latency, 0.01), B)
    x[: B // 2, :3] = np.log(kp), np.log(kd), latency
    rotor, place = float(plain.row[INERTIA_LEFT_OUT]), prior.index(ROTOR)
    if rotor > 0 and place in problem.free:
        x[: B // 2, place] = np.log(rotor)
    x[0, 3:5] += np.where(np.isfinite(x[0, 3:5]), 2.0, 0.0)
    if start is not None:
        missing = [k for k in problem.free if np.isneginf(start[k])]
        x[0] = start
        x[0, missing] = x[1, missing]
    low, high, _ = problem.box
    x[:, problem.free] = np.clip(x[:, problem.free], low, high)
    return x


def _search(
    problem: MotorProblem,
    x: Array,
    scale: float,
    inflation: float,
    steps: int,
    least_gain: float = 0.0,
    *,
    patience: int = 8,
) -> tuple[Array, Array, float]:
    """Searches from all of ``x`` (S, F), their losses (S,), and what the best gains on the first.

    They end after ``patience`` steps if that is less than ``least_gain``, in half losses.
    """
    *ends, unit = problem.box
    free = list(problem.free)
    is_coarse = problem.coarse.substep_s == problem.substep_s
    latest: dict[int, Array] = {}
    first: list[float] = []  # loss of the first search, at every look

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
        servos, error = servos_at(points, index), np.array([latest[k] for k in index.tolist()])
        _, slopes = problem.coarse.slopes(servos, error if is_coarse else None)
        prior, prior_slopes = problem.prior_slopes(servos)
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * scale)) ** 2) / scale**2 / inflation
        weighted = slopes * weight[:, :, None]
        loss = 0.5 * problem.loss(servos, error, scale, inflation)
        slope = _products(weighted, error[:, :, None]) + _products(prior_slopes, prior[:, :, None])
        curvature = _products(slopes, weighted) + _products(prior_slopes, prior_slopes)
        return Expansion(loss, slope[:, :, 0], curvature, {})

    def hopeless(active: Index, points: Array, losses: Array, promised: Array) -> Mask:
        first.append(float(losses[0]))
        if len(first) == patience and first[0] - losses.min() < least_gain:
            return np.ones(active.size, dtype=bool)
        return cannot_win(active, points, losses, promised, behind=problem.behind)

    minimum = minimise(
        expand,
        x[:, free] / unit,
        *(np.tile(end / unit, (len(x), 1)) for end in ends),
        evaluations=steps,
        settled=1e-3,
        hopeless=hopeless,
        losses=losses,
        look_every=1,
    )
    loss = minimum.expansion.loss
    gain = first[0] - float(loss.min()) if first else 0.0
    return servos_at(minimum.x, np.arange(len(x))), 2 * loss, gain


def _products(first: Array, second: Array) -> Array:
    """Inner products of columns, (M, n, F) and (M, n, G) to (M, F, G)."""
    return np.asarray(first.swapaxes(1, 2) @ second)


def _result(
    problem: MotorProblem,
    minima: Array,
    loss: Array,
    scale: float,
    inflation: float,
    *,
    as_good: float = 2.0,
) -> MotorFit:
    """The fit at the first of some minima (M, F), in SI units of the parameters.

    Others count as fitting as well if their ``loss`` (M,), twice the negative log-posterior, is
    larger by less than ``as_good``.
    """
    x = minima[0]
    (error,), (slopes,) = problem.slopes(minima[:1])
    row, unit = problem.rows(x[None])[0], problem.box[2]
    values = problem.prior.values(x)
    factor = np.array([values[k] if problem.prior.parameters[k].log else 1.0 for k in problem.free])
    prior_slope = problem.prior_slopes(minima[:1])[1][0] / unit / factor
    fit = Fit(
        parameters=problem.parameters,
        row=row,
        scale_rad=robust_scale(error),
        residuals=split_by_trace(error, problem.traces),
        jacobians=split_by_trace(slopes / unit / factor, problem.traces),
        converged=True,
        inertia=scale_inertia(problem.traces, row),
        prior=prior_slope.T @ prior_slope,
        tempering=scale**2 * inflation,
    )
    others = minima[1:][loss[1:] < loss[0] + as_good]
    return MotorFit(fit, x, problem, inflation, others)
