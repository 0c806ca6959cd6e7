"""Uncertainty of a fit with correlated residuals, and intervals of its parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import expm
from scipy.special import stdtrit
from scipy.stats import chi2

from sim2real.arrays import Array
from sim2real.identification.problem import Fit
from sim2real.identification.search import search
from sim2real.inference.correlated_noise import bandwidth, correlation_samples, fixed_b, long_run
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.inference.normal import LEVEL
from sim2real.inference.parameters import column
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import GAINS, LINE, beyond_load
from sim2real.servo.trace import Trace


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the F free parameters of a fit, as searched, in units."""

    covariance: Array  # shape (F, F); 0 for directions that are not determined
    half_width: Array  # half-widths of intervals, without regard to open directions, shape (F,)
    # indices of the parameters of each direction that is not determined
    open_directions: tuple[tuple[int, ...], ...]
    inflation: float  # largest ratio of the variance to that for independent residuals
    level: float  # probability of the intervals

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (F,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def correlation(self, names: Sequence[str]) -> dict[str, float]:
        """Correlation of each pair of parameters, by their names."""
        size = np.outer(self.sd, self.sd)
        values = self.covariance / np.where(size > 0, size, 1.0)
        pairs = combinations(range(len(names)), 2)
        return {f"{names[i]}, {names[j]}": float(values[i, j]) for i, j in pairs}

    @property
    def least_loss(self) -> float:
        """Loss at the bounds of a region, which may be disconnected: hence of three parameters."""
        return float(chi2.ppf(self.level, 3))

    @property
    def undetermined(self) -> set[int]:
        """Indices of the parameters in open directions."""
        return {k for direction in self.open_directions for k in direction}


def uncertainty(
    best: Fit, *, level: float = LEVEL, repeating: bool = True, part: float = 0.25
) -> Uncertainty:
    """Sandwich covariance of a robust fit whose residuals are correlated in time.

    The covariance is inv(H) S inv(H): H the curvature of the loss, S the long-run covariance of its
    gradient (Bartlett weights: Newey and West, Econometrica 55 (1987) 703-708). It is never taken
    smaller than the covariance for independent residuals. Errors that repeat with the angle add to
    S (``repeating_error``) if ``repeating``. Intervals use Student's t with the effective number of
    samples and, of repeating errors, of coefficients, combined for each parameter (Satterthwaite,
    Biometrics Bulletin 2 (1946) 110-114). The prior counts as an additional measurement. A
    direction is open if its standard deviation exceeds a unit, a factor of e, or twice that of the
    prior; a parameter with at least ``part`` of it is part of it. ``level``: probability of the
    intervals.
    """
    problem, F = best.problem, best.x.size
    prior_sd = column(problem.parameters, "prior_sd") / problem.unit
    wide = np.where(np.isfinite(prior_sd), np.maximum(2 * prior_sd, 1.0), problem.natural)
    tempering = best.scale_rad**2 * best.inflation
    prior_precision = tempering * best.prior * np.outer(wide, wide)
    slopes, z2 = best.slopes * wide, (best.error / (OUTLIER_SD * best.scale_rad)) ** 2
    score = (best.error / np.sqrt(1 + z2))[:, None] * slopes
    curvature = (slopes / (1 + z2[:, None]) ** 1.5).T @ slopes + prior_precision
    noise, spread = float(np.mean(best.error**2 / (1 + z2))), tempering * prior_precision
    independent = noise * slopes.T @ slopes + spread
    effective, spans = 0.0, []
    for error, part_of_score in zip(best.residuals, problem.by_trace(score), strict=True):
        time = correlation_samples(error)
        spans.append(bandwidth(error.size, time))
        spread = spread + long_run(part_of_score, spans[-1])
        effective += error.size / time
    parts, freedoms = spread[None], np.array([max(effective - F, 1.0)])
    if repeating:
        of_angle, coefficients = repeating_error(best, best.prior * tempering)
        parts = np.concatenate([parts, of_angle * np.outer(wide, wide)])
        freedoms = np.append(freedoms, np.maximum(coefficients, 1.0))
        spread = parts.sum(axis=0)
    eigen, directions = np.linalg.eigh(curvature)
    least = 1e-12 * max(eigen[-1], 1e-300)
    eigen = np.maximum(eigen, least)
    both = np.stack([spread, independent])
    along = np.einsum("ik,cij,jk->ck", directions, both, directions).max(axis=0)
    # curvature without information is round-off of either sign
    along_sd = np.where(eigen > least, np.sqrt(np.maximum(along, 0.0)) / eigen, np.inf)
    determined = along_sd < 1.0
    inverse = directions[:, determined] / eigen[determined] @ directions[:, determined].T
    covariance, at_least = inverse @ both @ inverse
    raised = _ratio(np.diag(at_least), np.diag(covariance))
    raised = np.sqrt(np.maximum(raised, 1.0))
    covariance = covariance * np.outer(raised, raised)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances = np.einsum("ij,cjk,ki->ci", inverse, parts, inverse)
    weights = _ratio(variances**2, np.maximum(variances.sum(axis=0), 1e-300) ** 2)
    freedom = _ratio(np.ones(F), (weights / freedoms[:, None]).sum(axis=0))
    student = stdtrit(freedom, 0.5 + level / 2)
    quantile = student * fixed_b(float(np.mean(spans)), best.error.size, level)
    return Uncertainty(
        covariance=covariance * np.outer(wide, wide),
        half_width=np.asarray(quantile * sd * wide),
        open_directions=tuple(
            tuple(int(i) for i in np.flatnonzero(np.abs(directions[:, k]) > part))
            for k in np.flatnonzero(~determined)
        ),
        inflation=float(np.max(_ratio(sd**2, np.diag(at_least)), initial=1.0)),
        level=level,
    )


def _ratio(variance: Array, least: Array) -> Array:
    return np.divide(variance, least, out=np.ones_like(variance), where=least > 0)


def intervals(best: Fit, spread: Uncertainty) -> dict[str, tuple[float, float]]:
    """Intervals of the fitted parameters, by name, with their prior if they have one.

    Symmetric as searched; of a servo without a motor by profile likelihood, where that is wide (a
    relative half-width of a gain, or half-width in units, above 0.15) or another
    minimum outside fits the recordings as well. An upper end is infinite if the recordings do not
    determine it; ends are within the bounds and include all minima that fit equally well.
    """
    problem, (low, high) = best.problem, best.problem.box
    plain = problem.ties is None and all("." not in name for name in problem.names)
    most = 0.15 * problem.natural
    equal = best.as_good(spread.least_loss) if plain else np.empty((0, best.x.size))
    result = {}
    for k, p in enumerate(best.parameters):
        x, half = float(best.x[k]), float(spread.half_width[k])
        ends = max(x - half, low[k]), min(x + half, high[k])
        if plain:
            values = np.append(equal[:, k], x)
            if k in spread.undetermined or half > most[k] or np.abs(values - x).max() > half:
                first = max(min(half, 3.0), 0.1) / 2
                ends = _profiled(best, k, -first, spread), _profiled(best, k, first, spread)
            ends = min(ends[0], values.min()), max(ends[1], values.max())
        elif k in spread.undetermined:
            ends = low[k], high[k]
        si = np.array([best.x, best.x])
        si[:, k] = ends
        lower, upper = problem.values(si)[:, k]
        result[p.name] = float(lower), np.inf if ends[1] >= high[k] else float(upper)
    return result


def standard_errors(
    best: Fit, spread: Uncertainty, ends: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Standard errors of the fitted parameters in SI units, infinite where intervals are open.

    Of parameters searched as logarithms by their derivative (the delta method).
    """
    scale = best.problem.unit * np.where(best.problem.log, best.values, 1.0)
    errors = zip(best.names, (spread.sd * scale).tolist(), strict=True)
    return {name: np.inf if np.isinf(ends[name][1]) else error for name, error in errors}


def beyond_data_sheet(
    motor: Fit, ends: Mapping[str, tuple[float, float]], servo: Servo
) -> dict[str, tuple[float, float]]:
    """Wider intervals of the gains where the stall torque is implausible for the data sheet.

    The load sets the scale of both. If a stated load is wrong, the gains are as wrong as the stall
    torque, and their intervals extend to the values that belong to that of the data sheet: where it
    is four standard deviations of its prior away.
    """
    if LINE[0] not in motor.names or motor.problem.traces[0].load is PER_INERTIA:
        return {}
    k = motor.names.index(LINE[0])
    factor = servo.max_torque_Nm / float(motor.values[k])
    if abs(np.log(factor)) < 4 * motor.parameters[k].prior_sd:
        return {}
    both = ((gain, ends[gain]) for gain in GAINS if gain in ends)
    return {gain: (min(low, low * factor), max(up, up * factor)) for gain, (low, up) in both}


def _profiled(
    best: Fit, k: int, first: float, spread: Uncertainty, *, steps: int = 24, bisections: int = 3
) -> float:
    """End of the profile likelihood's interval of one parameter, or its bound without one."""
    problem, x = best.problem, float(best.x[k])
    limit = problem.box[1][k] if first > 0 else problem.box[0][k]
    others = tuple(p for n, p in enumerate(problem.parameters) if n != k)
    row = best.row

    def moved(step: float) -> float:
        return float(min(x + step, limit) if first > 0 else max(x + step, limit))

    def accounts(trial: float) -> bool:
        nonlocal row
        point = problem.searched(row[None])
        point[0, k] = trial
        fixed = problem.rows(point)
        profile = replace(problem, row=fixed[0], parameters=others)
        refitted, loss, _ = search(profile, profile.searched(fixed), (best.scale_rad, 1.0), 16)
        if (loss[0] - best.loss(best.scale_rad)) / max(spread.inflation, 1.0) > spread.least_loss:
            return False
        row = profile.rows(refitted)[0]
        return True

    inside, outside = 0.0, first
    for _ in range(steps):
        if not accounts(moved(outside)):
            break
        if moved(outside) == limit:
            return float(limit)
        inside, outside = outside, 2 * outside
    for _ in range(bisections):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if accounts(moved(middle)) else (inside, middle)
    return moved(0.5 * (inside + outside))


def repeating_error(best: Fit, prior: Array) -> tuple[Array, Array]:
    """Covariances of the gradient of the loss by errors that are functions of the angle.

    The residual contains an error of the measured angle and a torque that act through the closed
    loop of gains, inertia and gravity, both random functions of the simulated angle: Fourier series
    over the visited range with independent coefficients. Each has one prior variance for slow waves
    (eccentric sensors, gravity: up to 2 cycles per radian) and one for fine ones (up to 79 a turn,
    cogging behind gears; 40 waves at most); the four are estimated from the residual by
    ``variance_components``. A wave that the residual shows counts with its own power, as cogging is
    a single wave, and one that the fit has absorbed with the variance of its kind. Phases are
    arbitrary: the cosine and the sine of a wave share its power.

    ``prior`` (F, F) is the precision of the prior by ``x``, times the variance of a residual.

    Returns:
        The covariance of each kind of error, shape (C, F, F), and the effective number of
        coefficients from which its power is estimated, shape (C,).
    """
    error, slopes = best.error, best.slopes
    traces = [trace for trace in best.problem.traces if trace.used.any()]
    none = np.zeros((0, *prior.shape)), np.zeros(0)
    if best.scale_rad <= 0.0 or not traces:
        return none
    errors = [e for e in best.residuals if e.size]
    angles = [t.simulated(e) for t, e in zip(traces, errors, strict=True)]
    low, high = min(a.min() for a in angles), max(a.max() for a in angles)
    if high - low < best.scale_rad:
        return none
    length = 1.3 * (high - low)  # a longer period than the range lets the ends differ
    waves = np.arange(1, np.clip(round(12.5 * length), 1, 40) + 1)
    slow = np.tile(waves / length <= 2.0, 2)
    of_angle, of_torque = [], []
    for trace, angle in zip(traces, angles, strict=True):
        phase = 2 * np.pi * np.outer(angle - low, waves) / length
        series = np.hstack([np.cos(phase), np.sin(phase)])
        of_angle.append(series[trace.used])
        of_torque.append(_through_loop(best, trace, series)[trace.used])
    kinds = [np.vstack(of_angle), np.vstack(of_torque)]
    groups = [kind[:, part] for kind in kinds for part in (slow, ~slow) if part.any()]
    weight = (1 + (error / (OUTLIER_SD * best.scale_rad)) ** 2)[:, None] ** -1.5
    root = np.sqrt(weight)
    squares, freedom = variance_components(
        root[:, 0] * error, root * slopes, prior, [root * group for group in groups]
    )
    covariances = []
    for square, group in zip(squares, groups, strict=True):
        power = np.tile(square.reshape(2, -1).mean(axis=0), 2)
        gradient = (weight * slopes).T @ group
        covariances.append(power * gradient @ gradient.T)
    return np.array(covariances), freedom


def variance_components(
    error: Array, slopes: Array, prior: Array, groups: Sequence[Array], *, rounds: int = 15
) -> tuple[list[Array], Array]:
    """Expected squares of the coefficients of groups of functions in a residual with white noise.

    Each group has one prior variance. Restricted maximum likelihood, which allows for what the fit
    has absorbed (Patterson and Thompson, Biometrika 58 (1971) 545-554), by fixed-point steps
    (MacKay, Neural Computation 4 (1992) 415-447): a variance is the sum of squared coefficients
    over their effective number.

    Of a residual (n,), its derivatives by the fitted parameters (n, F), the precision of their
    prior times the variance of a residual (F, F), and functions of each group (n, m).

    Returns:
        Expected squares of the coefficients of each group given the residual, shapes (m,): their
        mean is the prior variance of the group. The effective number of coefficients of each, (C,).
    """
    group = np.repeat(np.arange(len(groups)), [g.shape[1] for g in groups])
    start = np.cumsum(np.bincount(group)) - np.bincount(group)
    functions = np.hstack(groups)
    curvature = slopes.T @ slopes + prior
    curvature += 1e-12 * np.trace(curvature) * np.eye(len(prior))
    both = np.column_stack([functions, error])
    both -= slopes @ np.linalg.solve(curvature, slopes.T @ both)
    products, target = functions.T @ both[:, :-1], functions.T @ both[:, -1]
    products = 0.5 * (products + products.T)
    square = float(error @ both[:, -1])
    noise = square / error.size
    variances, freedom = np.full(len(groups), 0.3 * noise), np.zeros(len(groups))
    for _ in range(rounds):
        variance = np.maximum(variances[group], 1e-16 * noise)
        sd = np.sqrt(variance)
        reduced = sd[:, None] * products * sd / noise
        remaining = np.linalg.inv(np.eye(group.size) + reduced)
        coefficients = sd * (remaining @ (sd * target)) / noise
        freedom = np.add.reduceat(1 - np.diag(remaining), start)
        variances = np.add.reduceat(coefficients**2, start) / np.maximum(freedom, 1e-9)
        left = square - 2 * coefficients @ target + coefficients @ products @ coefficients
        free = max(error.size - len(prior) - freedom.sum(), 1.0)
        noise = max(left / free, 1e-3 * noise)
    squares = coefficients**2 + variance * np.diag(remaining)
    return np.split(squares, start[1:]), freedom


def _through_loop(best: Fit, trace: Trace, torque: Array) -> Array:
    """Angle in rad by torques (T, m), in units of the proportional gain, on a servo at rest."""
    kp, kd = (float(x) for x in best.row[:2])
    inertia = trace.load.inertia_kgm2 + float(beyond_load(best.row))
    rate = np.zeros((3, 3))  # of angle, speed and the held torque
    rate[0, 1] = 1.0
    rate[1] = np.array([-kp - trace.load.gravity_Nm, -kd, kp]) / inertia
    step = expm(trace.period_s * rate)[:2]  # a torque is held for a sampling period
    state, angle = np.zeros((3, torque.shape[1])), np.empty_like(torque)
    for row, held in zip(angle, torque, strict=True):  # quicker than loading scipy.signal
        row[:], state[2] = state[0], held
        state[:2] = step @ state
    return angle
