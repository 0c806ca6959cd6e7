"""A motor as a least-squares problem: residuals, prior, bounds and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import errors, plain_row
from sim2real.identification.motor_prior import MotorPrior
from sim2real.servo.parameters import BASE, COLUMNS, LOOP
from sim2real.servo.rollout import Simulator, coarse_substep
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_LATENCY, _PERIOD, _PHASE = (COLUMNS.index(name) for name in (BASE[2], *LOOP))


@dataclass(frozen=True)
class MotorSearch:
    """How a motor is searched.

    Attributes:
        candidates: Servos that are drawn from the prior.
        starts: The best of them, from which searches start.
        rounds: Rounds, with the scale of the residual taken anew.
        first_steps: Most steps of a search in the first round.
        later_steps: Most steps in later ones.
        soft_s: Times of sticking and creeping to start from: about none, MuJoCo's, and more.
        difference: Step of the derivatives, in units.
        settled: Expected gain in log-likelihood below which a search has ended.
        longest_substep_s: Longest sub-step.
        steps_per_radian: Sub-steps while the fastest mode turns by one radian.
        same: Distance in units within which two searches are on their way to one minimum.
        behind: Log-likelihood by which a search may stay behind the best one.
        promise: Times the gain that its quadratic model promises, which it may still make.
    """

    candidates: int = 64
    starts: int = 4
    rounds: int = 4
    first_steps: int = 20
    later_steps: int = 10
    soft_s: tuple[tuple[float, float], ...] = ((1e-3, 3e-4), (0.01, 1e-3), (0.01, 5e-3))
    difference: float = 1e-3
    settled: float = 1e-3
    longest_substep_s: float = 0.002
    steps_per_radian: float = 32.0
    same: float = 0.1
    behind: float = 30.0
    promise: float = 5.0


MOTOR_SEARCH = MotorSearch()
"""The defaults."""


@dataclass(frozen=True)
class MotorProblem:
    """Recordings of a motor, its prior, and which parameters are fitted.

    Attributes:
        traces: The recordings of one joint.
        prior: Prior of the N parameters.
        free: Indices of the F fitted ones.
        substep_s: Longest sub-step of a rollout, s.
        simulator: Of these traces.
        search: Settings of the search.
    """

    traces: Sequence[Trace]
    prior: MotorPrior
    free: tuple[int, ...]
    substep_s: float
    simulator: Simulator
    search: MotorSearch

    def rows(self, x: Array) -> Array:
        """Rows of the servo's parameters for those searched, (B, F) to (B, P).

        The phase of a sampled loop is searched less the latency, so that a change of latency moves
        both, and no set-point to another look.
        """
        rows = np.tile(plain_row(0.0, 0.0, 0.0), (x.shape[0], 1))
        rows[:, [COLUMNS.index(name) for name in self.prior.names]] = self.prior.values(x)
        period = rows[:, _PERIOD]
        phase = (rows[:, _PHASE] + rows[:, _LATENCY]) % np.where(period > 0, period, 1.0)
        rows[:, _PHASE] = np.where(period > 0, phase, 0.0)
        return rows

    @property
    def coarse(self) -> MotorProblem:
        """The same with longer sub-steps, see ``rollout.coarse_substep``."""
        return replace(self, substep_s=float(coarse_substep(np.array(self.substep_s))))

    def residuals(self, x: Array) -> Array:
        """Simulated minus measured angles of all traces, shape (B, n)."""
        return np.concatenate(errors(self.simulator, self.rows(x), self.substep_s), axis=1)

    def terms(self, x: Array) -> Array:
        """The prior's residuals; parameters that are held have none."""
        held = np.setdiff1d(np.arange(3, x.shape[1]), self.free)
        safe = x.copy()
        safe[:, held] = [self.prior.parameters[k].middle for k in held]
        terms = self.prior.terms(safe)
        terms[:, held] = 0.0
        if not {3, 4} <= set(self.free):
            terms[:, -2:] = 0.0
        return terms

    @property
    def box(self) -> tuple[Array, Array, Array]:
        """Smallest and largest values as searched, and units, of the free parameters."""
        chosen = [self.prior.parameters[k] for k in self.free]
        ends = [(np.log(b.low), np.log(b.high)) if b.log else (b.low, b.high) for b in chosen]
        low, high = np.array(ends).T
        return low, high, np.array([b.unit for b in chosen])

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives by the free parameters, in units, (n, F)."""
        _, high, unit = self.box
        step = np.where(
            x[list(self.free)] + self.search.difference * unit > high,
            -self.search.difference,
            self.search.difference,
        )
        here, *beside = self.residuals(np.stack([x, *self._beside(x, step)]))
        return here, np.asarray((np.array(beside) - here).T / step)

    def prior_slopes(self, x: Array) -> tuple[Array, Array]:
        """The prior's residuals (m,) and derivatives, in units, (m, F)."""
        here, *beside = self.terms(np.stack([x, *self._beside(x, np.full(len(self.free), 1e-5))]))
        return here, np.asarray((np.array(beside) - here).T / 1e-5)

    def _beside(self, x: Array, step: Array) -> Array:
        """A point as often as it has free parameters, one of them moved in each, in units."""
        points = np.tile(x, (len(self.free), 1))
        points[np.arange(len(self.free)), self.free] += step * self.box[2]
        return points
