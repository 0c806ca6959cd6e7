"""The least-squares problem of a motor's law: residuals, their slopes, and those of the prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.identification.fit import errors, plain_row, split_by_trace
from sim2real.identification.motor_prior import MotorPrior
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.inference.parameters import Parameter, column
from sim2real.servo.parameters import BASE, COLUMNS, LOOP, LOSSES, ROTOR
from sim2real.servo.rollout import Simulator, coarse_substep
from sim2real.servo.trace import Trace

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
        steps: Largest number of steps of a search after the first round.
        behind: Largest difference of log-likelihood to the best search at which one continues.
    """

    traces: Sequence[Trace]
    prior: MotorPrior
    free: tuple[int, ...]
    substep_s: float
    simulator: Simulator
    steps: int
    behind: float

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

    def slopes(
        self, x: Array, error: Array | None = None, *, difference: float = 1e-3
    ) -> tuple[Array, Array]:
        """Residuals (B, n) at ``x`` (B, F) and derivatives by what is free, in units, (B, n, F).

        ``error`` is the residuals, where they are known.
        """
        _, high, unit = self.box
        ahead = x[:, self.free] + difference * unit
        step = np.where(ahead > high, -difference, difference)
        return self._differences(self.residuals, x, step, error)

    def prior_slopes(self, x: Array, *, difference: float = 1e-5) -> tuple[Array, Array]:
        """The prior's residuals (B, m) and their derivatives, in units, (B, m, F)."""
        return self._differences(self.terms, x, np.full((len(x), len(self.free)), difference))

    def _differences(
        self, evaluate: Callable[[Array], Array], x: Array, step: Array, base: Array | None = None
    ) -> tuple[Array, Array]:
        """Values at ``x`` and their derivatives by steps (B, F) of each free parameter, in units.

        All points are evaluated in one call, except ``x`` where its values ``base`` are known.
        """
        points = np.repeat(x[:, None], 1 + len(self.free), axis=1)
        points[:, np.arange(1, 1 + len(self.free)), self.free] += step * self.box[2]
        if base is not None:
            points = points[:, 1:]
        values = evaluate(points.reshape(-1, x.shape[1])).reshape(*points.shape[:2], -1)
        if base is None:
            base, values = values[:, 0], values[:, 1:]
        return base, ((values - base[:, None]) / step[:, :, None]).swapaxes(1, 2)


def robust_order(
    problem: MotorProblem,
    x: Array,
    scale: float,
    inflation: float,
    rng: np.random.Generator,
    *,
    neighbours: int = 128,
    distance: float = 0.1,
) -> Index:
    """Indices of minima (M, F) by the mean loss of their neighbours, smallest first.

    Neighbours differ in rotor inertia and losses by a small share of the prior's width. A narrow
    minimum owes its small loss to a coincidence, for instance of the moment at which the shaft
    sticks, and predicts other motions badly; so the expected loss of uncertain parameters is what
    counts (robust optimisation: Beyer and Sendhoff, Computer Methods in Applied Mechanics and
    Engineering 196 (2007) 3190-3218, sec. 2.2).

    Args:
        problem: The problem.
        x: The minima as searched.
        scale: Scale of the residual in rad.
        inflation: Number of samples per independent sample.
        rng: Generator for the neighbours.
        neighbours: Number of neighbours of a minimum.
        distance: Their standard deviation relative to the prior's.
    """
    free = list(problem.free)
    varied = [k for k in free if problem.prior.names[k] in (ROTOR, *LOSSES)]
    width = distance * column([problem.prior.parameters[k] for k in varied], "prior_sd")
    offset = width * rng.standard_normal((neighbours, len(varied)))
    low, high, _ = problem.box
    means = np.empty(len(x))
    for k, minimum in enumerate(x):
        nearby = np.tile(minimum, (neighbours, 1))
        nearby[:, varied] += offset
        # A loss below 0 is reflected.
        moved = np.maximum(nearby[:, free], 2 * low - nearby[:, free])
        nearby[:, free] = np.minimum(moved, high)
        error = problem.coarse.residuals(nearby)
        means[k] = problem.loss(nearby, error, scale, inflation).mean()
    return np.argsort(means)
