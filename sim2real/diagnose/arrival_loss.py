"""Packet loss in what a plain fit leaves: which set-points are lost, and its log-likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import expit, xlogy

from sim2real.diagnose.arrival_banded import Normal, normals
from sim2real.diagnose.arrival_noise import LEAST_SD_RAD, Heard, Noise, ratio_of, regress, whiten
from sim2real.diagnose.arrival_response import spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

START = 0.02
"""Probability with which the search starts."""
LIMITS = (1e-4, 0.5)
"""Smallest and largest probability."""
_ROUNDS, _INNER, _SWEEPS = 6, 4, 60
_WORTH = 0.3
"""Growth of the gain that ends the rounds."""
_GAIN = 1e-3
"""Gain for which a change is made."""
_VISIBLE = 3.0
"""Log-likelihood ratio by which an arrival shows."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution over the median of its size."""
_RUN = 3
"""Set-points in a row whose fates are weighed together."""
_TAIL = 3
"""Lost set-points after those that are followed up."""
_PATTERNS = np.array([[b >> i & 1 for i in range(_RUN)] for b in range(2**_RUN)], dtype=bool)
"""What may happen to them, shape (8, 3)."""


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
        noise = replace(self.noise, variance=self.heard.variance(error2), refit=refit)
        return noise, self.heard.loglikelihood(error2, noise.ratio)

    def change_in_fit(self, lost: Mask, at: NDArray[np.intp]) -> Array:
        """Gain in log-likelihood if, from some set-points on, each of ``_PATTERNS`` happened.

        Args:
            lost: What happens now, shape (K,).
            at: The set-points, shape (N,).

        Returns:
            Gains in nats, shape (8, N).
        """
        reach = _RUN + _TAIL
        below = self.below(lost)
        left = self.normal.cross @ np.concatenate([[1.0], -self.noise.refit])
        left -= self.normal.times(below)
        before = np.concatenate([[0.0], below])[at]
        ahead = at + np.arange(reach)[:, None]
        beyond = ahead >= lost.size
        ahead[beyond] = 0
        gone, under, change, slopes = (x[ahead] for x in (lost, below, self.change, left))
        gone[beyond] = False
        under[beyond] = 0.0
        gram = self.normal.gram[:reach, ahead]
        step, now = [], np.broadcast_to(before, (len(_PATTERNS), at.size))
        for i in range(reach):
            fate = _PATTERNS[:, i : i + 1] if i < _RUN else gone[i]
            now = np.where(fate, change[i] + now, 0.0)
            step.append(now - under[i])
        gain = np.zeros((len(_PATTERNS), at.size))
        for i in range(reach):
            slope = slopes[i] - 0.5 * gram[0, i] * step[i]
            for j in range(i + 1, min(reach, i + len(gram))):
                slope -= gram[j - i, i] * step[j]
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
        """The likeliest losses that can be reached by changing three in a row at a time."""
        lost = self.lost.copy()
        # So far apart that one change does not alter what another is worth.
        reach = max(len(sight.normal.gram) for sight in self.sights) + _RUN + _TAIL
        gain = self._gain(lost, log_odds, np.arange(lost.size))
        for _ in range(_SWEEPS):
            best = gain.max(axis=0)
            chosen = (best > _GAIN) & (best >= maximum_filter1d(best, 2 * reach + 1))
            if not chosen.any():
                break
            for k in np.flatnonzero(chosen):
                lost[k : k + _RUN] = _PATTERNS[gain[:, k].argmax(), : lost.size - k]
            near = np.flatnonzero(maximum_filter1d(chosen, 2 * reach + 1))
            gain[:, near] = self._gain(lost, log_odds, near)
        return replace(self, lost=lost)

    def refitted(self) -> _Link:
        """The same with the noise refitted to what the losses leave."""
        fits = [sight.fitted(sight.below(self.lost))[0] for sight in self.sights]
        pairs = zip(self.sights, fits, strict=True)
        return replace(self, sights=tuple(replace(sight, noise=noise) for sight, noise in pairs))

    def evidence(self) -> Array:
        """Log-likelihood ratio of loss and arrival of each set-point, the others given, (K,)."""
        every = self._gain(self.lost, 0.0, np.arange(self.lost.size))
        after = sum(2**i * _ahead(self.lost, i) for i in range(1, _RUN))
        other = every[after + ~self.lost, np.arange(self.lost.size)]
        return np.asarray(np.where(self.lost, -other, other))

    def shares(self, log_odds: float) -> Array:
        """Probability that each set-point is lost, the others given, shape (K,)."""
        return np.where(self.first, 0.0, expit(self.evidence() + log_odds))

    def bound(self, shares: Array, p: float) -> float:
        """Lower bound of the log-likelihood for independent losses of probability ``p``.

        Args:
            shares: Probability that each set-point is lost, anything, shape (K,).
            p: See above.
        """
        q = shares[~self.first]
        paid = float(np.sum(xlogy(q, q / p) + xlogy(1 - q, (1 - q) / (1 - p))))
        return sum(sight.fitted(*sight.moments(shares))[1] for sight in self.sights) - paid

    def _gain(self, lost: Mask, log_odds: float, at: NDArray[np.intp]) -> Array:
        """Gain of each pattern from each of the set-points ``at`` on, paid for, shape (8, N)."""
        now = np.stack([_ahead(lost, i)[at] for i in range(_RUN)]).sum(axis=0)
        gain = log_odds * (_PATTERNS.sum(axis=1)[:, None] - now)
        for sight in self.sights:
            gain = gain + sight.change_in_fit(lost, at)
        fixed = np.stack([_ahead(self.first, i, beyond=True)[at] for i in range(_RUN)])
        return np.where(_PATTERNS.astype(np.intp) @ fixed, -np.inf, gain)


def packet_loss(joints: Sequence[Heard], *, broadcast: bool = False) -> Loss:
    """Find the set-points that one link lost.

    The likeliest set of losses, each charged with log((1 - p) / p), is searched best first. Around
    it every set-point is given its own probability of being lost, which makes a lower bound of the
    marginal likelihood (Jordan, Ghahramani, Jaakkola, Saul, Machine Learning 37 (1999) 183-233):
    expected log-likelihood, less the divergence from independent losses of probability p. So the
    choice of the losses is paid for.

    Args:
        joints: The joints on the link.
        broadcast: Whether a set-point is lost for all joints at once. They must then have the same
            recordings.

    Raises:
        ValueError: If joints of a broadcast have different numbers of set-points.
    """
    groups = [list(joints)] if broadcast else [[heard] for heard in joints]
    noises = [[_typical(heard) for heard in group] for group in groups]
    links = [_link(*pair) for pair in zip(groups, noises, strict=True)]
    least = sum(heard.alone(heard.noise) for heard in joints)
    best, p, before = None, START, 0.0
    for _ in range(_ROUNDS):
        links, p = _search(links, p)
        if not any(link.lost.any() for link in links):
            break
        value, shares = _best_bound(links, p)
        noise = [s.noise for link in links for s in link.sights]
        least = max(least, sum(h.alone(x) for h, x in zip(_flat(groups), noise, strict=True)))
        if value - least > (best.gain if best else 0.0):
            best = _loss(links, shares, value - least, p)
        if before > 0 and value - least < max(before + _WORTH, 1.01 * before):
            break
        before = value - least
        noises = [
            [_renewed(s, share) for s in link.sights]
            for link, share in zip(links, shares, strict=True)
        ]
        links = [
            replace(
                _link([s.heard.moved(s.noise.refit) for s in link.sights], noise), lost=link.lost
            )
            for noise, link in zip(noises, links, strict=True)
        ]
    if best:
        return best
    none = [np.zeros(link.lost.size) for link in links]
    return replace(_loss(links, none, 0.0, LIMITS[0]), probability=0.0, sd=_limit(links))


def _typical(heard: Heard) -> Noise:
    """The noise with the variance of most samples, not of those that losses disturb."""
    noise = heard.noise
    sizes = [
        np.abs(whiten(s.left(noise.refit), noise.autoregression) * s.weight(noise.ratio))[s.counts]
        for s in heard.stretches
    ]
    median = float(np.median(np.concatenate(sizes)))
    return replace(noise, variance=max((_NORMAL * median) ** 2, LEAST_SD_RAD**2))


def _flat(groups: Sequence[Sequence[Heard]]) -> list[Heard]:
    return [heard for group in groups for heard in group]


def _ahead(mask: Mask, i: int, *, beyond: bool = False) -> Mask:
    """The mask ``i`` set-points further on, shape (K,)."""
    return np.concatenate([mask[i:], np.full(min(i, mask.size), beyond)])


def _link(joints: Sequence[Heard], noises: Sequence[Noise]) -> _Link:
    sizes = sorted({tuple(s.residual.size for s in heard.stretches) for heard in joints})
    if len(sizes) > 1:
        raise ValueError(f"joints of a broadcast have {sizes} set-points; expected the same")
    first = np.zeros(sum(sizes[0]), dtype=bool)
    first[np.cumsum([0, *sizes[0]])[:-1]] = True
    sights = tuple(_sight(*pair) for pair in zip(joints, noises, strict=True))
    return _Link(sights, np.zeros_like(first), first)


def _sight(heard: Heard, noise: Noise) -> _Sight:
    tables = [s.response.missing for s in heard.stretches]
    moving, rest = normals(heard.stretches, tables, noise.autoregression)
    change = np.concatenate([s.response.change for s in heard.stretches])
    return _Sight(heard, noise, moving.plus(rest, noise.ratio**-2), change)


def _search(links: list[_Link], p: float) -> tuple[list[_Link], float]:
    """Losses, noise and probability, improved in turn."""
    for _ in range(_INNER):
        before = [link.lost for link in links]
        links = [link.improved(float(np.log(p / (1 - p)))).refitted() for link in links]
        evidence = np.concatenate([link.evidence()[~link.first] for link in links])
        for _ in range(20):
            p = float(np.clip(expit(evidence + np.log(p / (1 - p))).mean(), *LIMITS))
        if all((old == link.lost).all() for old, link in zip(before, links, strict=True)):
            break
    return links, p


def _best_bound(links: Sequence[_Link], p: float) -> tuple[float, list[Array]]:
    """The better of two bounds, with losses that are sure or that are not, and their shares."""
    log_odds = float(np.log(p / (1 - p)))
    unsure = [link.shares(log_odds) for link in links]
    sure = [link.lost.astype(np.float64) for link in links]
    bounds = [
        sum(link.bound(share, p) for link, share in zip(links, shares, strict=True))
        for shares in (unsure, sure)
    ]
    return (bounds[0], unsure) if bounds[0] > bounds[1] else (bounds[1], sure)


def _renewed(sight: _Sight, shares: Array) -> Noise:
    """The noise refitted to what the mean of the losses leaves."""
    mean, scatter = sight.moments(shares)
    noise, _ = sight.fitted(mean, scatter)
    angles = _angles(sight, mean)
    pairs = list(zip(sight.heard.stretches, angles, strict=True))
    left = [s.left(noise.refit) - angle for s, angle in pairs]
    noise = sight.heard.refitted(noise, [[x] for x in left])
    innovations = [whiten(x, noise.autoregression) for x in left]
    return replace(noise, ratio=ratio_of(sight.heard, innovations))


def _angles(sight: _Sight, below: Array) -> tuple[Array, ...]:
    """Simulated minus measured angle by set-points ``below`` (K,) those sent, one a recording."""
    parts = sight.heard.by_recording(below)
    return tuple(
        spread(s.response.missing * part[:, None], s.response.first)
        for s, part in zip(sight.heard.stretches, parts, strict=True)
    )


def _loss(links: Sequence[_Link], shares: Sequence[Array], gain: float, p: float) -> Loss:
    """The finding; the standard deviation is from the observed information."""
    every = np.concatenate([x[~link.first] for link, x in zip(links, shares, strict=True)])
    information = float(np.sum((every / p - (1 - every) / (1 - p)) ** 2))
    sd = information**-0.5 if information > 0 else np.inf
    pairs = [(s, x) for link, x in zip(links, shares, strict=True) for s in link.sights]
    lost = [tuple(np.flatnonzero(x > 0.5) for x in s.heard.by_recording(x)) for s, x in pairs]
    explained = [_angles(s, s.moments(x)[0]) for s, x in pairs]
    return Loss(gain, p, sd, tuple(lost), tuple(explained))


def _limit(links: Sequence[_Link]) -> float:
    """One over the set-points that are seen to arrive; infinite if there are none."""
    seen = sum(int(np.sum(link.evidence()[~link.first] < -_VISIBLE)) for link in links)
    return 1 / seen if seen else np.inf
