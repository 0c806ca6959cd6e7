"""Effects that mean nothing, in competition with the real ones: how often would chance win?

A decoy is what a real effect would do, at another time and turned round in random stretches. It is
as large, as smooth and as irregular as the real one, and nothing can be behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sim2real.diagnose.directions import Directions
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

COPIES = 100
"""Decoys of each effect: the least share of wrong names that can be seen is one in so many."""
_AWAY_S, _STRETCH_S, _TURN_S = 2.0, (1.5, 4.0), 0.25


@dataclass(frozen=True)
class Contest:
    """Gains in log-likelihood by real effects and by decoys, from the same fit.

    Attributes:
        real: Of every effect, its best start, shape (C,).
        decoys: Of the decoys of every effect, likewise, shape (COPIES, C).
    """

    real: Array
    decoys: Array

    def chance(self, effects: Sequence[int]) -> float:
        """Probability that a decoy does as well as the best of some effects: (b + 1) / (n + 1).

        Source: Phipson, Smyth, Statistical Applications in Genetics and Molecular Biology 9 (2010)
        article 39.
        """
        beaten = int((self.decoys >= self.real[list(effects)].max()).sum())
        return (beaten + 1) / (self.decoys.size + 1)


def false_discovery_rate(chances: Sequence[float], considered: int) -> float:
    """Expected share of wrong ones among the effects that were accepted.

    Of ``considered`` effects that mean nothing, ``considered * p`` would have done as well as the
    weakest accepted one, whose chance is ``p``; divided by the number accepted this is the share.
    Source: Storey, Journal of the Royal Statistical Society B 64 (2002) 479-498, equation 6, with
    none of the effects taken for real beforehand. 0 where nothing was accepted.

    Args:
        chances: For each accepted effect, the probability that a decoy does as well.
        considered: How many effects, of all joints, could have been accepted.
    """
    if not chances:
        return 0.0
    return min(1.0, considered * max(chances) / len(chances))


def contest(
    traces: Sequence[Trace],
    given: Directions,
    autoregression: Array,
    rng: np.random.Generator,
    copies: int = COPIES,
) -> Contest:
    """Let real effects and decoys compete for what a fit leaves, on the terms of ``screen``.

    Args:
        traces: The joint's recordings.
        given: A fit without the effect that is to be judged, and how effects would change it.
        autoregression: Noise model of the fit, shape (lags,).
        rng: For the decoys.
        copies: Decoys of each effect.
    """
    taps = np.concatenate([[1.0], -autoregression])
    counts = [counting(trace, autoregression.size) for trace in traces]

    def white(parts: Sequence[Array]) -> list[Array]:
        return [np.asarray(lfilter(taps, [1.0], part, axis=0)) for part in parts]

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
        decoy = [meaningless(x, trace.t, rng) for x, trace in zip(effects, traces, strict=True)]
        drawn.append(_gains(counted(decoy), taken, left, given.candidate))
    return Contest(real, np.array(drawn))


def meaningless(response: Array, t: Array, rng: np.random.Generator) -> Array:
    """What effects do (T, S), some seconds later and turned round in random stretches.

    The delay alone would not do: of a command that repeats itself, an effect does the same again.
    """
    step = float(np.median(np.diff(t)))
    away = max(1, min(round(_AWAY_S / step), t.size // 4))
    delay = int(rng.integers(away, max(t.size - away, away + 1)))
    cuts = t[0] + np.cumsum(rng.uniform(*_STRETCH_S, size=int((t[-1] - t[0]) / _STRETCH_S[0]) + 1))
    # It turns round where the end of the recording comes to meet its start, too: no jumps.
    cuts = np.sort(np.append(cuts, t[min(delay, t.size - 1)]))
    stretch = np.searchsorted(cuts, t)
    nearest = np.abs(t[:, None] - cuts[None]).min(axis=1)
    sign = rng.choice([-1.0, 1.0], size=cuts.size + 1)[stretch]
    weight = sign * np.minimum(1.0, nearest / _TURN_S)
    return np.asarray(np.roll(response, delay, axis=0) * weight[:, None])


def counting(trace: Trace, lags: int) -> NDArray[np.bool_]:
    """Samples that are used, as are the ``lags`` before them, shape (T,)."""
    missing = np.concatenate([np.zeros(lags + 1), np.cumsum(~trace.used)])
    whole = missing[lags + 1 :] == missing[: -lags - 1]
    whole[:lags] = False
    return np.asarray(whole)


def _gains(columns: Array, taken: Array, left: Array, candidate: NDArray[np.intp]) -> Array:
    """Gain in log-likelihood of each candidate's best start, their strength free but not its sign.

    See ``Screen.gain``; ``columns`` (N, S), ``taken`` orthonormal (N, F), ``left`` (N,).
    """
    cross = taken.T @ columns
    norm2 = np.einsum("ns,ns->s", columns, columns)
    seen2 = norm2 - np.einsum("fs,fs->s", cross, cross)
    along = np.maximum(-(left @ columns), 0.0)
    share = np.where(
        seen2 > 1e-6 * norm2 + 1e-30, along**2 / np.maximum(seen2, 1e-300) / (left @ left), 0.0
    )
    gain = -0.5 * left.size * np.log1p(-np.minimum(share, 1 - 1e-9))
    best = np.zeros(int(candidate.max()) + 1)
    np.maximum.at(best, candidate, gain)
    return best
