"""Statistics of trials: predictive distributions, and differences of agents paired by seed.

A figure differs between N realities (variance B) and between T trials in one (variance W), as in
a one-way layout with random effects (Searle, Casella and McCulloch, Variance Components, 1992,
ch. 3). More trials average W away and not B.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta, norm, rankdata
from scipy.stats import t as student

from sim2real.arrays import Array


def between_within(values: Array) -> tuple[float, float]:
    """Variance between realities and mean variance within one, of a figure (N, T)."""
    T = values.shape[1]
    within = float(values.var(axis=1, ddof=1).mean()) if T > 1 else 0.0
    return max(float(values.mean(axis=1).var(ddof=1)) - within / T, 0.0), within


def normal_scores(values: Array) -> Array:
    """Normal scores of the ranks of all trials, shape (N, T): no trial outweighs all others."""
    return np.asarray(norm.ppf((rankdata(values).reshape(values.shape) - 0.5) / values.size))


def reliability(values: Array) -> float:
    """Share of the variance of the means of T trials that is between realities, 0 to 1.

    That of normal scores (Saltelli and Sobol, Reliab. Eng. Syst. Saf. 50 (1995) 225, of ranks), as
    one failure in hundreds of trials would be most of the variance within realities.
    """
    between, within = between_within(normal_scores(values))
    return float(between / max(between + within / values.shape[1], 1e-12))


def expected(values: Array) -> Array:
    """The mean of all trials that each draw would have, shape (N,).

    The means of T trials are drawn towards their mean until the chance of single trials is gone
    from their variance. Values of 0 and 1 have a beta distribution between realities, in the order
    of their shares of ones.
    """
    shares, (N, T) = values.mean(axis=1), values.shape
    if not _binary(values):
        return np.asarray(shares.mean() + np.sqrt(reliability(values)) * (shares - shares.mean()))
    mean = (values.sum() + 0.5) / (N * T + 1)
    common = min(between_within(values)[0] / (mean * (1 - mean)), 0.99)
    # without a common cause in sight a tenth of the variance is between realities; where ones or
    # zeros are rare the posterior by Jeffreys's prior is the widest distribution (Brown, Cai and
    # DasGupta, Stat. Sci. 16 (2001) 101), whose interval contains its mean
    size = 1 / common - 1 if common > 0.1 else max(1 / 0.1 - 1, 0.5 / min(mean, 1 - mean))
    out = np.empty(N)
    levels = (np.arange(N) + 0.5) / N
    out[np.argsort(shares, kind="stable")] = beta.ppf(levels, mean * size, (1 - mean) * size)
    return out


def _binary(values: Array) -> bool:
    return bool(np.isin(values, (0.0, 1.0)).all())


def means(values: Array, trials: float = np.inf) -> Array:
    """Draws of the mean of that many trials in one reality, within the figure's range, (N, M)."""
    centre = expected(values)[:, None]
    if _binary(values):
        if not np.isfinite(trials):
            return centre
        chance = np.broadcast_to(centre, (len(centre), 32))  # so many that quantiles are smooth
        return np.random.default_rng(0).binomial(int(trials), chance) / trials
    T = values.shape[1]
    if np.isfinite(trials) and T > 1:
        own = np.sqrt(T / (T - 1)) * (values - values.mean(axis=1, keepdims=True))
        centre = centre + own / np.sqrt(trials)
    return np.asarray(np.clip(centre, values.min(), values.max()))


def quantiles(values: Array, weights: Array, levels: Array) -> Array:
    """Quantiles of draws (N, M) with weights (N,), linear between the draws, shape (levels,)."""
    flat = values.ravel()
    order = np.argsort(flat)
    mass = np.repeat(weights / values.shape[1], values.shape[1])[order]
    return np.interp(levels, np.cumsum(mass) - mass / 2, flat[order])


def interval(values: Array, weights: Array, trials: float = np.inf) -> tuple[float, float, float]:
    """Mean and central 90 % interval of the mean of trials; ``weights`` (N,) have sum 1.

    It contains the mean and the interval of the mean of very many trials.
    """
    mean, levels = float(weights @ expected(values)), np.array([0.05, 0.95])
    ends = [quantiles(means(values, n), weights, levels) for n in {trials, np.inf}]
    return (
        mean,
        min(mean, *(float(low) for low, _ in ends)),
        max(mean, *(float(x[1]) for x in ends)),
    )


def best(scores: Array, weights: Array) -> Array:
    """Probability of each of K policies of the largest mean score (K, N, T), shape (K,)."""
    drawn = np.stack([expected(one) for one in scores])
    winner = np.asarray(drawn == drawn.max(axis=0))
    return np.asarray((winner / winner.sum(axis=0)) @ weights)


def effective(weights: Array) -> float:
    """Effective number of draws (Kong, Liu and Wong, J. Am. Stat. Assoc. 89 (1994) 278)."""
    return float(weights.sum() ** 2 / (weights @ weights))


OUTCOME = "return"
"""Compared quantity: the rewards of a turn discounted as in training, which agents maximise. The
undiscounted sum does not penalise time and favours slow turns."""


@dataclass(frozen=True)
class Difference:
    """Return with all techniques minus that of an arm, over pairs of agents with the same seed.

    The 90 % interval is Student's, infinite for one pair, for which ``sd``, over the pairs, is NaN.
    """

    mean: float
    low: float
    high: float
    sd: float
    pairs: int

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def paired(first: Array, second: Array) -> Difference:
    """Difference of two arms, given the mean of each agent over the same trials, shape (S,)."""
    d = first - second
    S, mean = len(d), float(d.mean())
    sd = float(d.std(ddof=1)) if S > 1 else np.nan
    margin = float(student.ppf(0.95, S - 1)) * sd / S**0.5 if S > 1 else np.inf
    return Difference(mean, mean - margin, mean + margin, sd, S)


def differences(results: Mapping[str, Any], figure: str = OUTCOME) -> dict[str, Difference]:
    """Differences in reality of "full" and each other arm in the result of ``ablate``, by arm."""
    table: dict[str, dict[int, float]] = {}
    for agent in results["agents"]:
        mean = float(np.mean(agent["reality"][figure]))
        table.setdefault(agent["arm"], {})[agent["seed"]] = mean
    reference = table.pop("full", {})
    out = {}
    for arm, outcomes in table.items():
        pairs = np.array([(x, outcomes[seed]) for seed, x in reference.items() if seed in outcomes])
        if pairs.size:
            out[arm] = paired(*pairs.T)
    return out


def seeds_needed(losses: Mapping[str, Difference]) -> dict[str, int | None]:
    """Pairs for an interval a third as wide as the largest difference, by arm; None above 200."""
    largest = max((abs(loss.mean) for loss in losses.values()), default=0.0)
    pairs = np.arange(2, 201)
    widths = 2 * student.ppf(0.95, pairs - 1) / np.sqrt(pairs)  # for a spread of 1
    enough = {arm: pairs[widths * loss.sd <= largest / 3] for arm, loss in losses.items()}
    return {arm: int(S[0]) if S.size else None for arm, S in enough.items()}


def bootstrap(
    values: Sequence[Sequence[float]], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Mean and 90 % bootstrap interval of 4000: agents are resampled, then the repeats of each."""
    table = np.array(values, dtype=np.float64)
    A, R = table.shape
    agents = rng.integers(A, size=(4000, A))
    repeats = rng.integers(R, size=(4000, A, R))
    means = table[agents[:, :, None], repeats].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.05, 0.95])
    return float(table.mean()), float(low), float(high)
