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
    """Settings of the search for a motor.

    Attributes:
        candidates: Number of servos drawn from the prior.
        starts: Number of the best ones, from which searches start.
        rounds: Number of rounds, between which the scale of the residual is estimated again.
        first_steps: Largest number of steps of a search in the first round.
        later_steps: Largest number of steps in later rounds.
        soft_s: Starting values of stick and creep time: nearly 0, MuJoCo's, and larger ones.
        difference: Step of the derivatives, in units.
        settled: Expected gain in log-likelihood below which a search ends.
        longest_substep_s: Longest sub-step.
        steps_per_radian: Sub-steps per radian of the fastest mode.
        same: Distance in units below which two searches approach the same minimum.
        behind: Largest difference of log-likelihood to the best search at which one continues.
        promise: Assumed remaining gain as a multiple of the gain expected from the next step.
        neighbours: Number of neighbours of a minimum whose loss is averaged.
        neighbourhood: Their standard deviation relative to the prior's.
        as_good: Twice the log-likelihood by which a minimum that fits as well may be worse.
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
    neighbours: int = 128
    neighbourhood: float = 0.1
    as_good: float = 2.0


MOTOR_SEARCH = MotorSearch()
"""The defaults."""

LOSS_SEARCH = MotorSearch(candidates=512, starts=24, first_steps=40, later_steps=25, behind=200.0)
"""Settings with losses, whose loss has many minima."""


@dataclass(frozen=True)
class MotorProblem:
    """Recordings of a motor, its prior, and which parameters are fitted.

    Attributes:
        traces: The recordings of one joint.
        prior: Prior of the N parameters.
        free: Indices of the F fitted ones.
        substep_s: Longest sub-step of a rollout, s.
        simulator: Simulator of these traces.
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

        The searched phase of a sampled loop is relative to the latency, so that a change of latency
        shifts both and does not move a set-point to another sample.
        """
        rows = np.tile(plain_row(0.0, 0.0, 0.0), (x.shape[0], 1))
        rows[:, [COLUMNS.index(name) for name in self.prior.names]] = self.prior.values(x)
        period = rows[:, _PERIOD]
        phase = (rows[:, _PHASE] + rows[:, _LATENCY]) % np.where(period > 0, period, 1.0)
        rows[:, _PHASE] = np.where(period > 0, phase, 0.0)
        return rows

    @property
    def coarse(self) -> MotorProblem:
        """This problem with longer sub-steps, see ``rollout.coarse_substep``."""
        return replace(self, substep_s=float(coarse_substep(np.array(self.substep_s))))

    def residuals(self, x: Array) -> Array:
        """Simulated minus measured angles of all traces, shape (B, n)."""
        return np.concatenate(errors(self.simulator, self.rows(x), self.substep_s), axis=1)

    def terms(self, x: Array) -> Array:
        """The prior's residuals, which are 0 for fixed parameters."""
        fixed = np.setdiff1d(np.arange(3, x.shape[1]), self.free)
        replaced = x.copy()
        replaced[:, fixed] = [self.prior.parameters[k].middle for k in fixed]
        terms = self.prior.terms(replaced)
        terms[:, fixed] = 0.0
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
