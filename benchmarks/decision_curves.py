"""Curves that say how likely a finding is, from findings whose answers are known.

Each is logistic. Its weights have a normal prior about 0; spread, slope and offset are those that
foretell best what is said of plants left out whole: so an unknown servo is not promised more than
servos that the curve had not seen were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit

from sim2real.arrays import Array, Mask

SPREADS = (0.15, 0.3, 0.6, 1.2, 2.4)
FEWEST = 10
"""Findings that are there, and that are not, below which no curve is fitted."""


@dataclass(frozen=True)
class Sample:
    """A finding whose answer is known.

    Attributes:
        plant: What it was found on.
        case: In which case.
        features: What speaks for it.
        right: Whether it was so.
    """

    plant: str
    case: str
    features: dict[str, float]
    right: bool


@dataclass(frozen=True)
class Curve:
    """A fitted curve.

    Attributes:
        weights: By feature.
        predicted: Probability of each sample by the curve of the other plants, shape (N,).
        right: Whether it was so, shape (N,).
        spread: Of the prior.
    """

    weights: dict[str, float]
    predicted: Array
    right: Array
    spread: float

    def report(self) -> dict[str, Any]:
        """How it does on plants left out."""
        p, y = self.predicted, self.right
        place = np.minimum((p * 10).astype(int), 9)
        bins = [
            {"stated": float(p[place == k].mean()), "true": float(y[place == k].mean()),
             "of": int((place == k).sum())}
            for k in range(10) if (place == k).any()
        ]  # fmt: skip
        gaps = [b["of"] * abs(b["stated"] - b["true"]) for b in bins]
        sure = p >= 0.9
        return {
            "samples": int(y.size),
            "true": int(y.sum()),
            "spread": self.spread,
            "loss": loss(p, y),
            "left_out": bins,
            "calibration_error": float(sum(gaps) / y.size),
            "at_0.9": {"of": int(sure.sum()), "wrong": int((1 - y[sure]).sum())},
        }


def curve(samples: Sequence[Sample]) -> Curve | None:
    """The curve of some samples; None where they are too few."""
    y = np.array([one.right for one in samples], dtype=float)
    if min(y.sum(), (1 - y).sum()) < FEWEST:
        return None
    names = sorted({name for one in samples for name in one.features})
    names.sort(key=lambda name: name != "intercept")
    x = np.array([[one.features.get(name, 0.0) for name in names] for one in samples])
    folds = _folds(samples)
    tried = []
    for spread in SPREADS:
        odds = np.zeros(y.size)
        for out in folds:
            odds[out] = x[out] @ logistic(x[~out], y[~out], spread)
        tried.append((spread, *_straightened(odds, y)))
    spread, line, predicted = min(tried, key=lambda one: loss(one[2], y))
    w = logistic(x, y, spread) * line[1]
    w[0] += line[0]
    weights = {n: float(f"{value:.4g}") for n, value in zip(names, w, strict=True)}
    return Curve(weights, predicted, y, spread)


def _folds(samples: Sequence[Sample]) -> list[Mask]:
    """Plants, each left out whole; fifths of the cases where there is one plant."""
    of = [one.plant for one in samples]
    if len(set(of)) < 2:
        cases = sorted({one.case for one in samples})
        order = np.random.default_rng(0).permutation(cases)
        fifth = {str(case): str(k % 5) for k, case in enumerate(order)}
        of = [fifth[one.case] for one in samples]
    return [np.array([name == one for name in of]) for one in sorted(set(of))]


def _straightened(odds: Array, y: Array) -> tuple[Array, Array]:
    """Offset and slope of the log odds that predict best, shape (2,), and their predictions.

    Source: Platt, Probabilistic outputs for support vector machines, Advances in Large Margin
    Classifiers (MIT Press, 1999).
    """
    x = np.stack([np.ones_like(odds), np.clip(odds, -40.0, 40.0)], axis=1)
    line = np.array([0.0, 1.0])
    for _ in range(40):
        p = expit(x @ line)
        bend = (x * np.maximum(p * (1 - p), 1e-6)[:, None]).T @ x + np.diag([1e-3, 1.0])
        slope = x.T @ (y - p) - np.array([1e-3, 1.0]) * (line - np.array([0.0, 1.0]))
        step = np.linalg.solve(bend, slope)
        line = line + step
        if np.abs(step).max() < 1e-9:
            break
    return line, expit(x @ line)


def logistic(x: Array, y: Array, spread: float, about: Array | None = None) -> Array:
    """Weights of the likeliest curve with a normal prior; the first, of 1, is free (Newton).

    Args:
        x: What speaks for each finding, shape (N, K).
        y: Whether it was so, shape (N,).
        spread: Of the prior, over the scatter of each column.
        about: Weights that are its mean, as those of findings seen before, shape (K,).
    """
    scale = np.maximum(x.std(axis=0), 1e-3)
    scale[0] = 1.0
    z = x / scale
    prior = np.full(x.shape[1], spread**-2)
    prior[0] = 1e-4
    mean = np.zeros(x.shape[1]) if about is None else about * scale
    w = mean.copy()
    for _ in range(60):
        p = expit(z @ w)
        slope = z.T @ (y - p) - prior * (w - mean)
        bend = (z * np.maximum(p * (1 - p), 1e-6)[:, None]).T @ z + np.diag(prior)
        step = np.linalg.solve(bend, slope)
        w = w + step * min(1.0, 4.0 / max(float(np.abs(step).max()), 1e-9))
        if np.abs(step).max() < 1e-8:
            break
    return np.asarray(w / scale)


def loss(p: Array, y: Array) -> float:
    """Mean of minus the logarithm of the probability of what was so."""
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return float(-np.mean(y * np.log(p) + (1 - y) * np.log(1 - p)))


def least_sure(
    stated: Sequence[Array], correct: Sequence[Array], least: float = 0.9, right: float = 0.985
) -> float | None:
    """Probability from which so large a share of the findings is right; None where never.

    Args:
        stated: Probabilities of findings, by curve.
        correct: Whether they were right, likewise.
        least: Smallest probability that is tried.
        right: Share.
    """
    p, y = np.concatenate(stated), np.concatenate(correct)
    for level in np.arange(least, 0.985, 0.005):
        some = p >= level
        if some.any() and y[some].mean() >= right:
            return float(level)
    return None
