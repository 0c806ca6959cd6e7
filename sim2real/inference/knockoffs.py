"""Knockoffs: effects that mean nothing, in competition with the real ones.

A knockoff is what a real effect would do, at another time and turned round in random segments. It
is as large, as smooth and as irregular as the real one, and nothing can be behind it: how often one
does as well is how often chance would win (the idea of Barber, Candès, Annals of Statistics 43
(2015) 2055-2085).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.noise import counting, whitened

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COPIES = 100
"""Knockoffs of each effect: the least share of wrong names that can be seen is one in so many."""
_AWAY_S, _SEGMENT_S, _TURN_S = 2.0, (1.5, 4.0), 0.25


@dataclass(frozen=True)
class Directions:
    """A fit, and what it could be changed by, recording by recording.

    Attributes:
        t: Times in s, shape (T,) each.
        used: Samples that may be seen, shape (T,) each.
        residual: What it leaves, 0 where nothing was measured, shape (T,) each.
        taken: What its free parameters would change, a unit of each, (T, F) each.
        effects: What the starts of all candidates would change, (T, S) each.
        candidate: Index of each start's candidate, shape (S,).
    """

    t: tuple[Array, ...]
    used: tuple[Mask, ...]
    residual: tuple[Array, ...]
    taken: tuple[Array, ...]
    effects: tuple[Array, ...]
    candidate: NDArray[np.intp]


@dataclass(frozen=True)
class Contest:
    """Gains in log-likelihood by real effects and by knockoffs, from the same fit.

    Attributes:
        real: Of every effect, its best start, shape (C,).
        knockoffs: Of the knockoffs of every effect, likewise, shape (COPIES, C).
    """

    real: Array
    knockoffs: Array

    def chance(self, effects: Sequence[int]) -> float:
        """Probability that a knockoff does as well as the best of some effects: (b + 1) / (n + 1).

        Source: Phipson, Smyth, Statistical Applications in Genetics and Molecular Biology 9 (2010)
        article 39.
        """
        beaten = int((self.knockoffs >= self.real[list(effects)].max()).sum())
        return (beaten + 1) / (self.knockoffs.size + 1)


def false_discovery_rate(chances: Sequence[float], considered: int) -> float:
    """Expected share of wrong ones among the effects that were accepted.

    Of ``considered`` effects that mean nothing, ``considered * p`` would have done as well as the
    weakest accepted one, whose chance is ``p``; divided by the number accepted this is the share.
    Source: Storey, Journal of the Royal Statistical Society B 64 (2002) 479-498, equation 6, with
    none of the effects taken for real beforehand. 0 where nothing was accepted.

    Args:
        chances: For each accepted effect, the probability that a knockoff does as well.
        considered: How many effects, of all joints, could have been accepted.
    """
    if not chances:
        return 0.0
    return min(1.0, considered * max(chances) / len(chances))


def contest(
    given: Directions,
    autoregression: Array,
    rng: np.random.Generator,
    copies: int = COPIES,
) -> Contest:
    """Let real effects and knockoffs compete for what a fit leaves, from the same fit.

    Args:
        given: A fit without the effect that is to be judged, and how effects would change it.
        autoregression: Noise model of the fit, shape (lags,).
        rng: For the knockoffs.
        copies: Knockoffs of each effect.
    """
    counts = [counting(used, autoregression.size) for used in given.used]

    def white(parts: Sequence[Array]) -> list[Array]:
        return [whitened(part, autoregression, axis=0) for part in parts]

    def counted(parts: Sequence[Array]) -> Array:
        return np.concatenate([part[c] for part, c in zip(parts, counts, strict=True)])

    # A delay and a slow change of sign pass the noise model: whitening once is enough.
    effects = white(given.effects)
    taken, _ = np.linalg.qr(counted(white(given.taken)))
    left = counted(white(given.residual))
    left = left - taken @ (taken.T @ left)
    real = _gains(counted(effects), taken, left, given.candidate)
    drawn = []
    for _ in range(copies):
        knockoff = [meaningless(x, at, rng) for x, at in zip(effects, given.t, strict=True)]
        drawn.append(_gains(counted(knockoff), taken, left, given.candidate))
    return Contest(real, np.array(drawn))


def meaningless(response: Array, t: Array, rng: np.random.Generator) -> Array:
    """What effects do (T, S), some seconds later and turned round in random segments.

    The delay alone would not do: of a command that repeats itself, an effect does the same again.
    """
    step = float(np.median(np.diff(t)))
    away = max(1, min(round(_AWAY_S / step), t.size // 4))
    delay = int(rng.integers(away, max(t.size - away, away + 1)))
    cuts = t[0] + np.cumsum(rng.uniform(*_SEGMENT_S, size=int((t[-1] - t[0]) / _SEGMENT_S[0]) + 1))
    # It turns round where the end of the recording comes to meet its start, too: no jumps.
    cuts = np.sort(np.append(cuts, t[min(delay, t.size - 1)]))
    segment = np.searchsorted(cuts, t)
    nearest = np.abs(t[:, None] - cuts[None]).min(axis=1)
    sign = rng.choice([-1.0, 1.0], size=cuts.size + 1)[segment]
    weight = sign * np.minimum(1.0, nearest / _TURN_S)
    return np.asarray(np.roll(response, delay, axis=0) * weight[:, None])


def _gains(columns: Array, taken: Array, left: Array, candidate: NDArray[np.intp]) -> Array:
    """Gain in log-likelihood of each candidate's best start, their strength free but not its sign.

    ``columns`` (N, S), ``taken`` orthonormal (N, F), ``left`` (N,).
    """
    share = drop(columns, taken, np.maximum(-(left @ columns), 0.0)) / (left @ left)
    gain = -0.5 * left.size * np.log1p(-np.minimum(share, 1 - 1e-9))
    best = np.zeros(int(candidate.max()) + 1)
    np.maximum.at(best, candidate, gain)
    return best


def drop(columns: Array, taken: Array, along: Array) -> Array:
    """How far each column lowers a sum of squares beside what is taken, shape (S,)."""
    cross = taken.T @ columns
    norm2 = np.einsum("ns,ns->s", columns, columns)
    seen2 = norm2 - np.einsum("fs,fs->s", cross, cross)
    there = seen2 > 1e-6 * norm2 + 1e-30
    return np.where(there, along**2 / np.maximum(seen2, 1e-300), 0.0)
