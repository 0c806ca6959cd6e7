"""The least-squares problem of a servo: residuals, their derivatives, prior, and its solution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.identification.priors import Ties, scale_inertia
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import OUTLIER_SD, Expansion, robust_loss, robust_scale
from sim2real.inference.parameters import Parameter, column
from sim2real.model import FittedEffect, Law
from sim2real.servo.motor import MOTOR_BIT
from sim2real.servo.parameters import BASE, COLUMNS, CURRENT_LIMIT, LINE, LOOP, RATE_LIMIT
from sim2real.servo.rollout import Simulator, active_effects, coarse_substep
from sim2real.servo.trace import Trace

_LATENCY, _PERIOD, _PHASE = (COLUMNS.index(name) for name in (BASE[2], *LOOP))
_LIMITS = (CURRENT_LIMIT, RATE_LIMIT)
_DIFFERENCE = 1e-3
"""Step of the forward differences, in units."""


def plain_row(kp: float, kd: float, latency: float) -> Array:
    """The parameters of a servo without effects, shape (P,)."""
    row = np.zeros(len(COLUMNS))
    row[: len(BASE)] = kp, kd, latency, 1.0, 0.0
    return row


@dataclass(frozen=True)
class ServoProblem:
    """Recordings of a servo, and which of its parameters are fitted.

    Points ``x`` (B, F) are the free parameters, or their logarithms (``Parameter.log``), in units.
    """

    traces: Sequence[Trace]  # the recordings of one joint
    row: Array  # values of the other parameters, shape (P,); loads are the recordings'
    parameters: tuple[Parameter, ...]  # the F free parameters, with the names of their columns
    ties: Ties | None = None  # relations between gains and torque limit in the prior, for a motor

    @cached_property
    def simulator(self) -> Simulator:
        """Simulator of these traces."""
        return Simulator(self.traces)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def columns(self) -> list[int]:
        """Columns of the free parameters."""
        return [COLUMNS.index(name) for name in self.names]

    @cached_property
    def log(self) -> Mask:
        """Which of the free parameters are searched as logarithms, shape (F,)."""
        return np.array([p.log for p in self.parameters])

    @cached_property
    def unit(self) -> Array:
        """Natural units as searched, shape (F,)."""
        return column(self.parameters, "typical")

    @cached_property
    def natural(self) -> Array:
        """Changes of ``x`` that matter: a factor of e of logarithms, else a unit, shape (F,)."""
        return np.where(self.log, 1 / self.unit, 1.0)

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Smallest and largest ``x``, shape (F,) each."""
        ends = [
            (np.log(p.low), np.log(p.high)) if p.log else (p.low, p.high) for p in self.parameters
        ]
        low, high = np.array(ends).T / self.unit
        return low, high

    @cached_property
    def smooth(self) -> bool:
        """Whether longer sub-steps are stable: damping by an effect may not be with them."""
        servo = self.row[None].copy()
        servo[0, self.columns] = 1.0  # no free parameter is absent
        servo[0, [COLUMNS.index(name) for name in _LIMITS]] = 0.0  # add no torque
        return not np.any(active_effects(servo) & ~MOTOR_BIT)

    def values(self, x: Array) -> Array:
        """Free parameters in SI units, shape (..., F)."""
        scaled = x * self.unit
        return np.where(self.log, np.exp(np.where(self.log, scaled, 0.0)), scaled)

    def rows(self, x: Array) -> Array:
        """Parameters of servos, (B, F) to (B, P).

        The phase of a sampled loop shifts with the latency, so that a change of latency does not
        move a set-point to another sample.
        """
        rows = np.tile(self.row, (len(x), 1))
        rows[:, self.columns] = self.values(x)
        if self.row[_PERIOD] > 0:
            shift = rows[:, _LATENCY] - self.row[_LATENCY]
            rows[:, _PHASE] = (self.row[_PHASE] + shift) % np.maximum(rows[:, _PERIOD], 1e-9)
        return rows

    def searched(self, rows: Array) -> Array:
        """Points of servos (B, P), kept within the bounds; absent logarithmic ones are nominal."""
        values = rows[:, self.columns]
        nominal = column(self.parameters, "nominal")
        logs = np.where(values > 0, np.log(np.maximum(values, 1e-300)), nominal)
        return np.clip(np.where(self.log, logs, values) / self.unit, *self.box)

    def residuals(self, x: Array, *, rough: bool = False) -> Array:
        """Simulated minus measured angles at the used samples of all traces, (B, F) to (B, n).

        In rad, divided by ``Trace.fit_ratio``, so that all have the noise of a joint at rest.
        """
        return self.row_residuals(self.rows(x), rough=rough)

    def row_residuals(self, rows: Array, *, rough: bool = False) -> Array:
        """The same of servos with any parameters (B, P)."""
        return self._errors(rows, self.substeps(rows, rough=rough))

    def substeps(self, rows: Array, *, rough: bool = False) -> Array:
        """Longest sub-step in s of each of the servos (B, P), (B,).

        ``rough``: for derivatives, or far from a minimum (``rollout.coarse_substep``).
        """
        fine = self.simulator.substeps(rows)
        return coarse_substep(fine) if rough and self.smooth else fine

    def _errors(self, rows: Array, substeps: Array) -> Array:
        angles = self.simulator.angles(rows, substeps)
        parts = zip(angles, self.traces, self._ratios, strict=True)
        errors = [((a - t.position) / ratio)[:, t.used] for a, t, ratio in parts]
        return np.concatenate(errors, axis=1)

    @cached_property
    def _ratios(self) -> list[Array]:
        return [trace.fit_ratio for trace in self.traces]

    def slopes(
        self, x: Array, error: Array | None = None, *, rough: bool = True
    ) -> tuple[Array, Array]:
        """Residuals (B, n) and their derivatives (B, n, F) by ``x`` (B, F).

        ``error`` is the residuals with the same sub-steps, where they are known.
        """
        substeps = self.substeps(self.rows(x), rough=rough)

        def simulate(points: Array) -> Array:
            each = len(points) // len(x)
            return self._errors(self.rows(points), np.repeat(substeps, each))

        return _differences(simulate, x, self._steps(x, _DIFFERENCE), error)

    def terms(self, x: Array) -> Array:
        """The prior's residuals, (B, F) to (B, m); half their sum of squares is minus its log."""
        nominal, sd = (column(self.parameters, field) for field in ("nominal", "prior_sd"))
        parts = (x * self.unit - nominal) / sd
        if self.ties is None or not set(LINE) <= set(self.names):
            return parts
        return np.hstack([parts, self.ties.terms(self.rows(x))])

    def prior_slopes(self, x: Array) -> tuple[Array, Array]:
        """The prior's residuals (B, m) and their derivatives (B, m, F) by ``x`` (B, F)."""
        return _differences(self.terms, x, self._steps(x, 1e-5))

    def loss(self, x: Array, error: Array, scale: float, inflation: float) -> Array:
        """Twice the negative log-posterior of ``x`` (B, F) with residuals (B, n), shape (B,).

        The soft L1 loss of residuals in units of their ``scale`` in rad, of which ``inflation``
        correlated ones count as one.
        """
        data = robust_loss(error / scale, OUTLIER_SD) / inflation
        return np.asarray(data + (self.terms(x) ** 2).sum(axis=1))

    def noise(self, error: Array) -> tuple[float, float]:
        """Scale of a residual (n,) in rad, and its ``inflation``."""
        return robust_scale(error), self.inflation(error)

    def inflation(self, error: Array) -> float:
        """Number of samples of a residual (n,) per independent sample."""
        parts = self.by_trace(error)
        times = [correlation_samples(part) for part in parts]
        return float(np.average(times, weights=[max(part.size, 1e-9) for part in parts]))

    def expansion(
        self, x: Array, error: Array, scale: float, inflation: float, *, rough: bool
    ) -> Expansion:
        """Half the loss and its derivatives about ``x`` (B, F) with residuals (B, n)."""
        same = rough or not self.smooth
        _, slopes = self.slopes(x, error if same else None)
        prior, prior_slopes = self.prior_slopes(x)
        weight = 1 / np.sqrt(1 + (error / (OUTLIER_SD * scale)) ** 2) / scale**2 / inflation
        root = np.sqrt(weight)
        residual = np.concatenate([root * error, prior], axis=1)[:, :, None]
        rows = np.concatenate([root[:, :, None] * slopes, prior_slopes], axis=1)
        columns = rows.swapaxes(1, 2)
        loss = 0.5 * self.loss(x, error, scale, inflation)
        return Expansion(loss, (columns @ residual)[:, :, 0], columns @ rows, {})

    def by_trace(self, values: Array) -> tuple[Array, ...]:
        """Values at the used samples of all traces (n, ...), one array per trace."""
        ends = np.cumsum([np.count_nonzero(t.used) for t in self.traces])
        return tuple(np.split(values, ends[:-1]))

    def _steps(self, x: Array, size: float) -> Array:
        return np.where(x + size > self.box[1], -size, size)


def _differences(
    evaluate: Callable[[Array], Array], x: Array, step: Array, base: Array | None = None
) -> tuple[Array, Array]:
    """Values at ``x`` (B, F) and their derivatives by steps (B, F) of each parameter.

    All points are evaluated in one call, except ``x`` where its values ``base`` are known.
    """
    F = x.shape[1]
    points = np.repeat(x[:, None], 1 + F, axis=1)
    points[:, np.arange(1, 1 + F), np.arange(F)] += step
    points = points if base is None else points[:, 1:]
    values = evaluate(points.reshape(-1, F)).reshape(*points.shape[:2], -1)
    if base is None:
        base, values = values[:, 0], values[:, 1:]
    with np.errstate(over="ignore", invalid="ignore"):
        slopes = (values - base[:, None]) / step[:, :, None]
    return base, np.where(np.isfinite(slopes), slopes, 0.0).swapaxes(1, 2)


@dataclass(frozen=True)
class Fit:
    """A fitted servo."""

    problem: ServoProblem  # the problem
    x: Array  # the optimum, shape (F,)
    error: Array  # residuals at the used samples in rad, as of the problem, shape (n,)
    slopes: Array  # their derivatives by ``x``, shape (n, F)
    scale_rad: float  # robust standard deviation of the residual
    inflation: float  # number of its samples per independent sample
    converged: bool  # whether the search ended at a minimum
    others: Array  # other minima, best first, shape (M, F)
    behind: Array  # their losses less that of the optimum, shape (M,)

    @cached_property
    def row(self) -> Array:
        """All parameters of the servo, shape (P,)."""
        row: Array = self.problem.rows(self.x[None])[0]
        return row

    @property
    def minima(self) -> Array:
        """The servo and those at the best other minima, six at most, shape (M, P)."""
        return self.problem.rows(np.vstack([self.x[None], self.others[:5]]))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The F fitted parameters."""
        return self.problem.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return self.problem.names

    @property
    def values(self) -> Array:
        """Their values in SI units, shape (F,)."""
        return self.problem.values(self.x)

    @property
    def residuals(self) -> tuple[Array, ...]:
        """The residual of each trace."""
        return self.problem.by_trace(self.error)

    @property
    def inertia(self) -> float:
        """Inertia that sets the scale of the gains, kg m2."""
        return scale_inertia(self.problem.traces, self.row)

    @property
    def prior(self) -> Array:
        """Precision of the prior by ``x``, shape (F, F)."""
        slopes = self.problem.prior_slopes(self.x[None])[1][0]
        return np.asarray(slopes.T @ slopes)

    @property
    def law(self) -> Law:
        """Name of its law: that of the limit of its torque."""
        if self.problem.ties is None:
            return "pd"
        return "motor" if self.problem.ties.damping_share is None else "current_limited"

    @property
    def effects(self) -> tuple[FittedEffect, ...]:
        """Effects that state limits of a motor: of its current below its line, of set-points."""
        limits = {name.rpartition("."): float(self.row[COLUMNS.index(name)]) for name in _LIMITS}
        found = (FittedEffect(name, {key: x}) for (name, _, key), x in limits.items() if x)
        return tuple(found) if self.law != "pd" else ()

    def loss(self, scale_rad: float, inflation: float = 1.0) -> float:
        """The loss for residuals of another scale and correlation, to compare fits."""
        return float(self.problem.loss(self.x[None], self.error[None], scale_rad, inflation)[0])

    def as_good(self, least: float) -> Array:
        """Other minima with a loss larger by less than ``least``, shape (M, F)."""
        return self.others[self.behind < least]

    def information(self, scale_rad: float | None = None, inflation: float | None = None) -> Array:
        """Second derivatives of minus the log-posterior by ``x`` (Gauss-Newton), shape (F, F).

        For residuals of another scale and correlation than its own, if these are given.
        """
        variance = (scale_rad or self.scale_rad) ** 2 * (inflation or self.inflation)
        return np.asarray(self.slopes.T @ self.slopes / variance + self.prior)

    def told(self, name: str, *, share: float = 0.7) -> bool:
        """Whether a parameter's standard deviation is less than a ``share`` of its prior's."""
        k, problem = self.names.index(name), self.problem
        variance = float(np.linalg.pinv(self.information(), hermitian=True)[k, k])
        sd = variance**0.5 * problem.unit[k]
        return bool(sd < share * problem.parameters[k].prior_sd)

    def evidence(self, scale_rad: float, inflation: float) -> float:
        """Logarithm of the marginal likelihood by Laplace's method, up to a constant.

        MacKay, Information Theory, Inference, and Learning Algorithms (Cambridge, 2003), ch. 27;
        for residuals of a given scale and correlation, so that fits are comparable.
        """
        problem = self.problem
        curvature = self.information(scale_rad, inflation)
        _, volume = np.linalg.slogdet(curvature / np.outer(problem.unit, problem.unit))
        sd = column(problem.parameters, "prior_sd")
        widths = sd[np.isfinite(sd)]
        if problem.ties is not None and problem.ties.damping_share is not None:
            widths = np.append(widths, problem.ties.damping_share[1])
        freedom = 0.5 * self.x.size * np.log(2 * np.pi)
        occam = freedom - 0.5 * volume - np.sum(np.log(np.sqrt(2 * np.pi) * widths))
        return float(occam - 0.5 * self.loss(scale_rad, inflation))
