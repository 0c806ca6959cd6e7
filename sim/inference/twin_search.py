"""Swims of one robot as a problem of ``sim2real.inference.selection``, in the twin.

Near a fit a swim is linear in all coordinates, so one batch of rollouts (``look``) tells what every
effect would bring, and refits follow its derivatives, a rollout or two a step. What the twin gets
wrong is a part of the noise: what is left has the size that ``Blocks`` say, shapes of that error
(``discrepancy``) are columns that no fit bends to, and an effect that a hypothesis does not have
may still seem to be there by as much as the error imitates it. So evidence is that of a normal
model with all columns in every hypothesis: those of an effect that is there have its prior, the
others the imitation's (MacKay, Information Theory, Inference, and Learning Algorithms (2003), ch.
28).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sim.inference import discrepancy, poses
from sim.inference.blocks import Blocks, spectrum
from sim.inference.coordinates import DOUBT, ERROR, Coordinates, Swum, in_fit, swum
from sim.inference.linear_fit import Fit, Slope, SwimPrior, bounded
from sim.inference.starts import jumped
from sim.inference.swims import Swim
from sim2real.inference.selection import Hypothesis, Ledger, Members

Array = NDArray[np.float64]

FIRST = 8
"""Single effects that are refitted, of those that promise most."""
LOST, FILTER = "dropped_frames.probability", "pose_filter.time_constant_s"
_STEPS = 3
_IN_DOUBT = 0.05
"""Share by which the twin is wrong of what an effect changes, anywhere by itself; what is wrong of
it all along stands in ``discrepancy``."""
_AT_MOST = 3.0
"""Standard deviations by which the twin's error may pass for an effect that is not there: what is
more is no error, and slopes do not hold so far."""
_SETTLED = 0.7
"""Change of the loss below which a fit stays where it is."""
_SHARES = (1.0, 0.4, 0.1)
"""Of a step, tried together."""


@dataclass
class TwinSwims:
    """Swims, and all that a search asks of them.

    Attributes:
        coordinates: Of the robot.
        swims: Its recordings.
        simulate: The twin.
        prior: Prior of the parameters.
        cost: What an effect costs in evidence.
        doubted: What effects change of each swim by the twin, (T, 3 + J): a share of it is wrong.
    """

    coordinates: Coordinates
    swims: Sequence[Swim]
    simulate: Swum
    prior: SwimPrior
    cost: float = 0.0
    doubted: Sequence[Array] = ()
    blocks: list[Blocks] = field(init=False)
    weights: list[Array] = field(init=False)
    wrong: NDArray[np.bool_] = field(init=False)
    before: Fit | None = None
    kept: NDArray[np.bool_] | None = None
    rollouts: int = 0
    _doubts: Array | None = field(default=None, init=False, repr=False)
    _precisions: dict[Members, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Take the recordings apart."""
        seems = self.prior.mean.copy()
        seems[self.coordinates.base] = 0.0
        self.coordinates = replace(self.coordinates, seems=seems)
        self.blocks = [Blocks.of(swim) for swim in self.swims]
        doubts: list[Array | float] = [0.0] * len(self.blocks)
        for k, change in enumerate(self.doubted):
            doubts[k] = _IN_DOUBT**2 * self.blocks[k].about(change)
        self.weights = [
            one.weights(self.prior.shares, v) for one, v in zip(self.blocks, doubts, strict=True)
        ]
        if self.doubted:
            self._doubt()
        self.wrong = np.array([c.name.startswith(ERROR) for c in self.coordinates.columns])
        if not any(c.kind.startswith("servo") for c in self.coordinates.columns):
            for weight in self.weights:  # joints that follow a film say nothing
                weight[:, 3:] = 0.0

    def _doubt(self) -> None:
        """Add parameters, with a prior, for the error of the twin in what effects change."""
        joints = len(self.coordinates.model.joints)
        sizes = discrepancy.of_changes(joints)
        self.coordinates = self.coordinates.doubting()
        self.prior = self.prior.extended(np.array(list(sizes.values())))
        parts = []
        for blocks, weight, change in zip(self.blocks, self.weights, self.doubted, strict=True):
            shapes = discrepancy.shapes(change)
            known = np.array([shapes[f"{ERROR}.{name}"] for name in sizes])
            told = spectrum(known, blocks.edges) * weight
            parts.append(told.reshape(len(sizes), -1).T)
        self._doubts = np.concatenate(parts)

    # --- simulations -------------------------------------------------------------------------

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F), shape (E, n); all, whether fitted or not."""
        self.rollouts += len(points) * len(self.swims)
        parts = []
        for swim, blocks, weight in zip(self.swims, self.blocks, self.weights, strict=True):
            error = blocks.errors(swum(self.coordinates, swim, points, self.simulate))
            parts.append((error * weight).reshape(len(points), -1))
        return np.concatenate(parts, axis=1)

    def slope(
        self, x: Array, known: Slope | None = None, members: Members = frozenset()
    ) -> tuple[Array, Slope]:
        """Weighted errors at a point, and their derivatives by all columns.

        With those that are ``known`` nearby, only what a fit with these members moves is renewed.
        """
        points, base = self.coordinates.about(x)
        moved = np.array([not c.name.startswith(DOUBT) for c in self.coordinates.columns])
        if known is not None:
            moved &= in_fit(self.coordinates.columns, members)
        fresh = np.flatnonzero(moved)
        rows = self.rows(self.coordinates.clipped(points[np.concatenate([[0], fresh + 1])]))
        of = np.searchsorted(fresh + 1, base[fresh]) + (base[fresh] > 0)
        slope = np.empty((rows.shape[1], x.size)) if known is None else known.slope.copy()
        slope[:, fresh] = ((rows[1:] - rows[of]) / self.coordinates.steps(x)[fresh, None]).T
        if self._doubts is not None:
            slope[:, -self._doubts.shape[1] :] = self._doubts
        return rows[0], Slope(x, slope, slope.T @ slope)

    def at(self, x: Array) -> Fit:
        """The fit that nothing is missing, at a point (F,)."""
        rows, near = self.slope(x)
        return Fit(x, rows, self.judged(frozenset(), x, rows, near)[0], near)

    # --- the normal model --------------------------------------------------------------------

    def precision(self, members: Members) -> Array:
        """Of all columns before the swim, shape (F, F)."""
        if members not in self._precisions:
            c, spread = self.coordinates, self.prior.covariance.copy()
            on = in_fit(c.columns, members)
            for k in np.flatnonzero(on):
                column = c.columns[k]
                if column.effect is not None:
                    spread[k, k] += column.prior_sd**2
            lost = c.place.get(LOST)
            if lost is not None and on[lost]:
                spread[lost, lost] = poses.repeated_variance(self.swims)
            self._precisions[members] = np.asarray(np.linalg.inv(spread), dtype=np.float64)
        return self._precisions[members]

    def centre(self, members: Members) -> Array:
        """The mean before the swim, shape (F,); lost frames are counted, not fitted."""
        c = self.coordinates
        x = c.nominal
        x[c.base] = self.prior.mean[c.base]
        if LOST in c.place and in_fit(c.columns, members)[c.place[LOST]]:
            x[c.place[LOST]] = poses.repeated(self.swims)
        return x

    def counted(self, members: Members) -> float:
        """Evidence of the count of repeated poses."""
        lost = any(one.name == LOST.partition(".")[0] for one in members)
        return poses.counted(self.swims, lost=lost) if LOST in self.coordinates.place else 0.0

    def coloured(self, fit: Fit) -> float:
        """Evidence of the colour of the poses' noise."""
        place = self.coordinates.place.get(FILTER)
        return 0.0 if place is None else poses.coloured(self.swims, float(fit.x[place]))

    def judged(self, members: Members, x: Array, rows: Array, near: Slope) -> tuple[float, Array]:
        """Loss at a point, and the step to where it is least by the slopes, shape (F,).

        The simulator's own error is as large as suits the point best: a fit should not bend to it.
        What else the fit does not move stays at 0: it should predict by what it has.
        """
        own = in_fit(self.coordinates.columns, members)
        free = own | self.wrong
        prior = self.precision(members)[np.ix_(free, free)]
        seen, slope, normal = self._part(rows, near)
        off = (x - self.centre(members))[free]
        gradient = slope[:, free].T @ seen + prior @ off
        curvature = normal[np.ix_(free, free)] + prior
        step = np.zeros(x.size)
        step[free] = bounded(curvature, gradient, self.coordinates.room(x)[:, free])
        step[self.wrong] = 0.0
        loss = 0.5 * float(seen @ seen) + 0.5 * float(off @ prior @ off)
        error = self.wrong[free]
        pull = gradient[error]
        told = float(pull @ np.linalg.solve(curvature[np.ix_(error, error)], pull))
        return loss - 0.5 * told, step

    def evidence(self, members: Members, fit: Fit) -> float:
        """Logarithm of the marginal likelihood, up to a constant of the swims.

        About the fit the swims are linear in all columns; those of other effects are there by as
        much as the twin's error imitates them.
        """
        loss, size, _ = self._whole(members, fit)
        sure = self.counted(members) + self.coloured(fit) - self.cost * len(members)
        return sure - loss - 0.5 * size

    def seems(self, members: Members, fit: Fit) -> Array:
        """The step of all columns to where they would be best, those of no effect among them."""
        return self._whole(members, fit)[2]

    def _whole(self, members: Members, fit: Fit) -> tuple[float, float, Array]:
        prior = self.precision(members)
        seen, slope, normal = self._part(fit.rows, fit.near)
        off = fit.x - self.centre(members)
        gradient = slope.T @ seen + prior @ off
        whole = normal + prior
        absent = ~in_fit(self.coordinates.columns, members)
        far = _AT_MOST * np.sqrt(np.diag(self.prior.covariance))
        room = np.where(absent, np.stack([-far, far]), self.coordinates.room(fit.x))
        step = bounded(whole, gradient, room)
        loss = 0.5 * float(seen @ seen) + 0.5 * float(off @ prior @ off)
        loss += float(gradient @ step) + 0.5 * float(step @ whole @ step)
        size = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(prior)[1]
        return loss, float(size), step

    def covariance(self, members: Members, near: Slope) -> Array:
        """Of all columns after the swim, shape (F, F)."""
        _, _, normal = self._part(None, near)
        return np.asarray(np.linalg.inv(normal + self.precision(members)))

    def _part(self, rows: Array | None, near: Slope) -> tuple[Array, Array, Array]:
        none = np.zeros(0)
        if self.kept is None:
            return (none if rows is None else rows), near.slope, near.normal
        slope = near.slope[self.kept]
        return (none if rows is None else rows[self.kept]), slope, slope.T @ slope

    def part(self, fit: Fit) -> tuple[Array, Array]:
        """Rows and slopes of a fit that it was fitted to."""
        rows, slope, _ = self._part(fit.rows, fit.near)
        return rows, slope

    # --- fits --------------------------------------------------------------------------------

    def plain(self, rounds: int = 3) -> Hypothesis[Fit]:
        """The hypothesis that nothing is missing."""
        none: Members = frozenset()
        x = self.centre(none)
        for number in range(rounds):
            begun = self.at(x)
            self.before = begun if number == 0 else self.before
            (found,) = self._walk([(none, begun)], 2)
            x = found.x
        return self._there(none, x)

    def _there(self, members: Members, x: Array, known: Slope | None = None) -> Hypothesis[Fit]:
        """A fit at a point, with slopes of its own."""
        rows, near = self.slope(x, known, members)
        fit = Fit(x, rows, self.judged(members, x, rows, near)[0], near, looked=True)
        return Hypothesis(members, fit, self.evidence(members, fit))

    def polished(self, members: Members, fit: Fit, known: Slope | None = None) -> Hypothesis[Fit]:
        """The fit with slopes of its own, and on along them."""
        begun = self._there(members, fit.x, known).fit
        (found,) = self._walk([(members, begun)], 2)
        return Hypothesis(members, found, self.evidence(members, found))

    def settled(self, found: Hypothesis[Fit], rounds: int = 2) -> Hypothesis[Fit]:
        """A hypothesis whose fit has slopes of its own, and stays where it is with them."""
        for _ in range(rounds):
            before = found.fit.loss
            found = self.polished(found.members, found.fit, found.fit.near)
            if abs(before - found.fit.loss) < _SETTLED:
                break
        return found

    def held(self, members: Members, fit: Fit, share: float) -> tuple[Fit, NDArray[np.bool_]]:
        """A fit of the first part of each swim, from one of all of it; which rows it left out."""
        first = [
            np.repeat(one.block < round((1 - share) * len(one.edges)), w.shape[1])
            for one, w in zip(self.blocks, self.weights, strict=True)
        ]
        self.kept = np.concatenate(first)
        try:
            (found,) = self._walk([(members, replace(fit, loss=np.inf))], _STEPS)
        finally:
            kept, self.kept = self.kept, None
        return found, ~kept

    def _walk(self, begun: Sequence[tuple[Members, Fit]], steps: int) -> list[Fit]:
        """Go on from fits along their slopes, all in one batch a step."""
        now = [fit for _, fit in begun]
        going = list(range(len(begun)))
        for _ in range(steps):
            if not going:
                break
            trials = []
            for k in going:
                members, fit = begun[k][0], now[k]
                _, step = self.judged(members, fit.x, fit.rows, fit.near)
                trials += [self.coordinates.clipped(fit.x + share * step) for share in _SHARES]
            rows = self.rows(np.array(trials))
            still = []
            for place, k in enumerate(going):
                members, before = begun[k][0], now[k]
                for n in range(len(_SHARES)):
                    i = place * len(_SHARES) + n
                    loss, _ = self.judged(members, trials[i], rows[i], before.near)
                    if loss < now[k].loss:
                        now[k] = Fit(trials[i], rows[i], loss, before.near)
                if now[k].loss < before.loss - 0.1:
                    still.append(k)
            going = still
        return now

    # --- what the search asks ----------------------------------------------------------------

    def look(self, places: Sequence[tuple[Ledger[Fit], Members]]) -> None:
        """Take the slopes of these sets' fits, and go on along them."""
        for ledger, members in places:
            known = ledger.tried[members]
            if not known.fit.looked:
                found = self.polished(members, known.fit)
                ledger.tried[members] = replace(found, fit=replace(found.fit, looked=True))

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Fit]]:
        """Effects that promise most beside a set, by its slopes."""
        fits = [ledger.tried[members].fit, *self._afresh(members)]
        found = []
        for effect in self.coordinates.effects:
            if effect not in members:
                more = members | {effect}
                hopes = [self.evidence(more, self.linear(more, fit)) for fit in fits]
                found.append((max(hopes), effect))
        found.sort(key=lambda one: -one[0])
        return [(effect, fits[0]) for _, effect in found[: most or FIRST]]

    def _afresh(self, members: Members) -> list[Fit]:
        """Where a fit may begin as well, if nothing is in it yet: at what was known before.

        A law that has bent to what is missing is no good start for what is.
        """
        return [] if members or self.before is None else [self.before]

    def linear(self, members: Members, fit: Fit) -> Fit:
        """Where a step along the slopes would end, cut to what is allowed."""
        _, step = self.judged(members, fit.x, fit.rows, fit.near)
        there = self.coordinates.clipped(fit.x + step)
        rows = fit.rows + fit.near.slope @ (there - fit.x)
        return Fit(there, rows, self.judged(members, there, rows, fit.near)[0], fit.near)

    def start(self, ledger: Ledger[Fit], members: Members) -> Fit:
        """The best fit that has one effect more, without it."""
        best = ledger.best
        keep = in_fit(self.coordinates.columns, members)
        x = np.where(keep, best.fit.x, self.coordinates.nominal)
        return replace(best.fit, x=x, rows=self.rows(x[None])[0])

    def refit(self, jobs: Sequence[tuple[Ledger[Fit], Members, Fit]]) -> list[Hypothesis[Fit]]:
        """Fit sets, each from a fit of a part of it, in one batch a step."""
        begun = []
        for _, members, fit in jobs:
            loss, _ = self.judged(members, fit.x, fit.rows, fit.near)
            begun.append((members, Fit(fit.x, fit.rows, loss, fit.near)))
        count = len(begun)
        for _, members, _ in jobs:
            if len(members) == 1:
                begun += [(members, fit) for fit in self._afresh(frozenset())]
        begun = jumped(self, begun)
        ended = self._walk(begun, _STEPS)
        best: dict[Members, Fit] = {}
        for (members, _), fit in zip(begun, ended, strict=True):
            known = best.get(members)
            best[members] = fit if known is None or fit.loss < known.loss else known
        return [
            Hypothesis(members, best[members], self.evidence(members, best[members]))
            for members, _ in begun[:count]
        ]

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether what was found is worth going on from."""
        return bool(ledger.best.members)


__all__ = ["SwimPrior", "Fit", "Slope", "TwinSwims"]
