"""Trials of the real robot: they sharpen a forecast, or contradict it.

Draws are weighted by the likelihood of what was observed (importance sampling: Gordon, Salmond and
Smith, IEE Proc. F 140 (1993) 107).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import softmax

from rl.experiments.statistics import effective, expected, normal_scores
from sim2real.arrays import Array
from sim2real.csv_columns import read_table
from sim2real.errors import InputError

OBSERVED = ("time_s", "energy", "reward")
"""Figures that trials are compared by; success is part of the time."""


@dataclass(frozen=True)
class Trials:
    """Values (n, F) of F observed figures in n trials of one policy, by its place in a forecast."""

    policy: int
    figures: tuple[str, ...]
    values: Array


@dataclass(frozen=True)
class Update:
    """Weights of the draws after a number of trials, shape (N,), with sum 1.

    ``effective`` is the effective number of draws, ``p_value`` the probability that the forecast
    gives to trials at least as far from its mean.
    """

    weights: Array
    effective: float
    p_value: float
    trials: int

    @property
    def contradicted(self) -> bool:
        """Whether the forecast hardly allows what was observed."""
        return self.p_value < 0.05


def read_trials(path: Path, policies: Sequence[str], limit_s: float) -> list[Trials]:
    """Read a CSV with a row for each trial: policy, success, and of time_s, energy, reward some.

    A trial without arrival (``success`` 0) counts with the full time of the task, ``limit_s``,
    whatever ``time_s`` says; its energy is that of the full time.

    Raises:
        InputError: If a column or a value is missing, or a policy is not of the forecast.
    """
    table = read_table(path)
    for column in ("policy", "success"):
        if column not in table:
            found = ", ".join(map(str, table.columns))
            raise InputError(path, "header", found, f"a column {column}")
    figures = tuple(name for name in OBSERVED if name in table)
    if not figures:
        raise InputError(path, "header", "no figure", f"one of {', '.join(OBSERVED)}")
    names = np.array([str(name) for name in table["policy"]])
    flags = np.array([str(flag).strip().lower() for flag in table["success"]])
    columns = {
        name: pd.to_numeric(table[name], errors="coerce").to_numpy(float) for name in figures
    }
    won = np.isin(flags, ("1", "1.0", "true"))
    if "time_s" in columns:
        columns["time_s"] = np.where(won, columns["time_s"], limit_s)
    checks = [
        ("policy", np.isin(names, policies), f"one of {', '.join(policies)}"),
        ("success", won | np.isin(flags, ("0", "0.0", "false")), "0 or 1"),
        *((name, np.isfinite(column), "a number") for name, column in columns.items()),
    ]
    for name, valid, wanted in checks:
        if not valid.all():
            row = int(np.argmin(valid))
            raise InputError(path, f"row {row + 2}, {name}", str(table[name][row]), wanted)
    values = np.stack(list(columns.values()), axis=1)
    return [
        Trials(k, figures, values[names == policy])
        for k, policy in enumerate(policies)
        if (names == policy).any()
    ]


def update(trials: Sequence[Trials], figures: Mapping[str, Array]) -> Update:
    """Weights of the draws after trials.

    Figures are compared by their normal scores, as a rare failure would be most of the scatter of
    all trials. The mean of a policy's n trials is normal about the mean of a draw, with the
    covariance of simulated trials in one reality, or their own scatter where that is larger, by
    1 / n. Where few draws agree, the likelihood is flattened until 20 of them count: intervals then
    are wider than they need be, and not too narrow by chance. Figures are those of the forecast,
    shape (K, N, T) each.
    """
    N = next(iter(figures.values())).shape[1]
    rng = np.random.default_rng(0)
    log, observed, predicted = np.zeros(N), 0.0, np.zeros(N)
    for one in trials:
        scores = [_scores(figures[name][one.policy], seen)
                  for name, seen in zip(one.figures, one.values.T, strict=True)]  # fmt: skip
        drawn, real = (np.stack(part, axis=-1) for part in zip(*scores, strict=True))
        N, T, F = drawn.shape
        mean = np.stack([expected(drawn[:, :, f]) for f in range(F)], axis=1)
        own = (drawn - drawn.mean(axis=1, keepdims=True)).reshape(-1, F)
        # figures whose trials hardly differ would decide alone: a hundredth of their spread is kept
        floor = np.diag(1e-4 * drawn.reshape(-1, F).var(axis=0) + 1e-12)
        n, noise = len(real), own.T @ own / max(N * (T - 1), 1)
        if n > 1:  # real trials may scatter more than simulated ones
            scatter = real.var(axis=0, ddof=1)
            more = np.sqrt(np.maximum(scatter / np.diag(noise + floor), 1.0))
            noise = noise * np.outer(more, more)
        noise = noise / n + floor
        off = real.mean(axis=0) - mean
        log -= 0.5 * _squares(off, noise)
        whole = np.cov(mean.T).reshape(F, F) + noise
        observed += float(_squares((off + mean)[:1] - mean.mean(axis=0), whole)[0])
        chance = rng.multivariate_normal(np.zeros(F), noise, size=N)
        predicted += _squares(mean + chance - mean.mean(axis=0), whole)
    p_value = float((1 + np.sum(predicted >= observed)) / (1 + N))
    return Update(*_flattened(log), p_value, sum(len(one.values) for one in trials))


def _scores(drawn: Array, seen: Array) -> tuple[Array, Array]:
    """Normal scores of a figure (N, T), and those of real trials (n,): linear beyond the draws."""
    scores, order = normal_scores(drawn), np.argsort(drawn, axis=None)
    known = drawn.ravel()[order]
    beyond = (seen - np.clip(seen, known[0], known[-1])) / max(float(known.std()), 1e-12)
    return scores, np.interp(seen, known, scores.ravel()[order]) + beyond


def _squares(off: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances of rows (N, F), shape (N,)."""
    return np.asarray(np.einsum("ni,in->n", off, np.linalg.solve(covariance, off.T)))


def _flattened(log: Array) -> tuple[Array, float]:
    """Weights, and their effective number, of log-likelihoods flattened as far as necessary."""
    low, high, least = 0.0, 1.0, min(20.0, len(log) / 2)
    weights = softmax(log)
    if effective(weights) < least:
        for _ in range(40):
            power = (low + high) / 2
            enough = effective(softmax(power * log)) > least
            low, high = (power, high) if enough else (low, power)
        weights = softmax(low * log)
    return weights, effective(weights)
