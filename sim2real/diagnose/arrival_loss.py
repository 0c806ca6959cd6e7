"""Packet loss in what a plain fit leaves: which set-points are lost, and its log-likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import expit, xlogy

from sim2real.diagnose.arrival_banded import Normal, normals
from sim2real.diagnose.arrival_noise import Heard, Noise, ratio_of, regress, whiten
from sim2real.diagnose.arrival_response import spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

START = 0.02
"""Probability with which the search starts."""
LIMITS = (1e-4, 0.5)
"""Smallest and largest probability."""
ROUNDS = 3
_INNER = 4
_SWEEPS = 60
_RUN = 3
_TAIL = 3
_PATTERNS = np.array([[b >> i & 1 for i in range(_RUN)] for b in range(2**_RUN)], dtype=bool)
"""What may happen to so many set-points in a row, shape (8, 3)."""
VERBOSE = False


@dataclass(frozen=True)
class Loss:
    """What lost set-points would explain.

    Attributes:
        gain: Gain in log-likelihood in nats, which set-points are lost paid for.
        probability: That a set-point is lost.
        sd: Standard deviation of the estimate; infinite where no loss would be seen.
        lost: For each joint and recording the set-points more likely lost than not.
        explained: For each joint and recording the part of the residual, simulated minus measured
            angle, in rad, that it explains (posterior mean), shape (T,).
    """

    gain: float
    probability: float
    sd: float
    lost: tuple[tuple[NDArray[np.intp], ...], ...]
    explained: tuple[tuple[Array, ...], ...]


@dataclass(frozen=True)
class _Sight:
    """One joint, ready for the likelihood of any set of lost set-points.

    Attributes:
        heard: The joint.
        noise: Noise under which it is looked at.
        normal: Normal equations of ``Response.missing``.
        change: Set-points minus those before them in rad, shape (K,).
    """

    heard: Heard
    noise: Noise
    normal: Normal
    change: Array

    def below(self, lost: Mask) -> Array:
        """How far the set-points in force are below those sent, in rad, shape (K,)."""
        out = np.zeros(lost.size)
        for k in np.flatnonzero(lost):
            out[k] = out[k - 1] + self.change[k]
        return out

    def fitted(self, below: Array, spare: float = 0.0) -> tuple[Noise, float]:
        """The noise with variance and ``refit`` at their best, and the log-likelihood.

        Args:
            below: See above.
            spare: To be added to the weighted sum of squared innovations, in rad2.
        """
        square, along = self.normal.square.copy(), self.normal.cross.T @ below
        square[0, 0] += below @ self.normal.times(below) - 2 * along[0] + spare
        square[0, 1:] -= along[1:]
        square[1:, 0] -= along[1:]
        refit, error2 = regress(square)
        variance = error2 / self.heard.counts[0]
        value = self.heard.loglikelihood(error2, self.noise.ratio)
        return replace(self.noise, variance=variance, refit=refit), value

    def change_in_fit(self, lost: Mask) -> Array:
        """Gain in log-likelihood if, from each set-point on, each of ``_PATTERNS`` happened.

        Args:
            lost: What happens now, shape (K,).

        Returns:
            Gains in nats, shape (8, K).
        """
        K, N = lost.size, _RUN + _TAIL
        below = self.below(lost)
        left = self.normal.cross @ np.concatenate([[1.0], -self.noise.refit])
        left -= self.normal.times(below)
        before = np.concatenate([[0.0], below[:-1]])
        lost, below, change, left = (
            np.concatenate([x, np.zeros(N, x.dtype)]) for x in (lost, below, self.change, left)
        )
        gram = np.pad(self.normal.gram[:N], ((0, max(N - len(self.normal.gram), 0)), (0, N)))
        step, now = [], np.broadcast_to(before, (len(_PATTERNS), K))
        for i in range(N):
            gone = _PATTERNS[:, i : i + 1] if i < _RUN else lost[i : i + K]
            now = np.where(gone, change[i : i + K] + now, 0.0)
            step.append(now - below[i : i + K])
        gain = np.zeros((len(_PATTERNS), K))
        for i in range(N):
            slope = left[i : i + K] - 0.5 * gram[0, i : i + K] * step[i]
            for j in range(i + 1, N):
                slope -= gram[j - i, i : i + K] * step[j]
            gain += slope * step[i]
        return gain / self.noise.variance

    def moments(self, share: Array) -> tuple[Array, float]:
        """Mean of ``below`` (K,), and the weighted square of its scatter's response in rad2.

        Args:
            share: Probability that each set-point is lost, independently, shape (K,).
        """
        mean, square, m, s = [], [], 0.0, 0.0
        for q, change in zip(share.tolist(), self.change.tolist(), strict=True):
            s = q * (change * change + 2 * change * m + s)
            m = q * (change + m)
            mean.append(m)
            square.append(s)
        covariance = np.array(square) - np.array(mean) ** 2
        scatter = float(self.normal.gram[0] @ covariance)
        for d in range(1, min(_RUN + _TAIL, len(self.normal.gram), share.size)):
            covariance = covariance[:-1] * share[d:]
            scatter += 2 * float(self.normal.gram[d, : share.size - d] @ covariance)
        return np.array(mean), scatter


@dataclass(frozen=True)
class _Link:
    """Joints that lose the same set-points.

    Attributes:
        sights: The joints.
        lost: Which set-points are lost, shape (K,).
        first: First set-points of recordings, in force from the start, shape (K,).
    """

    sights: tuple[_Sight, ...]
    lost: Mask
    first: Mask

    def improved(self, log_odds: float) -> _Link:
        """The likeliest losses that can be reached in steps of up to three in a row."""
        lost = self.lost.copy()
        for _ in range(_SWEEPS):
            gain = self._gain(lost, log_odds)
            pattern = gain.argmax(axis=0)
            best = gain.max(axis=0)
            # So far apart that one does not change what another is worth.
            reach = max(len(sight.normal.gram) for sight in self.sights) + _RUN + _TAIL
            chosen = (best > 1e-6) & (best >= maximum_filter1d(best, 2 * reach + 1))
            if not chosen.any():
                break
            if VERBOSE:
                tot0 = self.total(lost, log_odds)
            for k in np.flatnonzero(chosen):
                lost[k : k + _RUN] = _PATTERNS[pattern[k], : lost.size - k]
            if VERBOSE:
                tot = self.total(lost, log_odds)
                if tot - tot0 - best[chosen].sum() < -0.01 * abs(tot - tot0):
                    print("   promise", best[chosen].sum(), "got", tot - tot0)
        return replace(self, lost=lost)

    def total(self, lost, log_odds):
        t = log_odds * lost.sum()
        for s in self.sights:
            b = s.below(lost)
            sq = s.normal.square
            x = np.concatenate([[1.0], -s.noise.refit])
            t -= (
                0.5
                * (x @ sq @ x - 2 * b @ (s.normal.cross @ x) + b @ s.normal.times(b))
                / s.noise.variance
            )
        return t

    def _gain(self, lost: Mask, log_odds: float) -> Array:
        """Gain of each pattern at each set-point, paid for, shape (8, K)."""
        now = sum(_ahead(lost, i).astype(int) for i in range(_RUN))
        gain = log_odds * (_PATTERNS.sum(axis=1)[:, None] - now)
        for sight in self.sights:
            gain = gain + sight.change_in_fit(lost)
        never = [_ahead(self.first, i, beyond=True) for i in range(_RUN)]
        forbidden = sum(p[:, None] & ahead for p, ahead in zip(_PATTERNS.T, never, strict=True))
        return np.where(forbidden, -np.inf, gain)

    def evidence(self) -> Array:
        """Log-likelihood ratio of loss and arrival of each set-point, the others given, (K,)."""
        every = self._gain(self.lost, 0.0)
        weight = 2 ** np.arange(1, _RUN)
        rest = sum(w * _ahead(self.lost, i) for i, w in enumerate(weight, start=1))
        other = every[rest + ~self.lost, np.arange(self.lost.size)]
        return np.where(self.lost, -other, other)


def _ahead(mask: Mask, i: int, beyond: bool = False) -> Mask:
    """The mask ``i`` set-points further on, shape (K,)."""
    return np.concatenate([mask[i:], np.full(min(i, mask.size), beyond)])


def packet_loss(joints: Sequence[Heard], *, broadcast: bool = False) -> Loss:
    """Find the set-points that one link lost.

    The likeliest set of losses, each charged with log((1 - p) / p), is searched best first. Around
    it every set-point is given its own probability of being lost, which makes a lower bound of the
    marginal likelihood (Jordan, Ghahramani, Jaakkola, Saul, Machine Learning 37 (1999) 183-233):
    expected log-likelihood, less the divergence from independent losses of probability p. So the
    choice is paid for, and no gain is claimed that is not there.

    Args:
        joints: The joints on the link.
        broadcast: Whether the set-points of all joints are lost together. They must then have
            the same recordings.

    Raises:
        ValueError: If joints of a broadcast have different numbers of set-points.
    """
    groups = [list(range(len(joints)))] if broadcast else [[j] for j in range(len(joints))]
    noises = [heard.noise for heard in joints]
    lost: list[Mask | None] = [None] * len(groups)
    p, least, best = START, -np.inf, None
    for _ in range(ROUNDS):
        links = [
            _link([joints[j] for j in g], [noises[j] for j in g], z)
            for g, z in zip(groups, lost, strict=True)
        ]
        least = max(least, sum(s.heard.alone(s.noise) for x in links for s in x.sights))
        links, p = _search(links, p)
        lost = [link.lost for link in links]
        if not any(z.any() for z in lost):
            break
        found = _bound(links, p)
        if VERBOSE:
            print(
                "gain",
                found[0] - least,
                "p",
                found[1],
                [z.sum() for z in lost],
                [(s.noise.ratio, s.noise.variance**0.5 * 1e3) for x in links for s in x.sights],
            )
        if best is None or found[0] > best[0]:
            best = found
        p = found[1]
        flat = [(s, share) for x, share in zip(links, found[2]) for s in x.sights]
        for g, pairs in zip(
            groups, [[(s, share) for s in x.sights] for x, share in zip(links, found[2])]
        ):
            for j, (s, share) in zip(g, pairs):
                noises[j] = _renewed(s, share)
    if best is None or best[0] <= least:
        return 0.0, 0.0, []
    return best[0] - least, best[1], [np.flatnonzero(q > 0.5) for q in best[2]]


def _link(joints: Sequence[Heard], noises: Sequence[Noise], lost: Mask | None) -> _Link:
    sights = tuple(_sight(*pair) for pair in zip(joints, noises, strict=True))
    sizes = {tuple(s.residual.size for s in heard.stretches) for heard in joints}
    if len(sizes) > 1:
        raise ValueError(f"joints of a broadcast have {sorted(sizes)} set-points")
    first = np.zeros(sights[0].change.size, dtype=bool)
    first[np.cumsum([0, *sizes.pop()])[:-1]] = True
    return _Link(sights, np.zeros_like(first) if lost is None else lost, first)


def _sight(heard: Heard, noise: Noise) -> _Sight:
    tables = [s.response.missing for s in heard.stretches]
    moving, rest = normals(heard.stretches, tables, noise.autoregression)
    change = np.concatenate([s.response.change for s in heard.stretches])
    return _Sight(heard, noise, moving.plus(rest, noise.ratio**-2), change)


def _search(links: list[_Link], p: float) -> tuple[list[_Link], float]:
    """Improve losses, noises and probability in turn."""
    for _ in range(_INNER):
        before = [link.lost for link in links]
        links = [link.improved(float(np.log(p / (1 - p)))) for link in links]
        links = [
            replace(
                x, sights=tuple(replace(s, noise=s.fitted(s.below(x.lost))[0]) for s in x.sights)
            )
            for x in links
        ]
        p = _probability([x.evidence()[~x.first] for x in links], p)
        if all((a == x.lost).all() for a, x in zip(before, links, strict=True)):
            break
    return links, p


def _probability(evidence: Sequence[Array], p: float) -> float:
    """Likeliest probability, given the log-likelihood ratios of all set-points."""
    every = np.concatenate(evidence)
    for _ in range(20):
        p = float(np.clip(expit(every + np.log(p / (1 - p))).mean(), *LIMITS))
    return p


def _bound(links: Sequence[_Link], p: float) -> tuple[float, float, list[Array]]:
    """Lower bound of the log-likelihood, the probability, and shares"""
    best = (-np.inf, p, [])
    for soft in (True, False):
        total, shares = 0.0, []
        for link in links:
            share = expit(link.evidence() + np.log(p / (1 - p))) if soft else link.lost * 1.0
            share[link.first] = 0
            shares.append(share)
            free = share[~link.first]
            total -= float(np.sum(xlogy(free, free / p) + xlogy(1 - free, (1 - free) / (1 - p))))
            for s in link.sights:
                total += s.fitted(*s.moments(share))[1]
        if VERBOSE:
            print("   soft" if soft else "   hard", total)
        if total > best[0]:
            best = (total, p, shares)
    return best


def _renewed(sight: _Sight, share: Array) -> Noise:
    mean, spare = sight.moments(share)
    noise, _ = sight.fitted(mean, spare)
    series, start = [], 0
    for s in sight.heard.stretches:
        part = mean[start : start + s.residual.size]
        start += s.residual.size
        series.append(
            s.left(noise.refit) - spread(s.response.missing * part[:, None], s.response.first)
        )
    noise = sight.heard.refitted(noise, [[x] for x in series])
    e = [whiten(x, noise.autoregression) for x in series]
    return replace(noise, ratio=ratio_of(sight.heard, e))
