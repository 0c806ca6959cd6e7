"""Measured error of the twin, which counts as noise in fits of swims, and the thresholds.

It is measured on swims in which nothing is missing, of many robots
(``benchmarks/pool_law_error.py``, ``pool_decisions.py``), and of one robot from its references.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim.inference.coordinates import LATENCY, Coordinates
from sim.inference.signal_error import BANDS, ROWS
from sim.inference.swim_problem import Fit, SwimPrior, SwimProblem
from sim.inference.swims import Swim, SwimSimulator
from sim2real.arrays import Array
from sim2real.inference.parameters import Parameter
from sim2real.inference.selection import Members
from sim2real.model import Model
from sim2real.robot import Robot
from sim2real.structured import read_json

FILE = Path(__file__).with_name("law_error.json")
IN_WATER = Path(__file__).with_name("law_error_in_water.json")
"""The error of a twin that is corrected by the fluid (``in_water``)."""
SCHEMA = "sim2real.law_error/1"
RELATIVE = ("servo.kp_Nm_per_rad", "servo.kd_Nms_per_rad")
"""Kinds of columns whose sizes are relative to their values."""
NEVER = 1e-3
"""Standard deviation of columns that the error does not imitate, in steps of derivatives."""


@dataclass(frozen=True)
class LawError:
    """Measured error of the twin."""

    # error as a share of a signal's size, by signal (surge, sway, yaw rate, joints) and band (slow,
    # beat, fast), shape (4, 3)
    shares: Array
    # by kind of column, the standard deviation between swims of one robot: of shapes of the error
    # (``signal_error``), or of servos, law and absent effects that it imitates
    imitated: Mapping[str, float]
    # standard deviation between robots, of the part common to a robot's swims
    unknown: Mapping[str, float]
    usual: Mapping[str, float]  # mean of the law's coefficients over robots
    shift: Mapping[str, float]  # mean over robots of their difference from the nominal coefficients
    # thresholds, and the weights of curves as ``curve: term``, by name
    decisions: Mapping[str, float]

    def prior(self, coordinates: Coordinates) -> SwimPrior:
        """Prior of a swim of a robot without reference swims."""
        columns = coordinates.columns

        def sizes(table: Mapping[str, float], others: Array) -> Array:
            """The size of each column; that of a gain is relative to its nominal value."""
            units = [abs(c.nominal) if c.kind in RELATIVE else 1.0 for c in columns]
            known = [table.get(c.kind, np.nan) * u for c, u in zip(columns, units, strict=True)]
            return np.where(np.isnan(known), others, known)

        imitation = sizes(self.imitated, NEVER * coordinates.each("step"))
        mean = [self.usual.get(c.kind, c.nominal + self.shift.get(c.kind, 0.0)) for c in columns]
        covariance = np.diag(np.square(sizes(self.unknown, imitation)))
        return SwimPrior(np.array(mean), covariance, imitation, self.shares)


def read_law_error(path: Path = FILE) -> LawError:
    """Read a file by ``benchmarks/pool_law_error.py``."""
    content = read_json(path, SCHEMA)
    shares = [[content["shares"][row][band] for band in BANDS] for row in ROWS]
    names = ("imitated", "unknown", "usual", "shift", "decisions")
    return LawError(np.array(shares, dtype=np.float64), *(content[name] for name in names))


LAW_ERROR = read_law_error()
"""The error from the file of this package."""


def learned(
    references: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    law_error: LawError = LAW_ERROR,
) -> SwimPrior:
    """A robot's prior, from reference swims in which nothing is missing, or that of all robots."""
    coordinates = Coordinates.of(robot, model)
    usual = law_error.prior(coordinates)
    if not references:
        return replace(usual, shares=law_error.decisions["unreferred"] * law_error.shares)
    problem = SwimProblem(coordinates, references, simulate, usual)
    plain = problem.plain()
    misfit = problem.misfit(plain.members, plain.fit)
    shares = law_error.shares * np.sqrt(np.clip(misfit, 0.5, 6.0))
    common, _, _ = _common(problem, plain.fit, usual)
    problem = SwimProblem(coordinates, references, simulate, replace(usual, mean=common))
    common, spread, scale = _common(problem, problem.at(problem.centre(frozenset())), usual)
    imitation = scale * usual.imitation
    return SwimPrior(common, spread + np.diag(imitation**2), imitation, shares)


def _common(problem: SwimProblem, fit: Fit, usual: SwimPrior) -> tuple[Array, Array, float]:
    """Parameters common to a robot's swims (F,), covariance, and likeliest scale of the rest.

    A linear mixed model about a fit (Laird and Ware, Biometrics 38 (1982) 963).
    """
    variance = np.square(usual.imitation)
    least = np.square(NEVER * problem.coordinates.each("step"))
    precision = np.diag(1 / np.maximum(np.diag(usual.covariance) - variance, least))
    point = fit.x + problem.coordinates.seems
    slopes, rows = problem.of_swims(fit.slope), problem.of_swims(fit.rows)
    flat = [(s.reshape(-1, point.size), r.ravel()) for s, r in zip(slopes, rows, strict=True)]
    parts = [(slope.T @ slope, slope.T @ row) for slope, row in flat]

    def at_scale(scale: float) -> tuple[float, Array, Array]:
        """Evidence of a scale, and the estimate with its covariance."""
        curvature, slope, inner = together(parts, scale**2 * variance)
        curvature, gradient = curvature + precision, precision @ (usual.mean - point) - slope
        evidence = 0.0
        for (_, swim_gradient), of_swim in zip(parts, inner, strict=True):
            size = np.log(scale**2 * variance).sum() - np.linalg.slogdet(of_swim)[1]
            evidence += 0.5 * float(swim_gradient @ of_swim @ swim_gradient) - 0.5 * float(size)
        posterior = np.asarray(np.linalg.inv(curvature))
        evidence += 0.5 * float(gradient @ posterior @ gradient)
        evidence -= 0.5 * float(np.linalg.slogdet(curvature)[1])
        return evidence, point + posterior @ gradient, posterior

    estimates = {scale: at_scale(scale) for scale in (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)}
    likeliest = max(estimates, key=lambda scale: estimates[scale][0])
    return *estimates[likeliest][1:], likeliest


def together(
    parts: Sequence[tuple[Array, Array]], variance: Array
) -> tuple[Array, Array, list[Array]]:
    """Combine swims whose parameters vary about common ones (a linear mixed model).

    From curvature (F, F) and gradient (F,) of each swim's loss at one point, and the variance (F,)
    of a swim's parameters, to those of the sum, and the covariance of each swim's deviations.
    """
    covariances = [np.asarray(np.linalg.inv(normal + np.diag(1 / variance))) for normal, _ in parts]
    pairs = list(zip(parts, covariances, strict=True))
    curvature = sum(n - n @ covariance @ n for (n, _), covariance in pairs)
    gradient = sum(g - n @ covariance @ g for (n, g), covariance in pairs)
    return np.asarray(curvature), np.asarray(gradient), covariances


def marginalised(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    free: Sequence[Parameter],
    best: Array,
    simulate: SwimSimulator,
) -> tuple[Array, Array]:
    """Mean (F,) and covariance (F, F) of parameters that a calibration fitted as ``best`` (F,).

    The gains, the coefficients of the law that a calibration holds and the error of the twin are
    marginalised in a linear model, and sets of effects that the swims may hide are averaged by
    their evidence (Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14 (1999) 382).
    """
    c = Coordinates.of(robot, model, free)
    usual = LAW_ERROR.prior(c)
    own = np.array([k < len(free) and x.kind not in RELATIVE for k, x in enumerate(c.columns)])
    mean = np.where(own, c.nominal, usual.mean)
    variance = np.where(own, c.each("prior_sd") ** 2, np.diag(usual.covariance))
    prior = replace(usual, mean=mean, covariance=np.diag(variance))
    problem = SwimProblem(c, swims, simulate, prior)
    # a hidden effect misleads a fit without it, and the values before the fit may be far off
    law = np.array([x.kind.startswith("twin.") for x in c.columns[: len(free)]])
    others = problem.centre(frozenset())[len(free) :]
    starts = np.where(law, best, c.nominal[: len(free)]), best
    fits = [_converged(problem, np.concatenate([start, others])) for start in starts]
    fit, sets = max(fits, key=lambda one: max(one[1].values()))
    shares = np.exp(np.array(list(sets.values())) - max(sets.values()))
    points = np.array([fit.x + problem.seems(members, fit) for members in sets])
    between = np.cov(points.T, aweights=shares, bias=True)
    within = [problem.covariance(members, fit) for members in sets]
    covariance = between + np.average(within, axis=0, weights=shares)
    centre = np.average(points, axis=0, weights=shares)
    # the twin's error imitates gains, and latencies by the delay that it has in the joints' angles
    gains = np.array([x.kind in RELATIVE for x in c.columns])
    late = np.array([x.kind == f"servo{LATENCY}" for x in c.columns])
    imitated = np.diag(usual.covariance) * gains + late * LAW_ERROR.imitated["error.late"] ** 2
    covariance += np.diag(imitated)
    # gains that a swim shows are combined with those before the fit
    stated = c.each("prior_sd") ** 2
    weight = np.where(gains, stated / (stated + np.diag(covariance)), 1.0)
    centre = c.nominal + weight * (centre - c.nominal)
    covariance *= np.sqrt(np.outer(weight, weight))
    return centre[: len(free)], covariance[: len(free), : len(free)]


def _converged(problem: SwimProblem, x: Array) -> tuple[Fit, dict[Members, float]]:
    """The fit of the best set from a point (F,), and the evidence of the sets near it."""
    fit = problem.at(x)
    sets = _promising(problem, fit)
    for _ in range(6):
        likely = max(sets, key=lambda members: sets[members])
        before, fit = sets[likely], problem.refined(likely, fit, fit).fit
        sets = _promising(problem, fit)
        if abs(max(sets.values()) - before) < 0.5:
            break
    return fit, sets


def _promising(problem: SwimProblem, fit: Fit) -> dict[Members, float]:
    """Evidence of sets of effects near a fit: none, and every effect added to the best set."""
    best: Members = frozenset()
    evidence = {best: problem.evidence(best, fit)}
    for _ in range(3):
        larger = [best | {e} for e in sorted(problem.coordinates.effects.keys() - best)]
        evidence |= {members: problem.evidence(members, fit) for members in larger}
        best = max(larger, key=lambda members: evidence[members])
    return evidence
