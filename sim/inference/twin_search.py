"""Swims of one robot as a problem of ``sim2real.inference.selection``, in the twin.

Near a fit a swim is linear in all coordinates, so one batch of rollouts (``look``) predicts the
gain of every effect, and refits follow its derivatives with one or two rollouts per step. The error
of the twin counts as noise: residuals have the variance of ``Blocks``, shapes of the error
(``discrepancy``) are columns that are marginalised and not fitted, and effects that a hypothesis
does not contain have a prior as wide as the error imitates them. So the evidence is that of a
normal model with all columns in every hypothesis: those of its effects have the effects' priors,
the others that of the imitation (MacKay, Information Theory, Inference, and Learning Algorithms
(2003), ch. 28).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim.inference import discrepancy, poses
from sim.inference.blocks import Blocks, spectrum
from sim.inference.coordinates import DOUBT, ERROR, Coordinates, SwimSimulator, in_fit, signals_at
from sim.inference.linear_fit import Fit, Slope, SwimPrior, bounded
from sim.inference.starts import with_other_sizes
from sim.inference.swims import Swim
from sim2real.arrays import Array, Mask
from sim2real.inference.selection import Hypothesis, Ledger, Members

FIRST = 8
"""Number of single effects that are refitted, those with the largest predicted evidence."""
LOST, FILTER = "dropped_frames.probability", "pose_filter.time_constant_s"
_STEPS = 3
_IN_DOUBT = 0.05
"""Relative error of the twin in the change that an effect makes, independent for each coefficient;
the persistent part of this error is in ``discrepancy``."""
_AT_MOST = 3.0
"""Largest imitation of an absent effect by the twin's error, in standard deviations: larger values
are not due to the error, and the linear model does not hold there."""
_SETTLED = 0.7
"""Change of the loss below which a fit has converged."""
_SHARES = (1.0, 0.4, 0.1)
"""Shares of a step that are compared in one batch."""


@dataclass
class TwinSwims:
    """Swims of one robot as a problem of the search.

    Attributes:
        coordinates: Coordinates of the robot.
        swims: Its recordings.
        simulate: The twin.
        prior: Prior of the parameters.
        cost: Log-evidence that is subtracted for each effect.
        doubted: Change that effects make in each swim by the twin, (T, 3 + J), which has an error
            in proportion to its size.
        blocks, weights: Transformed swims, and reciprocal standard deviations of their errors.
        is_error: Whether each column is a shape of the twin's error, shape (F,).
        first_fit: First linearised fit without effects.
        kept: Rows that a fit uses, shape (n,); all where None.
    """

    coordinates: Coordinates
    swims: Sequence[Swim]
    simulate: SwimSimulator
    prior: SwimPrior
    cost: float = 0.0
    doubted: Sequence[Array] = ()
    blocks: list[Blocks] = field(init=False)
    weights: list[Array] = field(init=False)
    is_error: Mask = field(init=False)
    first_fit: Fit | None = None
    kept: Mask | None = None
    rollouts: int = 0
    _doubts: Array | None = field(default=None, init=False, repr=False)
    _precisions: dict[Members, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Transform the recordings and compute their weights."""
        seems = self.prior.mean.copy()
        seems[self.coordinates.base] = 0.0
        self.coordinates = replace(self.coordinates, seems=seems)
        self.blocks = [Blocks.of(swim) for swim in self.swims]
        variances: list[Array | float] = [0.0] * len(self.blocks)
        for k, change in enumerate(self.doubted):
            variances[k] = _IN_DOUBT**2 * self.blocks[k].about(change)
        pairs = zip(self.blocks, variances, strict=True)
        self.weights = [blocks.weights(self.prior.shares, more) for blocks, more in pairs]
        if self.doubted:
            self._doubt()
        self.is_error = np.array([c.name.startswith(ERROR) for c in self.coordinates.columns])
        if not any(c.kind.startswith("servo") for c in self.coordinates.columns):
            for weight in self.weights:  # joints that are prescribed carry no information
                weight[:, 3:] = 0.0

    def _doubt(self) -> None:
        """Add parameters, with a prior, for the error of the twin in the changes by effects."""
        joints = len(self.coordinates.model.joints)
        sizes = discrepancy.of_changes(joints)
        self.coordinates = self.coordinates.doubting()
        self.prior = self.prior.extended(np.array(list(sizes.values())))
        parts = []
        for blocks, weight, change in zip(self.blocks, self.weights, self.doubted, strict=True):
            shapes = discrepancy.shapes(change)
            values = np.array([shapes[f"{ERROR}.{name}"] for name in sizes])
            transformed = spectrum(values, blocks.edges) * weight
            parts.append(transformed.reshape(len(sizes), -1).T)
        self._doubts = np.concatenate(parts)

    # --- simulations -------------------------------------------------------------------------

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F), shape (E, n); of all rows, also those not fitted."""
        self.rollouts += len(points) * len(self.swims)
        parts = []
        for swim, blocks, weight in zip(self.swims, self.blocks, self.weights, strict=True):
            error = blocks.errors(signals_at(self.coordinates, swim, points, self.simulate))
            parts.append((error * weight).reshape(len(points), -1))
        return np.concatenate(parts, axis=1)

    def slope(
        self, x: Array, nearby: Slope | None = None, members: Members = frozenset()
    ) -> tuple[Array, Slope]:
        """Weighted errors at a point, and their derivatives with respect to all columns.

        With a slope from nearby, only columns that a fit with these members varies are recomputed.
        """
        points, base = self.coordinates.about(x)
        moved = np.array([not c.name.startswith(DOUBT) for c in self.coordinates.columns])
        if nearby is not None:
            moved &= in_fit(self.coordinates.columns, members)
        fresh = np.flatnonzero(moved)
        rows = self.rows(self.coordinates.clipped(points[np.concatenate([[0], fresh + 1])]))
        base_rows = np.searchsorted(fresh + 1, base[fresh]) + (base[fresh] > 0)
        slope = np.empty((rows.shape[1], x.size)) if nearby is None else nearby.slope.copy()
        slope[:, fresh] = ((rows[1:] - rows[base_rows]) / self.coordinates.steps(x)[fresh, None]).T
        if self._doubts is not None:
            slope[:, -self._doubts.shape[1] :] = self._doubts
        return rows[0], Slope(x, slope, slope.T @ slope)

    def at(self, x: Array) -> Fit:
        """The linearised fit without effects at a point (F,)."""
        rows, near = self.slope(x)
        return Fit(x, rows, self.loss_and_step(frozenset(), x, rows, near)[0], near)

    # --- the normal model --------------------------------------------------------------------

    def precision(self, members: Members) -> Array:
        """Precision of the prior of all columns, shape (F, F)."""
        if members not in self._precisions:
            c, covariance = self.coordinates, self.prior.covariance.copy()
            varied = in_fit(c.columns, members)
            for k in np.flatnonzero(varied):
                column = c.columns[k]
                if column.effect is not None:
                    covariance[k, k] += column.prior_sd**2
            lost = c.place.get(LOST)
            if lost is not None and varied[lost]:
                covariance[lost, lost] = poses.repeated_variance(self.swims)
            self._precisions[members] = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return self._precisions[members]

    def centre(self, members: Members) -> Array:
        """Mean of the prior, shape (F,); the share of lost frames is counted and not fitted."""
        c = self.coordinates
        x = c.nominal
        x[c.base] = self.prior.mean[c.base]
        if LOST in c.place and in_fit(c.columns, members)[c.place[LOST]]:
            x[c.place[LOST]] = poses.repeated(self.swims)
        return x

    def counted(self, members: Members) -> float:
        """Log-evidence of the count of repeated poses."""
        lost = any(effect.name == LOST.partition(".")[0] for effect in members)
        return poses.counted(self.swims, lost=lost) if LOST in self.coordinates.place else 0.0

    def coloured(self, fit: Fit) -> float:
        """Log-evidence of the spectrum of the poses' noise."""
        place = self.coordinates.place.get(FILTER)
        return 0.0 if place is None else poses.coloured(self.swims, float(fit.x[place]))

    def loss_and_step(
        self, members: Members, x: Array, rows: Array, near: Slope
    ) -> tuple[float, Array]:
        """Loss at a point, and the step to its minimum by the linear model, shape (F,).

        The loss is minimised over the columns of the simulator's error, so that a fit does not
        adapt to this error. Other columns that the fit does not vary stay at 0.
        """
        varied = in_fit(self.coordinates.columns, members)
        free = varied | self.is_error
        prior = self.precision(members)[np.ix_(free, free)]
        errors, slope, normal = self._used(rows, near)
        deviation = (x - self.centre(members))[free]
        gradient = slope[:, free].T @ errors + prior @ deviation
        curvature = normal[np.ix_(free, free)] + prior
        step = np.zeros(x.size)
        step[free] = bounded(curvature, gradient, self.coordinates.room(x)[:, free])
        step[self.is_error] = 0.0
        loss = 0.5 * float(errors @ errors) + 0.5 * float(deviation @ prior @ deviation)
        error = self.is_error[free]
        pull = gradient[error]
        gain = float(pull @ np.linalg.solve(curvature[np.ix_(error, error)], pull))
        return loss - 0.5 * gain, step

    def evidence(self, members: Members, fit: Fit) -> float:
        """Logarithm of the marginal likelihood, up to a constant of the swims.

        The swims are linearised about the fit in all columns; those of absent effects are as large
        as the twin's error imitates them.
        """
        loss, log_volume, _ = self._marginal(members, fit)
        direct = self.counted(members) + self.coloured(fit) - self.cost * len(members)
        return direct - loss - 0.5 * log_volume

    def seems(self, members: Members, fit: Fit) -> Array:
        """Step of all columns to the maximum of the posterior, with those of absent effects."""
        return self._marginal(members, fit)[2]

    def _marginal(self, members: Members, fit: Fit) -> tuple[float, float, Array]:
        prior = self.precision(members)
        errors, slope, normal = self._used(fit.rows, fit.near)
        deviation = fit.x - self.centre(members)
        gradient = slope.T @ errors + prior @ deviation
        curvature = normal + prior
        absent = ~in_fit(self.coordinates.columns, members)
        largest = _AT_MOST * np.sqrt(np.diag(self.prior.covariance))
        room = np.where(absent, np.stack([-largest, largest]), self.coordinates.room(fit.x))
        step = bounded(curvature, gradient, room)
        loss = 0.5 * float(errors @ errors) + 0.5 * float(deviation @ prior @ deviation)
        loss += float(gradient @ step) + 0.5 * float(step @ curvature @ step)
        log_volume = np.linalg.slogdet(curvature)[1] - np.linalg.slogdet(prior)[1]
        return loss, float(log_volume), step

    def covariance(self, members: Members, near: Slope) -> Array:
        """Posterior covariance of all columns, shape (F, F)."""
        _, _, normal = self._used(None, near)
        return np.asarray(np.linalg.inv(normal + self.precision(members)))

    def _used(self, rows: Array | None, near: Slope) -> tuple[Array, Array, Array]:
        empty = np.zeros(0)
        if self.kept is None:
            return (empty if rows is None else rows), near.slope, near.normal
        slope = near.slope[self.kept]
        return (empty if rows is None else rows[self.kept]), slope, slope.T @ slope

    def part(self, fit: Fit) -> tuple[Array, Array]:
        """Rows that a fit uses, and their derivatives."""
        rows, slope, _ = self._used(fit.rows, fit.near)
        return rows, slope

    # --- fits --------------------------------------------------------------------------------

    def plain(self, rounds: int = 3) -> Hypothesis[Fit]:
        """The hypothesis that nothing is missing."""
        nothing: Members = frozenset()
        x = self.centre(nothing)
        for number in range(rounds):
            linearised = self.at(x)
            self.first_fit = linearised if number == 0 else self.first_fit
            (fit,) = self._walk([(nothing, linearised)], 2)
            x = fit.x
        return self._linearised(nothing, x)

    def _linearised(self, members: Members, x: Array, old: Slope | None = None) -> Hypothesis[Fit]:
        """The fit at a point, linearised there."""
        rows, near = self.slope(x, old, members)
        fit = Fit(x, rows, self.loss_and_step(members, x, rows, near)[0], near, local=True)
        return Hypothesis(members, fit, self.evidence(members, fit))

    def refined(self, members: Members, fit: Fit, nearby: Slope | None = None) -> Hypothesis[Fit]:
        """The fit linearised at its point and continued from there."""
        linearised = self._linearised(members, fit.x, nearby).fit
        (continued,) = self._walk([(members, linearised)], 2)
        return Hypothesis(members, continued, self.evidence(members, continued))

    def converged(self, hypothesis: Hypothesis[Fit], rounds: int = 2) -> Hypothesis[Fit]:
        """The hypothesis, linearised and refitted until its loss no longer changes."""
        for _ in range(rounds):
            loss = hypothesis.fit.loss
            hypothesis = self.refined(hypothesis.members, hypothesis.fit, hypothesis.fit.near)
            if abs(loss - hypothesis.fit.loss) < _SETTLED:
                break
        return hypothesis

    def held(self, members: Members, fit: Fit, share: float) -> tuple[Fit, Mask]:
        """A fit to the first part of each swim, started from ``fit``, and the rows left out."""
        first = [
            np.repeat(blocks.block < round((1 - share) * len(blocks.edges)), weight.shape[1])
            for blocks, weight in zip(self.blocks, self.weights, strict=True)
        ]
        self.kept = np.concatenate(first)
        try:
            (fitted,) = self._walk([(members, replace(fit, loss=np.inf))], _STEPS)
        finally:
            kept, self.kept = self.kept, None
        return fitted, ~kept

    def _walk(self, initial: Sequence[tuple[Members, Fit]], steps: int) -> list[Fit]:
        """Continue fits by their linear models, with one batch of simulations per step."""
        fits = [fit for _, fit in initial]
        going = list(range(len(initial)))
        for _ in range(steps):
            if not going:
                break
            trials = []
            for k in going:
                members, fit = initial[k][0], fits[k]
                _, step = self.loss_and_step(members, fit.x, fit.rows, fit.near)
                trials += [self.coordinates.clipped(fit.x + share * step) for share in _SHARES]
            rows = self.rows(np.array(trials))
            improving = []
            for number, k in enumerate(going):
                members, before = initial[k][0], fits[k]
                for n in range(len(_SHARES)):
                    i = number * len(_SHARES) + n
                    loss, _ = self.loss_and_step(members, trials[i], rows[i], before.near)
                    if loss < fits[k].loss:
                        fits[k] = Fit(trials[i], rows[i], loss, before.near)
                if fits[k].loss < before.loss - 0.1:
                    improving.append(k)
            going = improving
        return fits

    # --- what the search asks ----------------------------------------------------------------

    def look(self, places: Sequence[tuple[Ledger[Fit], Members]]) -> None:
        """Linearise the fits of these sets, and continue them."""
        for ledger, members in places:
            hypothesis = ledger.tried[members]
            if not hypothesis.fit.local:
                refined = self.refined(members, hypothesis.fit)
                ledger.tried[members] = replace(refined, fit=replace(refined.fit, local=True))

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Fit]]:
        """Effects with the largest predicted evidence when added to a set, by its linear model."""
        fits = [ledger.tried[members].fit, *self._first_fits(members)]
        candidates = []
        for effect in self.coordinates.effects:
            if effect not in members:
                more = members | {effect}
                predicted = [self.evidence(more, self.linear(more, fit)) for fit in fits]
                candidates.append((max(predicted), effect))
        candidates.sort(key=lambda candidate: -candidate[0])
        return [(effect, fits[0]) for _, effect in candidates[: most or FIRST]]

    def _first_fits(self, members: Members) -> list[Fit]:
        """Another start for fits from the plain model: the first linearised fit.

        A law that was adapted to swims with a missing effect is a bad start for a fit of it.
        """
        return [] if members or self.first_fit is None else [self.first_fit]

    def linear(self, members: Members, fit: Fit) -> Fit:
        """The fit after one step of the linear model, within the bounds."""
        _, step = self.loss_and_step(members, fit.x, fit.rows, fit.near)
        end = self.coordinates.clipped(fit.x + step)
        rows = fit.rows + fit.near.slope @ (end - fit.x)
        return Fit(end, rows, self.loss_and_step(members, end, rows, fit.near)[0], fit.near)

    def start(self, ledger: Ledger[Fit], members: Members) -> Fit:
        """The best fit, with the columns of effects outside ``members`` reset."""
        best = ledger.best
        keep = in_fit(self.coordinates.columns, members)
        x = np.where(keep, best.fit.x, self.coordinates.nominal)
        return replace(best.fit, x=x, rows=self.rows(x[None])[0])

    def refit(self, jobs: Sequence[tuple[Ledger[Fit], Members, Fit]]) -> list[Hypothesis[Fit]]:
        """Fit sets, each started from a fit of a subset, with one batch of simulations per step."""
        initial = []
        for _, members, fit in jobs:
            loss, _ = self.loss_and_step(members, fit.x, fit.rows, fit.near)
            initial.append((members, Fit(fit.x, fit.rows, loss, fit.near)))
        count = len(initial)
        for _, members, _ in jobs:
            if len(members) == 1:
                initial += [(members, fit) for fit in self._first_fits(frozenset())]
        initial = with_other_sizes(self, initial)
        ended = self._walk(initial, _STEPS)
        best: dict[Members, Fit] = {}
        for (members, _), fit in zip(initial, ended, strict=True):
            previous = best.get(members)
            best[members] = fit if previous is None or fit.loss < previous.loss else previous
        return [
            Hypothesis(members, best[members], self.evidence(members, best[members]))
            for members, _ in initial[:count]
        ]

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether the best set has effects, so that the search continues."""
        return bool(ledger.best.members)


__all__ = ["SwimPrior", "Fit", "Slope", "TwinSwims"]
