"""Noise that is correlated in time: usable samples, whitening, autocorrelation times.

A residual is whitened by an autoregression, e_k = x_k - a_1 x_(k-1) - ... - a_p x_(k-p), whose
coefficients are fitted to it. A sample counts where it and the p before it were measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Mask

_FIXED_B = (
    (0.80, 1.2816, 1.3040, 0.5135, -0.3386),
    (0.90, 1.6449, 2.1859, 0.3142, -0.3427),
    (0.95, 1.9600, 2.9694, 0.4160, -0.5324),
    (0.98, 2.3263, 4.1618, 0.5368, -0.9060),
)
"""Probability of an interval, and the coefficients of its critical value as a polynomial of b."""


@dataclass(frozen=True)
class Wander:
    """Ornstein-Uhlenbeck drift of a sensor with a ``share`` of the white noise's sd."""

    time_s: float
    share: float

    def least_gain(self, period_s: float) -> float:
        """Smallest gain at frequency 0 of a whitening filter, else constant errors were noise."""
        return float(np.sqrt(period_s / (2 * self.time_s)) / self.share)

    def filter(self, period_s: float) -> tuple[list[float], list[float], float]:
        """The steady-state Kalman filter that whitens it (Anderson and Moore (1979), ch. 4).

        Numerator and denominator for ``scipy.signal.lfilter``, and the variance of the predicted
        drift over that of the white part.
        """
        keep = float(np.exp(-period_s / self.time_s))
        drive = self.share**2 * (1 - keep**2)
        half = 0.5 * (drive - 1 + keep**2)
        spread = half + float(np.sqrt(half**2 + drive))
        gain = spread / (spread + 1)
        return [1.0, -keep], [1.0, -keep * (1 - gain)], spread


WANDER = Wander(4.0, 2.5)
"""Slowest and largest drift that the noise model of a servo's sensor includes."""
RESIDUAL_WANDER = Wander(3.0, 1.5)
"""Usual slow drift of sensors; a residual beyond it is structured."""


@dataclass(frozen=True)
class SlowErrors:
    """Ornstein-Uhlenbeck errors of a law beside white noise: of an angle, and of its time.

    Standard deviations and correlation times; the defaults are the medians of their prior.
    """

    noise_rad: float  # of the white noise of a joint at rest
    angle_rad: float = 3e-3
    delay_s: float = 3e-3
    angle_time_s: float = 1.0
    delay_time_s: float = 0.3

    def process(self, period_s: float) -> Array:
        """Variances of both, the white noise's being 1, and what a period leaves of them, (4,)."""
        sizes = np.array([self.angle_rad, self.delay_s]) / self.noise_rad
        times = np.array([self.angle_time_s, self.delay_time_s])
        return np.concatenate([sizes**2, np.exp(-period_s / times)])


def lags(period_s: float, *, memory_s: float = 0.5, fewest: int = 4, most: int = 25) -> int:
    """Number of coefficients of the autoregression for this time between samples."""
    return int(np.clip(round(memory_s / period_s), fewest, most))


def counting(used: Mask, order: int) -> Mask:
    """Mask of the samples that are used with all ``order`` before them, shape (T,)."""
    missing = np.cumsum(np.concatenate([np.zeros(order + 1), ~used]))
    whole = missing[order + 1 :] == missing[: -order - 1]
    whole[:order] = False
    return np.asarray(whole)


def lag_products(residual: Array, counts: Mask, order: int) -> Array:
    """Sums of products of a residual (T,) at two lags over samples that count: (p + 1, p + 1)."""
    before = np.lib.stride_tricks.sliding_window_view(residual, order + 1)
    lagged = before[counts[order:]][:, ::-1]
    return np.asarray(lagged.T @ lagged)


def autoregression(products: Array, least_gain: float = 0.0) -> Array:
    """Least-squares autoregressions (N, p) by lag products (N, p + 1, p + 1), with a least gain."""
    past, present = products[:, 1:, 1:].copy(), products[:, 1:, 0]
    size = np.einsum("nii->n", past) / past.shape[1]
    past += 1e-9 * (size + 1e-30)[:, None, None] * np.eye(past.shape[1])
    free, ones = np.moveaxis(
        np.linalg.solve(past, np.stack([present, np.ones_like(present)], axis=2)), 2, 0
    )
    excess = np.maximum(free.sum(axis=1) - (1 - least_gain), 0.0)
    return np.ascontiguousarray(free - (excess / ones.sum(axis=1))[:, None] * ones)


def whitened(values: Array, coefficients: Array, axis: int = -1) -> Array:
    """Innovations of ``values`` along an axis; values before the first are taken as 0."""
    series = np.moveaxis(values, axis, -1)
    innovations = series.copy()
    for lag, coefficient in enumerate(coefficients, start=1):
        innovations[..., lag:] -= coefficient * series[..., :-lag]
    return np.moveaxis(innovations, -1, axis)


def autocorrelation_times(series: Array) -> Array:
    """Integrated times in samples, (F,), of (T,) or (T, walkers, F): Goodman, Weare (2010)."""
    from emcee.autocorr import integrated_time  # type: ignore[import-untyped]

    with np.errstate(invalid="ignore", divide="ignore"):
        times = integrated_time(series, tol=0)
    return np.where(np.isfinite(times), np.maximum(times, 1.0), len(series))


def correlation_samples(error: Array) -> float:
    """Autocorrelation time of a residual of n samples, between 1 (white) and n / 4."""
    n = error.size
    if n < 8 or not np.ptp(error):
        return 1.0
    return float(np.clip(autocorrelation_times(error)[0], 1.0, n / 4))


def whiteness(errors: Sequence[Array]) -> float:
    """Lag-1 autocorrelation of residuals: 0 for white ones."""
    pairs = [(e[1:], e[:-1]) for e in errors if e.size > 2]
    power = sum(float(np.sum(e**2)) for e in errors)
    return sum(float(np.sum(a * b)) for a, b in pairs) / power if power > 0 else 0.0


def bandwidth(samples: int, time: float) -> int:
    """Lags of a long-run covariance: three correlation times, at most a quarter of the samples.

    At least 1.3 times the root of the samples (Lazarus, Lewis, Stock, Watson, Journal of Business
    and Economic Statistics 36 (2018) 541-559): fewer lags miss small slow errors, such as those of
    rounding while the joint is at rest; see ``fixed_b``.
    """
    least = 1.3 * samples**0.5
    return int(np.clip(np.ceil(max(3 * time, least)), 1, max(samples // 4, 1)))


def fixed_b(span: float, samples: float, level: float) -> float:
    """Factor by which an interval widens for the bias and uncertainty of ``long_run``.

    The critical value of a t-test whose lags are a share b of the samples, over that for b = 0:
    Kiefer and Vogelsang, Econometric Theory 21 (2005) 1130-1164, table 1, Bartlett weights;
    between the probabilities of the table interpolated, beyond them that of the nearest.
    """
    b = min(span / max(samples, 1.0), 1.0)
    factors = [1 + (c1 * b + c2 * b**2 + c3 * b**3) / c0 for _, c0, c1, c2, c3 in _FIXED_B]
    return float(np.interp(level, [row[0] for row in _FIXED_B], factors))


def long_run(score: Array, span: int) -> Array:
    """Sum of lagged products of ``score`` (n, F) with Bartlett weights 1 - k / span, shape (F, F).

    The mean square of sums over all windows: Newey and West, Econometrica 55 (1987) 703-708.
    """
    padded = np.zeros((score.shape[0] + 2 * span, score.shape[1]))
    padded[span:-span] = score
    sums = np.cumsum(padded, axis=0)
    windows = sums[span:] - sums[:-span]
    return np.asarray(windows.T @ windows / span)
