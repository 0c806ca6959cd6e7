"""Swims of one robot as a least-squares problem, for the search for effects and for calibrations.

Fits follow the derivatives of one batch of rollouts. Shapes of the simulator's error are columns
that are marginalised; absent effects have a prior as wide as the error imitates them, so that the
evidence is that of a normal model with all columns (MacKay, Information Theory, Inference, and
Learning Algorithms (2003), ch. 28).
"""

from collections.abc import Hashable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from sim.inference.coordinates import ERROR, LATENCY, SUBSTEP_S, Coordinates, signals_at
from sim.inference.signal_error import Blocks
from sim.inference.swims import Swim, SwimSimulator
from sim2real.arrays import Array, Index, Mask
from sim2real.inference.least_squares import Expansion, minimise
from sim2real.inference.selection import Hypothesis, Ledger, Members

LOST, FILTER = ("dropped_frames", "camera"), "pose_filter.time_constant_s"
COST = 3.422
"""Log-evidence that an effect must gain in the search; probabilities are computed later."""
FIRST = 8
"""Number of single effects that are refitted, those with the largest predicted evidence."""
_AT_MOST = 3.0
"""Largest imitation of an absent effect by the twin's error, in standard deviations: larger values
are not due to the error, and the linear model does not hold there."""
_SHIFTS = (-2.0, -1.0, 1.0)
"""Sub-steps by which latencies are moved: a fit has minima a sub-step of the twin apart."""


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
class Fit:
    """Fit of a hypothesis."""

    x: Array  # the point, shape (F,): 0 for effects that are not in the hypothesis
    rows: Array  # weighted errors there, shape (n,)
    slope: Array  # derivatives of the rows that the fit used, shape (n, F)
    normal: Array  # their product, shape (F, F)
    loss: float = 0.0  # negative logarithm of likelihood times prior
    local: bool = False  # whether the derivatives are those near this point


@dataclass
class SwimProblem:
    """Swims of one robot as a problem of fits, and of ``sim2real.inference.selection``."""

    coordinates: Coordinates  # coordinates of the robot
    swims: Sequence[Swim]  # its recordings
    simulate: SwimSimulator  # the simulator
    prior: SwimPrior  # prior of the parameters
    # blocks, weights: transformed swims, and reciprocal standard deviations of their errors
    blocks: list[Blocks] = field(init=False)
    weights: list[Array] = field(init=False)
    _precisions: dict[Members, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Transform the recordings and compute their weights."""
        seems = self.prior.mean.copy()
        seems[self.coordinates.base] = 0.0
        self.coordinates = replace(self.coordinates, seems=seems)
        self.blocks = [Blocks.of(swim) for swim in self.swims]
        self.weights = [blocks.weights(self.prior.shares) for blocks in self.blocks]

    @property
    def repeated(self) -> float:
        """Share of poses identical to the one before, which shows lost frames."""
        return max(swim.repeated for swim in self.swims)

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F), shape (E, n)."""
        signals = (signals_at(self.coordinates, s, points, self.simulate) for s in self.swims)
        parts = zip(self.blocks, signals, self.weights, strict=True)
        rows = [(blocks.errors(x) * weight).reshape(len(points), -1) for blocks, x, weight in parts]
        return np.concatenate(rows, axis=1)

    def of_swims(self, rows: Array) -> list[Array]:
        """Rows (n, ...) of each swim, shape (T, 3 + J, ...)."""
        ends = np.cumsum([weight.size for weight in self.weights])[:-1]
        parts = zip(np.split(rows, ends), self.weights, strict=True)
        return [part.reshape(*weight.shape, *rows.shape[1:]) for part, weight in parts]

    def misfit(self, members: Members, fit: Fit) -> Array:
        """Mean squares of residuals less the estimated error, by signal and band, shape (4, 3)."""
        rows = fit.rows + fit.slope @ self.seems(members, fit)
        sums, counts = np.zeros((4, 3)), np.zeros((4, 3))
        for blocks, part in zip(self.blocks, self.of_swims(rows**2), strict=True):
            for k in range(part.shape[1]):
                np.add.at(sums[min(k, 3)], blocks.band, part[:, k])
                np.add.at(counts[min(k, 3)], blocks.band, 1.0)
        return sums / np.maximum(counts, 1.0)

    def at(self, x: Array, members: Members = frozenset(), nearby: Fit | None = None) -> Fit:
        """The fit of a set at a point (F,), with derivatives there.

        With a fit ``nearby`` only those of what the set varies are computed anew.
        """
        c = self.coordinates
        points, base = c.about(x)
        fresh = np.arange(x.size) if nearby is None else np.flatnonzero(c.in_fit(members))
        rows = self.rows(c.clipped(points[np.append(0, fresh + 1)]))
        base_rows = np.searchsorted(fresh + 1, base[fresh]) + (base[fresh] > 0)
        slope = np.empty((rows.shape[1], x.size)) if nearby is None else nearby.slope.copy()
        slope[:, fresh] = ((rows[1:] - rows[base_rows]) / c.steps(x)[fresh, None]).T
        fit = Fit(x, rows[0], slope, slope.T @ slope, local=True)
        return replace(fit, loss=self._profile(members, fit)[0])

    def precision(self, members: Members) -> Array:
        """Precision of the prior of all columns, shape (F, F)."""
        if members not in self._precisions:
            c, covariance = self.coordinates, self.prior.covariance.copy()
            for k in (k for effect in members for k in c.effects[effect]):
                covariance[k, k] += c.columns[k].prior_sd ** 2
            if LOST in members:
                n, share = sum(swim.t.size for swim in self.swims), self.repeated
                (k,) = c.effects[LOST]
                covariance[k, k] = (share * (1 - share) + 1 / n) / n
            self._precisions[members] = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return self._precisions[members]

    def centre(self, members: Members) -> Array:
        """Mean of the prior, shape (F,); the share of lost frames is counted and not fitted."""
        c = self.coordinates
        x = c.nominal
        x[c.base] = self.prior.mean[c.base]
        if LOST in members:
            x[c.effects[LOST]] = self.repeated
        return x

    def counted(self, members: Members) -> float:
        """Log-evidence of the count of repeated poses: noise repeats none."""
        if LOST not in members:
            return 0.0
        count = self.repeated * sum(swim.t.size for swim in self.swims)
        return min(3.0 * count, 600.0) if count > 1 else -600.0

    def _expanded(self, members: Members, fit: Fit) -> tuple[float, Array, Array]:
        """Loss at the point of a fit, its gradient (F,) and curvature (F, F) in all columns."""
        prior, deviation = self.precision(members), fit.x - self.centre(members)
        loss = 0.5 * float(fit.rows @ fit.rows) + 0.5 * float(deviation @ prior @ deviation)
        return loss, fit.slope.T @ fit.rows + prior @ deviation, fit.normal + prior

    def _profile(self, members: Members, fit: Fit) -> tuple[float, Array, Array]:
        """The same, minimised over the simulator's error, to which a fit thus does not adapt."""
        loss, gradient, curvature = self._expanded(members, fit)
        error = np.array([c.name.startswith(ERROR) for c in self.coordinates.columns])
        coupling = curvature[error]
        own = curvature[np.ix_(error, error)]
        solved = np.linalg.solve(own, np.column_stack([coupling, gradient[error]]))
        loss -= 0.5 * float(gradient[error] @ solved[:, -1])
        gradient = gradient - coupling.T @ solved[:, -1]
        return loss, gradient, curvature - coupling.T @ solved[:, :-1]

    def evidence(self, members: Members, fit: Fit) -> float:
        """Logarithm of the marginal likelihood, less ``COST`` for each effect, up to a constant.

        It is that of the linear model about a fit, which may be one of fewer effects; the spectrum
        of the poses' noise adds evidence for a filter.
        """
        loss, gradient, curvature = self._expanded(members, fit)
        step = self.seems(members, fit)
        loss += float(gradient @ step) + 0.5 * float(step @ curvature @ step)
        volume = np.linalg.slogdet(curvature)[1] - np.linalg.slogdet(self.precision(members))[1]
        end = np.where(self.coordinates.in_fit(members), fit.x + step, 0.0)
        direct = self.counted(members)
        if (k := self.coordinates.place.get(FILTER)) is not None:
            direct += sum(swim.pose_noise.log_ratio(float(end[k])) for swim in self.swims)
        return direct - COST * len(members) - loss - 0.5 * float(volume)

    def seems(self, members: Members, fit: Fit) -> Array:
        """Step (F,) to the maximum of the posterior, with absent effects, within the bounds."""
        _, gradient, curvature = self._expanded(members, fit)
        absent = ~self.coordinates.in_fit(members)
        reach = _AT_MOST * np.sqrt(np.diag(self.prior.covariance))
        low, high = (np.where(absent, sign * reach, self.coordinates.each(end) - fit.x)
                     for sign, end in ((-1, "low"), (1, "high")))  # fmt: skip
        step = -np.linalg.solve(curvature, gradient)
        fixed = np.zeros(step.size, dtype=bool)
        for _ in range(4):
            outside = (step < low) | (step > high)
            if not (outside & ~fixed).any():
                break
            fixed |= outside
            step = np.clip(step, low, high)
            rest = gradient + curvature[:, fixed] @ step[fixed]
            step[~fixed] = -np.linalg.solve(curvature[np.ix_(~fixed, ~fixed)], rest[~fixed])
        return np.clip(step, low, high)

    def covariance(self, members: Members, fit: Fit) -> Array:
        """Posterior covariance of all columns, shape (F, F)."""
        return np.asarray(np.linalg.inv(fit.normal + self.precision(members)))

    def plain(self, x: Array | None = None, rounds: int = 3) -> Hypothesis[Fit]:
        """The hypothesis that nothing is missing, fitted from a point (F,) or the prior's mean."""
        nothing: Members = frozenset()
        x = self.centre(nothing) if x is None else x
        for _ in range(rounds):
            (fit,) = self.fitted([(nothing, self._shifted(nothing, self.at(x)))])
            x = fit.x
        final = self.at(x)
        return Hypothesis(nothing, final, self.evidence(nothing, final))

    def refined(self, members: Members, fit: Fit, nearby: Fit | None = None) -> Hypothesis[Fit]:
        """The fit continued from its point with derivatives there."""
        start = self._shifted(members, self.at(fit.x, members, nearby))
        (continued,) = self.fitted([(members, start)])
        fit = replace(continued, local=True)
        return Hypothesis(members, fit, self.evidence(members, fit))

    def _shifted(self, members: Members, fit: Fit) -> Fit:
        """The fit with all latencies moved, where that reduces the loss."""
        columns = self.coordinates.columns
        late = [c.name.endswith(LATENCY) and c.effect is None for c in columns]
        points = self.coordinates.clipped(fit.x + SUBSTEP_S * np.outer(_SHIFTS, late))
        pairs = zip(points, self.rows(points), strict=True)
        trials = [replace(fit, x=x, rows=rows) for x, rows in pairs]
        return min([fit, *trials], key=lambda one: self._profile(members, one)[0])

    def held(self, members: Members, fit: Fit, share: float) -> tuple[Fit, Mask]:
        """A fit to the first part of each swim, from ``fit``, and the rows that it left out."""
        part = copy(self)
        part.weights = [
            weight * (blocks.block < round((1 - share) * len(blocks.edges)))[:, None]
            for blocks, weight in zip(self.blocks, self.weights, strict=True)
        ]
        kept = np.concatenate([weight.ravel() for weight in part.weights]) > 0
        slope = fit.slope * kept[:, None]
        first = replace(fit, rows=fit.rows * kept, slope=slope, normal=slope.T @ slope)
        (fitted,) = part.fitted([(members, first)])
        return fitted, ~kept

    def fitted(self, initial: Sequence[tuple[Members, Fit]]) -> list[Fit]:
        """Continue fits by their linear models, with one batch of simulations per step."""
        c = self.coordinates
        unit = 50 * c.each("step")
        known = [np.array([fit.rows for _, fit in initial])]

        def expand(x: Array, index: Index) -> Expansion:
            points = c.clipped(x * unit)
            rows = known.pop() if known else self.rows(points)
            parts = [
                self._profile(initial[k][0], replace(initial[k][1], x=point, rows=row))
                for k, point, row in zip(index, points, rows, strict=True)
            ]
            loss, gradient, curvature = (np.array(part) for part in zip(*parts, strict=True))
            scaled = curvature * unit * unit[:, None]
            return Expansion(loss, gradient * unit, scaled, {"rows": rows})

        start = np.array([fit.x for _, fit in initial]) / unit
        low, high = (np.tile(c.each(end) / unit, (len(initial), 1)) for end in ("low", "high"))
        free = np.array([c.in_fit(members) for members, _ in initial])
        found = minimise(expand, start, low, high, free=free, evaluations=6)
        rows, loss = found.expansion.aside["rows"], found.expansion.loss
        return [
            replace(fit, x=c.clipped(x * unit), rows=rows[k], loss=float(loss[k]), local=False)
            for k, ((_, fit), x) in enumerate(zip(initial, found.x, strict=True))
        ]

    def look(self, places: Sequence[tuple[Ledger[Fit], Members]]) -> None:
        """Linearise the fits of these sets, and continue them."""
        for ledger, members in places:
            fit = ledger.tried[members].fit
            if not fit.local:
                ledger.tried[members] = self.refined(members, fit)

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Fit]]:
        """Effects with the largest predicted evidence when added to a set, by its linear model."""
        fit, others = ledger.tried[members].fit, self.coordinates.effects.keys() - members
        promise = {effect: self.evidence(members | {effect}, fit) for effect in others}
        order = sorted(others, key=lambda effect: (-promise[effect], effect))
        return [(effect, fit) for effect in order[: most or FIRST]]

    def start(self, ledger: Ledger[Fit], members: Members) -> Fit:
        """The best fit, with the columns of effects outside ``members`` reset."""
        fit = ledger.best.fit
        x = np.where(self.coordinates.in_fit(members), fit.x, self.coordinates.nominal)
        return replace(fit, x=x, rows=self.rows(x[None])[0])

    def refit(self, jobs: Sequence[tuple[Ledger[Fit], Members, Fit]]) -> list[Hypothesis[Fit]]:
        """Fit sets, each started from a fit of a subset, with one batch of simulations per step."""
        best: dict[Members, Fit] = {}
        sets = [members for _, members, _ in jobs]
        for members, fit in zip(sets, self.fitted([job[1:] for job in jobs]), strict=True):
            if members not in best or fit.loss < best[members].loss:
                best[members] = fit
        found = {m: Hypothesis(m, fit, self.evidence(m, fit)) for m, fit in best.items()}
        return [found[members] for members in sets]

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether the best set has effects, so that the search continues."""
        return bool(ledger.best.members)
