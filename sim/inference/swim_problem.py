"""Swims of one robot as a least-squares problem, for the search for effects and for calibrations.

Fits follow the derivatives of one batch of rollouts. Shapes of the simulator's error are columns
that are marginalised; absent effects have a prior as wide as the error imitates them, so that the
evidence is that of a normal model with all columns (MacKay, Information Theory, Inference, and
Learning Algorithms (2003), ch. 28).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from sim.inference.coordinates import ERROR, LATENCY, SUBSTEP_S, Coordinates, signals_at
from sim.inference.signal_error import Blocks
from sim.inference.swims import Swim, SwimSimulator
from sim2real.arrays import Array, Index, Mask
from sim2real.inference.least_squares import Expansion, minimise
from sim2real.inference.selection import Hypothesis, Members

LOST, FILTER = "dropped_frames.probability", "pose_filter.time_constant_s"
_STEPS = 6
"""Evaluations of a fit with the same derivatives."""
_AT_MOST = 3.0
"""Largest imitation of an absent effect by the twin's error, in standard deviations: larger values
are not due to the error, and the linear model does not hold there."""
_SHIFTS = (-2.0, -1.0, 1.0)
"""Sub-steps by which latencies are moved: a fit has minima a sub-step of the twin apart."""
_EACH, _LARGEST = 3.0, 600.0
"""Log-evidence of one repeated pose for lost frames, and its largest sum."""


@dataclass(frozen=True)
class SwimPrior:
    """Prior of the F parameters of servos, force law and effects.

    The error of the twin looks like effects that are not there. A part of it is common to all swims
    of a robot and is learned from reference swims; the rest differs from swim to swim.
    """

    # mean of each parameter; for effects the apparent size in reference swims, shape (F,)
    mean: Array
    covariance: Array  # covariance for a swim in which nothing is missing, shape (F, F)
    imitation: Array  # standard deviation between swims of one robot, shape (F,)
    # relative error of the twin by signal and frequency band, shape (4, 3); of this robot where
    # reference swims are given
    shares: Array


@dataclass(frozen=True)
class Slope:
    """Derivatives of the weighted errors of swims, (n, F), and their product (F, F)."""

    slope: Array
    normal: Array


@dataclass(frozen=True)
class Fit:
    """Fit of a hypothesis."""

    x: Array  # the point, shape (F,): 0 for effects that are not in the hypothesis
    rows: Array  # weighted errors there, shape (n,)
    loss: float  # negative logarithm of likelihood times prior
    near: Slope  # linear model that the fit used
    local: bool = False  # whether the linear model was computed at this point


@dataclass
class SwimProblem:
    """Swims of one robot as a problem of fits and of the search."""

    coordinates: Coordinates  # coordinates of the robot
    swims: Sequence[Swim]  # its recordings
    simulate: SwimSimulator  # the simulator
    prior: SwimPrior  # prior of the parameters
    cost: float = 0.0  # log-evidence that is subtracted for each effect
    # blocks, weights: transformed swims, and reciprocal standard deviations of their errors
    blocks: list[Blocks] = field(init=False)
    weights: list[Array] = field(init=False)
    # whether each column is a shape of the twin's error, shape (F,)
    is_error: Mask = field(init=False)
    # first linearised fit without effects, another start of single effects: a law adapted to swims
    # that have an effect is a bad one
    first_fits: list[Fit] = field(default_factory=list, init=False)
    kept: Mask | None = None  # rows that a fit uses, shape (n,); all where None
    _precisions: dict[Members, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Transform the recordings and compute their weights."""
        seems = self.prior.mean.copy()
        seems[self.coordinates.base] = 0.0
        self.coordinates = replace(self.coordinates, seems=seems)
        self.blocks = [Blocks.of(swim) for swim in self.swims]
        self.weights = [blocks.weights(self.prior.shares) for blocks in self.blocks]
        self.is_error = np.array([c.name.startswith(ERROR) for c in self.coordinates.columns])

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F), shape (E, n); of all rows, also those not fitted."""
        parts = []
        for swim, blocks, weight in zip(self.swims, self.blocks, self.weights, strict=True):
            error = blocks.errors(signals_at(self.coordinates, swim, points, self.simulate))
            parts.append((error * weight).reshape(len(points), -1))
        return np.concatenate(parts, axis=1)

    def of_swims(self, rows: Array) -> list[Array]:
        """Rows (n, ...) of each swim, shape (T, 3 + J, ...)."""
        ends = np.cumsum([weight.size for weight in self.weights])[:-1]
        parts = zip(np.split(rows, ends), self.weights, strict=True)
        return [part.reshape(*weight.shape, *rows.shape[1:]) for part, weight in parts]

    def misfit(self, rows: Array) -> Array:
        """Mean squares of weighted errors (n,) by signal and band, shape (4, 3)."""
        sums, counts = np.zeros((4, 3)), np.zeros((4, 3))
        for blocks, part in zip(self.blocks, self.of_swims(rows**2), strict=True):
            for k in range(part.shape[1]):
                np.add.at(sums[min(k, 3)], blocks.band, part[:, k])
                np.add.at(counts[min(k, 3)], blocks.band, 1.0)
        return sums / np.maximum(counts, 1.0)

    def slope(
        self, x: Array, nearby: Slope | None = None, members: Members = frozenset()
    ) -> tuple[Array, Slope]:
        """Weighted errors at a point, and derivatives, recomputed only where these members vary."""
        points, base = self.coordinates.about(x)
        moved = np.ones(x.size, dtype=bool) if nearby is None else self.coordinates.in_fit(members)
        fresh = np.flatnonzero(moved)
        rows = self.rows(self.coordinates.clipped(points[np.concatenate([[0], fresh + 1])]))
        base_rows = np.searchsorted(fresh + 1, base[fresh]) + (base[fresh] > 0)
        slope = np.empty((rows.shape[1], x.size)) if nearby is None else nearby.slope.copy()
        slope[:, fresh] = ((rows[1:] - rows[base_rows]) / self.coordinates.steps(x)[fresh, None]).T
        return rows[0], Slope(slope, slope.T @ slope)

    def at(self, x: Array, members: Members = frozenset(), nearby: Slope | None = None) -> Fit:
        """The fit of a set at a point (F,), linearised there."""
        rows, near = self.slope(x, nearby, members)
        fit = Fit(x, rows, 0.0, near, local=True)
        return replace(fit, loss=self._expanded(members, fit)[0])

    def precision(self, members: Members) -> Array:
        """Precision of the prior of all columns, shape (F, F)."""
        if members not in self._precisions:
            c, covariance = self.coordinates, self.prior.covariance.copy()
            varied = c.in_fit(members)
            of_effects = varied & np.array([column.effect is not None for column in c.columns])
            covariance[of_effects, of_effects] += c.each("prior_sd")[of_effects] ** 2
            lost = c.place.get(LOST)
            if lost is not None and varied[lost]:
                n, share = sum(swim.t.size for swim in self.swims), repeated(self.swims)
                covariance[lost, lost] = (share * (1 - share) + 1 / n) / n
            self._precisions[members] = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return self._precisions[members]

    def centre(self, members: Members) -> Array:
        """Mean of the prior, shape (F,); the share of lost frames is counted and not fitted."""
        c = self.coordinates
        x = c.nominal
        x[c.base] = self.prior.mean[c.base]
        if LOST in c.place and c.in_fit(members)[c.place[LOST]]:
            x[c.place[LOST]] = repeated(self.swims)
        return x

    def counted(self, members: Members) -> float:
        """Log-evidence of the count of repeated poses: noise repeats none."""
        if LOST not in self.coordinates.place:
            return 0.0
        samples = sum(swim.t.size for swim in self.swims)
        evidence = min(repeated(self.swims) * samples * _EACH, _LARGEST)
        lost = any(name == LOST.partition(".")[0] for name, _ in members)
        return (evidence if evidence > _EACH else -_LARGEST) if lost else 0.0

    def _coloured(self, fit: Fit) -> float:
        """Log-evidence of the spectrum of the poses' noise for a filter."""
        place = self.coordinates.place.get(FILTER)
        lag_s = 0.0 if place is None else float(fit.x[place])
        noises = [swim.pose_noise for swim in self.swims if swim.pose_noise is not None]
        return sum(noise.log_ratio(lag_s) for noise in noises) if lag_s > 0 else 0.0

    def used(self, fit: Fit) -> tuple[Array, Array, Array]:
        """Rows that a fit uses, their derivatives, and the product of these."""
        if self.kept is None:
            return fit.rows, fit.near.slope, fit.near.normal
        slope = fit.near.slope[self.kept]
        return fit.rows[self.kept], slope, slope.T @ slope

    def _whole(self, members: Members, fit: Fit) -> tuple[float, Array, Array]:
        """Loss at the point of a fit, its gradient (F,) and curvature (F, F) in all columns."""
        errors, slope, normal = self.used(fit)
        prior, deviation = self.precision(members), fit.x - self.centre(members)
        loss = 0.5 * float(errors @ errors) + 0.5 * float(deviation @ prior @ deviation)
        return loss, slope.T @ errors + prior @ deviation, normal + prior

    def _expanded(self, members: Members, fit: Fit) -> tuple[float, Array, Array]:
        """The same, minimised over the simulator's error, to which a fit thus does not adapt."""
        loss, gradient, curvature = self._whole(members, fit)
        error = self.is_error
        coupling = curvature[error]
        solved = np.linalg.solve(curvature[np.ix_(error, error)], coupling)
        shift = np.linalg.solve(curvature[np.ix_(error, error)], gradient[error])
        loss -= 0.5 * float(gradient[error] @ shift)
        return loss, gradient - coupling.T @ shift, curvature - coupling.T @ solved

    def linear(self, members: Members, fit: Fit) -> Fit:
        """The fit after one step of the linear model, within the bounds, without a simulation."""
        _, gradient, curvature = self._expanded(members, fit)
        varied, end = self.coordinates.in_fit(members), fit.x.copy()
        room = self.coordinates.room(fit.x)[:, varied]
        end[varied] += _bounded(curvature[np.ix_(varied, varied)], gradient[varied], room)
        moved = replace(fit, x=end, rows=fit.rows + fit.near.slope @ (end - fit.x))
        return replace(moved, loss=self._expanded(members, moved)[0])

    def evidence(self, members: Members, fit: Fit) -> float:
        """Logarithm of the marginal likelihood, up to a constant, linearised about the fit."""
        loss, log_volume, _ = self._marginal(members, fit)
        direct = self.counted(members) + self._coloured(fit) - self.cost * len(members)
        return direct - loss - 0.5 * log_volume

    def seems(self, members: Members, fit: Fit) -> Array:
        """Step of all columns to the maximum of the posterior, with those of absent effects."""
        return self._marginal(members, fit)[2]

    def _marginal(self, members: Members, fit: Fit) -> tuple[float, float, Array]:
        """Loss at that maximum, the log-volume of the posterior in the prior's, and the step."""
        loss, gradient, curvature = self._whole(members, fit)
        absent = ~self.coordinates.in_fit(members)
        largest = _AT_MOST * np.sqrt(np.diag(self.prior.covariance))
        room = np.where(absent, np.stack([-largest, largest]), self.coordinates.room(fit.x))
        step = _bounded(curvature, gradient, room)
        loss += float(gradient @ step) + 0.5 * float(step @ curvature @ step)
        log_volume = np.linalg.slogdet(curvature)[1]
        log_volume -= np.linalg.slogdet(self.precision(members))[1]
        return loss, float(log_volume), step

    def covariance(self, members: Members, fit: Fit) -> Array:
        """Posterior covariance of all columns, shape (F, F)."""
        _, _, normal = self.used(fit)
        return np.asarray(np.linalg.inv(normal + self.precision(members)))

    def plain(self, x: Array | None = None, rounds: int = 3) -> Hypothesis[Fit]:
        """The hypothesis that nothing is missing, fitted from a point (F,) or the prior's mean."""
        nothing: Members = frozenset()
        x = self.centre(nothing) if x is None else x
        for _ in range(rounds):
            linearised = self.at(x)
            self.first_fits = self.first_fits or [linearised]
            (fit,) = self.fitted([(nothing, self._shifted(nothing, linearised))])
            x = fit.x
        final = self.at(x)
        return Hypothesis(nothing, final, self.evidence(nothing, final))

    def refined(self, members: Members, fit: Fit, nearby: Slope | None = None) -> Hypothesis[Fit]:
        """The fit linearised at its point and continued from there."""
        linearised = self._shifted(members, self.at(fit.x, members, nearby))
        (continued,) = self.fitted([(members, linearised)])
        return Hypothesis(members, continued, self.evidence(members, continued))

    def _shifted(self, members: Members, fit: Fit) -> Fit:
        """The fit with all latencies moved, where that reduces the loss."""
        columns = self.coordinates.columns
        late = [c.name.endswith(LATENCY) and c.effect is None for c in columns]
        points = self.coordinates.clipped(fit.x + SUBSTEP_S * np.outer(_SHIFTS, late))
        trials = [
            replace(fit, x=x, rows=rows) for x, rows in zip(points, self.rows(points), strict=True)
        ]
        return min([fit, *trials], key=lambda one: self._expanded(members, one)[0])

    def held(self, members: Members, fit: Fit, share: float) -> tuple[Fit, Mask]:
        """A fit to the first part of each swim, started from ``fit``, and the rows left out."""
        first = [
            np.repeat(blocks.block < round((1 - share) * len(blocks.edges)), weight.shape[1])
            for blocks, weight in zip(self.blocks, self.weights, strict=True)
        ]
        part = copy(self)
        part.kept = np.concatenate(first)
        (fitted,) = part.fitted([(members, fit)])
        return fitted, ~part.kept

    def fitted(self, initial: Sequence[tuple[Members, Fit]]) -> list[Fit]:
        """Continue fits by their linear models, with one batch of simulations per step."""
        c = self.coordinates
        unit = 50 * c.each("step")
        known = [np.array([fit.rows for _, fit in initial])]

        def expand(x: Array, index: Index) -> Expansion:
            points = c.clipped(x * unit)
            rows = known.pop() if known else self.rows(points)
            parts = [
                self._expanded(initial[k][0], replace(initial[k][1], x=point, rows=row))
                for k, point, row in zip(index, points, rows, strict=True)
            ]
            loss, gradient, curvature = (np.array(part) for part in zip(*parts, strict=True))
            scaled = curvature * unit * unit[:, None]
            return Expansion(loss, gradient * unit, scaled, {"rows": rows})

        start = np.array([fit.x for _, fit in initial]) / unit
        low, high = (np.tile(c.each(end) / unit, (len(initial), 1)) for end in ("low", "high"))
        free = np.array([c.in_fit(members) for members, _ in initial])
        found = minimise(expand, start, low, high, free=free, evaluations=_STEPS)
        rows, loss = found.expansion.aside["rows"], found.expansion.loss
        return [
            Fit(c.clipped(found.x[k] * unit), rows[k], float(loss[k]), fit.near)
            for k, (_, fit) in enumerate(initial)
        ]


def repeated(swims: Sequence[Swim]) -> float:
    """Share of poses identical to the one before, which shows lost frames."""
    return max(swim.repeated for swim in swims)


def _bounded(curvature: Array, gradient: Array, room: Array, rounds: int = 4) -> Array:
    """Minimiser of a quadratic within bounds ``room`` (2, F), with columns at a bound fixed."""
    step = -np.linalg.solve(curvature, gradient)
    fixed = np.zeros(step.size, dtype=bool)
    for _ in range(rounds):
        outside = (step < room[0]) | (step > room[1])
        if not (outside & ~fixed).any():
            break
        fixed |= outside
        step = np.clip(step, room[0], room[1])
        free = ~fixed
        reduced = gradient[free] + curvature[np.ix_(free, fixed)] @ step[fixed]
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], reduced)
    return np.clip(step, room[0], room[1])
