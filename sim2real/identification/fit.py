"""Robust least squares on simulated angles, and the search for its starting point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import Effect
from sim2real.effects.effect import scaled
from sim2real.inference.least_squares import (
    OUTLIER_SD,
    central,
    minimise_robustly,
    robust_loss,
    robust_scale,
)
from sim2real.inference.low_discrepancy import kronecker
from sim2real.inference.parameters import Parameter, column
from sim2real.servo.motor import MOTOR_BIT
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    INERTIA_LEFT_OUT,
    LINE,
    ROTOR,
    ROTOR_INERTIA,
    beyond_load,
)
from sim2real.servo.rollout import (
    LONGEST_SUBSTEP_S,
    Simulator,
    active_effects,
    coarse_substep,
    longest_substep,
    rollout,
    trace_contexts,
)
from sim2real.servo.trace import Trace

FREQUENCY_RAD_S = (2.0, 300.0)
DAMPING_RATIO = (0.05, 4.0)
LATENCY_S = (0.0, 0.3)
"""Ranges of the natural frequency, damping ratio and latency of a first guess."""
STEPS_PER_RADIAN = 64.0
"""Sub-steps per radian of the fastest mode, where there is no exact solution."""


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        parameters: The F fitted parameters, with the names of their columns.
        row: All parameters of the servo, shape (P,); loads are the recordings'.
        scale_rad: Robust standard deviation of the residual.
        residuals: Simulated minus measured angle at the used samples, one array per trace.
        jacobians: Its derivatives by the fitted parameters, one array (n, F) per trace.
        converged: Whether the search ended at a minimum.
        inertia: Inertia that sets the scale of the gains, kg m2 (``scale_inertia``).
        prior: Precision of the prior of the free parameters, shape (F, F); None without one.
        tempering: Variance in rad2 of one sample of the residual, which weights the prior.
    """

    parameters: tuple[Parameter, ...]
    row: Array
    scale_rad: float
    residuals: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    converged: bool
    inertia: float
    prior: Array | None = None
    tempering: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def values(self) -> Array:
        """Values of the fitted parameters, shape (F,)."""
        return self.row[[COLUMNS.index(name) for name in self.names]]

    def loss(self, scale_rad: float) -> float:
        """Robust loss in rad2 for a given scale of the residual, near the sum of squares."""
        return robust_loss(np.concatenate(self.residuals), OUTLIER_SD * scale_rad)


def first_guess(
    traces: Sequence[Trace],
    rng: np.random.Generator,
    *,
    rotor_kgm2: float = 0.0,
    fastest_rad_s: float = FREQUENCY_RAD_S[1],
    guesses: int = 1024,
    elite: int = 16,
    spreads: Sequence[float] = (0.1, 0.04, 0.015),
    rival_error: float = 1.03,
    rival_distance: float = 0.08,
    most_rivals: int = 4,
) -> tuple[Array, Array]:
    """Parameters of a servo that approximately fits the recordings, and of very different rivals.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Args:
        traces: The recorded joint, one trace per recording.
        rng: Generator for the candidates.
        rotor_kgm2: Inertia of the candidates in addition to that of the load.
        fastest_rad_s: Largest natural frequency of the candidates in rad/s.
        guesses: Number of servos in the first round.
        elite: Number of the best servos, about which further ones are drawn.
        spreads: Standard deviations of further ones in each round, as shares of the ranges.
        rival_error: Largest error of a rival, relative to the smallest error.
        rival_distance: Smallest difference of a rival's gain, as a share of the range.
        most_rivals: Largest number of rivals.

    Returns:
        The best candidate, shape (P,), and rivals with nearly the same error but very different
        gains, shape (R, P): none if the recordings determine the gain.
    """
    windows = [trace.window() for trace in traces]
    moving = [window for window in windows if window.moves() and window.used.any()]
    trace = max(moving or [trace for trace in traces if trace.used.any()], key=Trace.activity)
    points = kronecker(guesses, 3, rng)
    low, high = np.log(FREQUENCY_RAD_S)
    points[:, 0] *= min(1.0, (np.log(fastest_rad_s) - low) / (high - low))
    error = _guess_errors(points, trace, rotor_kgm2)
    for spread in spreads:
        best = np.argsort(error)[:elite]
        points, error = points[best], error[best]
        around = np.repeat(points, guesses // (4 * elite), axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        error = np.append(error, _guess_errors(drawn, trace, rotor_kgm2))
        points = np.vstack([points, drawn])
    order = np.argsort(error)
    equal = order[error[order] < rival_error * error[order[0]]]
    chosen = [equal[0]]
    for candidate in equal[1:]:
        distance = np.abs(points[chosen, 0] - points[candidate, 0]).min()
        if distance > rival_distance and len(chosen) <= most_rivals:
            chosen.append(candidate)
    inertia = trace.load.inertia_kgm2 + rotor_kgm2
    rows = np.array([plain_row(*x) for x in servos_at(points[chosen], inertia)])
    rows[:, INERTIA_LEFT_OUT] = rotor_kgm2
    return rows[0], rows[1:]


def _guess_errors(
    points: Array, trace: Trace, rotor_kgm2: float, *, shortest_s: float = 1e-3
) -> Array:
    """Mean absolute error in rad of the servos at ``points`` (N, 3), shape (N,)."""
    theta = np.zeros((points.shape[0], len(COLUMNS)))
    theta[:, :3] = servos_at(points, trace.load.inertia_kgm2 + rotor_kgm2)
    theta[:, INERTIA_LEFT_OUT] = rotor_kgm2
    theta[:, 3 : len(BASE)] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    exact = Simulator([trace])
    if exact.is_linear(theta):
        (angle,) = exact.angles(theta, np.inf)
    else:
        substep = longest_substep(theta, theta[:, 3], steps_per_radian=6.0, longest_s=4e-3)
        step = np.maximum(substep, shortest_s)  # the fast mode of strong damping decays within it
        factor, offset = trace_contexts([trace])
        rows = theta * factor + offset
        angle = rollout(
            rows, trace.t, trace.command, varying=trace.varying, substep_s=step, threads=2
        )
    return np.asarray(np.mean(np.abs(angle - trace.position)[:, trace.used], axis=1))


def servos_at(points: Array, inertia: float | Array) -> Array:
    """Gains and latencies of servos at points of the unit cube.

    Args:
        points: Points of shape (N, 3): frequency and damping ratio (logarithmic) and latency, as
            shares of the ranges of a first guess.
        inertia: Inertia of the load in kg m2, a number or shape (..., 1).

    Returns:
        kp, kd and latency in SI units, shape (..., N, 3).
    """
    ranges = np.array([np.log(FREQUENCY_RAD_S), np.log(DAMPING_RATIO), LATENCY_S])
    values = ranges[:, 0] + points * np.diff(ranges, axis=1).T
    frequency, damping = np.exp(values[:, :2]).T
    kp = frequency**2 * inertia
    kd = 2 * damping * frequency * inertia
    return np.stack([kp, kd, np.broadcast_to(values[:, 2], kp.shape)], axis=-1)


def gains(row: Array, inertia: float) -> tuple[Parameter, Parameter, Parameter]:
    """Gains and latency, with natural units for a servo like ``row`` (P,)."""
    kp = max(float(row[0]), 1e-9)
    total = max(inertia + float(row[INERTIA_LEFT_OUT]), 1e-9)
    kd = max(float(row[1]), 0.4 * float(np.sqrt(kp * total)))
    return (
        Parameter("kp_Nm_per_rad", 1e-9 * inertia, 1.6e5 * inertia, kp, kp),
        Parameter("kd_Nms_per_rad", 0.0, 1.6e3 * inertia, kd, float(row[1])),
        Parameter("latency_s", 0.0, 0.5, 0.05, float(row[2])),
    )


def inertia_left_out(row: Array, inertia: float) -> Parameter:
    """Inertia missing from the stated load; negative if the stated inertia is too large."""
    size = inertia + float(row[INERTIA_LEFT_OUT])
    return Parameter(COLUMNS[INERTIA_LEFT_OUT], -0.9 * inertia, 20.0 * inertia, size)


def scale_inertia(traces: Sequence[Trace], row: Array) -> float:
    """Inertia in kg m2 that sets the scale of a servo's gains.

    That of the load, and on an arm that of the rotor in addition: the links beyond the last joints
    of an arm have much less inertia than the servos that move them.
    """
    inertia = traces[0].load.inertia_kgm2
    if traces[0].varying is not None:
        inertia += float(beyond_load(row))
    return inertia


def plain_parameters(traces: Sequence[Trace], row: Array) -> tuple[Parameter, ...]:
    """Parameters of a servo without effects: gains and latency, and on an arm the motor's.

    The weight of an arm is known, so that inertia, torque and gains are identifiable separately.
    """
    inertia = scale_inertia(traces, row)
    if traces[0].varying is None:
        return gains(row, inertia)
    if row[ROTOR_INERTIA] > 0:
        motor = [(name, float(row[COLUMNS.index(name)])) for name in (*LINE, ROTOR)]
        return (*gains(row, inertia), *(Parameter(n, x / 4, 4 * x, x, x) for n, x in motor))
    low = -0.9 * traces[0].load.inertia_kgm2
    rotor = Parameter(COLUMNS[INERTIA_LEFT_OUT], low, 20.0 * inertia, inertia)
    return (*gains(row, inertia), rotor)


def of_effects(
    effects: Sequence[Effect], row: Array, inertia: float, known: Sequence[str] = ()
) -> tuple[Parameter, ...]:
    """Every parameter of some effects, scaled to a servo like ``row`` (P,), but those ``known``."""
    pairs = [
        (effect.name, scaled(p, float(row[0]), inertia))
        for effect in effects
        for p in effect.parameters
        if p.name not in known
    ]
    return tuple(
        Parameter(f"{effect}.{p.name}", p.low, p.high, p.typical or p.high / 10, p.typical)
        for effect, p in pairs
    )


def fit(
    traces: Sequence[Trace],
    row: Array,
    free: Sequence[Parameter],
    *,
    rounds: int = 3,
    evaluations: int = 60,
    difference: float = 1e-4,
    settled: float = 1e-3,
) -> Fit:
    """Fit some parameters to all traces at once, with the others of the row fixed.

    Derivatives are central differences, with longer sub-steps until the last point
    (``rollout.coarse_substep``).

    Args:
        traces: The joint's recordings.
        row: Starting point, shape (P,).
        free: Parameters to fit.
        rounds: Largest number of robust rounds after the first one.
        evaluations: Largest number of evaluations in one round.
        difference: Step of the central differences, in natural units.
        settled: Expected gain in log-likelihood below which a search ends.
    """
    simulator = Simulator(traces)
    columns = [COLUMNS.index(p.name) for p in free]
    unit, low, high = (column(free, name) for name in ("typical", "low", "high"))
    box = low / unit, high / unit
    step = np.full(len(free), difference)

    def rows(x: Array) -> Array:
        filled = np.tile(row, (len(x), 1))
        filled[:, columns] = x * unit
        return filled

    def simulate(points: Array, substep_s: float) -> Array:
        return np.concatenate(errors(simulator, rows(points), substep_s), axis=1)

    def fine(x: Array) -> float:
        # at a neighbouring point, where effects are active that are 0 at this one
        return simulator.substep(rows(x[None] + step), STEPS_PER_RADIAN, LONGEST_SUBSTEP_S)

    # Damping that an effect adds may be unstable with long sub-steps.
    stable = not np.any(active_effects(rows(np.ones((1, len(free))))) & ~MOTOR_BIT)

    def expanded(x: Array, substep_s: float) -> tuple[Array, Array]:
        return central(lambda points: simulate(points, substep_s), x, step, *box)

    def evaluate(x: Array) -> tuple[Array, Array]:
        substep_s = fine(x)
        if not stable:
            return expanded(x, substep_s)
        _, slope = expanded(x, float(coarse_substep(np.array(substep_s))))
        return simulate(x[None], substep_s)[0], slope

    start = np.clip(row[columns] / unit, *box)
    x, converged = minimise_robustly(
        evaluate, start, *box, rounds=rounds, evaluations=evaluations, settled=settled
    )
    error, slope = expanded(x, fine(x))
    return Fit(
        parameters=tuple(free),
        row=rows(x[None])[0],
        scale_rad=robust_scale(error),
        residuals=split_by_trace(error, traces),
        jacobians=split_by_trace(slope / unit, traces),
        converged=converged,
        inertia=scale_inertia(traces, rows(x[None])[0]),
    )


def refitted(traces: Sequence[Trace], row: Array, effects: Sequence[Effect] = ()) -> Fit:
    """Fit gains, latency and effects, starting from a similar servo (P,)."""
    inertia = scale_inertia(traces, row)
    return fit(traces, row, (*gains(row, inertia), *of_effects(effects, row, inertia)))


def errors(simulator: Simulator, rows: Array, substep_s: float | None = None) -> list[Array]:
    """Simulated minus measured angle of servos (B, P) at used samples, (B, n) per trace.

    The longest sub-step is ``substep_s`` for all, by default one for each servo.
    """
    longest: float | Array
    if substep_s is None:
        longest = simulator.substeps(rows, STEPS_PER_RADIAN, LONGEST_SUBSTEP_S)
    else:
        longest = substep_s
    angles = simulator.angles(rows, longest)
    return [(a - t.position)[:, t.used] for a, t in zip(angles, simulator.traces, strict=True)]


def residuals(row: Array, traces: Sequence[Trace]) -> tuple[Array, ...]:
    """Simulated minus measured angle of one servo at the used samples of each trace."""
    if not traces:
        return ()
    return tuple(error[0] for error in errors(Simulator(traces), row[None]))


def split_by_trace(values: Array, traces: Sequence[Trace]) -> tuple[Array, ...]:
    """Values at the used samples of all traces (n, ...), one array per trace."""
    return tuple(np.split(values, np.cumsum([np.count_nonzero(t.used) for t in traces])[:-1]))


def plain_row(kp: float, kd: float, latency: float) -> Array:
    """The parameters of a servo without effects, shape (P,)."""
    row = np.zeros(len(COLUMNS))
    row[: len(BASE)] = kp, kd, latency, 1.0, 0.0
    return row


def best_of(
    fitted: Sequence[Trace],
    starts: Sequence[Array],
    names: Sequence[str] = BASE[:3],
    effort: float = 1.0,
    *,
    first: int = 60,
    further: int = 20,
) -> tuple[Fit, list[Fit]]:
    """The best fit of all starts (P,), and the other fits, sorted by loss.

    Args:
        fitted: The joint's recordings.
        starts: Starting points; the first has more evaluations than the others.
        names: Those of ``plain_parameters`` to fit.
        effort: Multiple of the numbers of evaluations.
        first: Largest number of evaluations in one round, from the first start.
        further: The same from each other start, in two rounds.
    """
    fits: list[Fit] = []
    for start in starts:
        free = [p for p in plain_parameters(fitted, start) if p.name in names]
        rounds, most = (1, further) if fits else (3, first)
        fits.append(fit(fitted, start, free, rounds=rounds, evaluations=round(most * effort)))
    scale = min(candidate.scale_rad for candidate in fits)
    fits.sort(key=lambda candidate: candidate.loss(scale))
    return fits[0], fits[1:]
