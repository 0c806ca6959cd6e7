"""Trials of the real robot sharpen a forecast or contradict it; what else would sharpen it.

Draws are weighted by the likelihood of observations (importance sampling: Gordon, Salmond and
Smith, IEE Proc. F 140 (1993) 107).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import softmax

from rl.experiments.statistics import (
    effective,
    expected,
    interval,
    normal_scores,
    quantiles,
    reliability,
)
from rl.forecast.realities import DEVIATIONS
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
    """Weights of the draws after trials (N,), of sum 1, and a p-value."""

    weights: Array
    p_value: float
    trials: int

    @property
    def effective(self) -> float:
        """Effective number of the draws."""
        return effective(self.weights)

    @property
    def contradicted(self) -> bool:
        """Whether the forecast hardly allows what was observed."""
        return self.p_value < 0.05


def read_trials(path: Path, policies: Sequence[str], limit_s: float) -> list[Trials]:
    """Read a CSV with a row for each trial: policy, success, and of time_s, energy, reward some.

    Without arrival (``success`` 0) the full time of the task, ``limit_s``, and its energy count.
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
    for name, valid, wanted in (
        ("policy", np.isin(names, policies), f"one of {', '.join(policies)}"),
        ("success", won | np.isin(flags, ("0", "0.0", "false")), "0 or 1"),
        *((name, np.isfinite(column), "a number") for name, column in columns.items()),
    ):
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
    """Weights of the draws after trials, given the figures of the forecast, (K, N, T) each.

    Figures are compared by normal scores, linear beyond the draws, as a rare failure would be most
    of the scatter of all trials. The mean of a policy's n trials is normal about the mean of a
    draw, with the covariance of simulated trials in one reality, or their own scatter where that is
    larger, by 1 / n.
    """
    N = next(iter(figures.values())).shape[1]
    rng = np.random.default_rng(0)
    log, observed, predicted = np.zeros(N), 0.0, np.zeros(N)
    for one in trials:
        scores = []
        for name, seen in zip(one.figures, one.values.T, strict=True):
            values = figures[name][one.policy]
            drawn, order = normal_scores(values), np.argsort(values, axis=None)
            known = values.ravel()[order]
            beyond = (seen - np.clip(seen, known[0], known[-1])) / max(float(known.std()), 1e-12)
            scores.append((drawn, np.interp(seen, known, drawn.ravel()[order]) + beyond))
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
    return Update(_flattened(log), p_value, sum(len(one.values) for one in trials))


def _squares(off: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances of rows (N, F), shape (N,)."""
    return np.asarray(np.einsum("ni,in->n", off, np.linalg.solve(covariance, off.T)))


def _flattened(log: Array) -> Array:
    """Weights, flattened until 20 draws count, so as not to be too narrow."""
    low, high, least = 0.0, 1.0, min(20.0, len(log) / 2)
    if effective(softmax(log)) >= least:
        return np.asarray(softmax(log))
    for _ in range(40):
        power = (low + high) / 2
        enough = effective(softmax(power * log)) > least
        low, high = (power, high) if enough else (low, power)
    return np.asarray(softmax(low * log))


@dataclass(frozen=True)
class Measurement:
    """A measurement that would reduce the uncertainty of a forecast.

    ``shrinks`` is, by figure, the share by which the interval of the mean is expected to become
    narrower if ``how`` determines the parameters of ``what`` exactly, 0 to 1.
    """

    what: str
    how: str
    shrinks: dict[str, float]

    @property
    def mean(self) -> float:
        """Mean over the figures."""
        return float(np.mean(list(self.shrinks.values())))


def group_of(parameter: str, joints: Sequence[str]) -> tuple[str, str]:
    """What a parameter of a reality belongs to, and what measures it."""
    head, _, tail = parameter.partition(".")
    if parameter in DEVIATIONS:
        return "law of the twin", "calibrate in the fluid (sim2real calibrate --fluid)"
    if head in joints and tail == "latency_s":
        return "latency", "record steps through the robot's own link, on several days"
    if head in joints:
        return f"servo {head}", f"record {head} on the bench, as sim2real design suggests"
    if parameter.startswith("body.normalised_density"):
        return "density", "weigh the links"
    if head == "twin":
        return "water", "record further swims in the pool and calibrate with them"
    return "effects of the body", "record the swim that sim2real diagnose suggests"


def first_order(parameters: Array, outcome: Array, groups: Sequence[str]) -> dict[str, float]:
    """Share of an outcome's variance that each group of parameters explains by itself.

    A ridge regression on linear and quadratic functions of the parameters (N, P), which belong to P
    groups, by the penalty that predicts left-out draws best (Golub, Heath and Wahba, Technometrics
    21 (1979) 215). A group's share is its first-order index where groups are independent (Sobol,
    Math. Comput. Simul. 55 (2001) 271).
    """
    names = list(dict.fromkeys(groups))
    sd = parameters.std(axis=0)
    used = np.flatnonzero(sd > 0)
    total = outcome.var()
    if not used.size or total <= 0:
        return dict.fromkeys(names, 0.0)
    z = (parameters[:, used] - parameters[:, used].mean(axis=0)) / sd[used]
    squares = z**2 - 1
    columns = np.concatenate([z, squares - squares.mean(axis=0)], axis=1)
    member = np.tile(np.array(groups)[used], 2)
    left, singular, right = np.linalg.svd(columns, full_matrices=False)
    centred = outcome - outcome.mean()
    projected = left.T @ centred
    found = (np.inf, np.zeros(columns.shape[1]))
    for penalty in len(outcome) * np.logspace(-3, 3, 25):
        kept = singular**2 / (singular**2 + penalty)
        lever = (left**2) @ kept + 1 / len(outcome)
        error = float(np.mean(((centred - left @ (kept * projected)) / (1 - lever)) ** 2))
        if error < found[0]:
            found = error, right.T @ (kept / np.maximum(singular, 1e-12) * projected)
    if found[0] >= total:
        return dict.fromkeys(names, 0.0)
    return {
        name: float((columns[:, member == name] @ found[1][member == name]).var() / total)
        for name in names
    }


def shares_of(
    parameters: Array, values: Array, weights: Array, groups: Sequence[str]
) -> dict[str, float]:
    """``first_order`` of the normal scores of trials (N, T), without chance of single trials."""
    reliable, N = reliability(values), len(weights)
    if reliable <= 0:
        return dict.fromkeys(groups, 0.0)
    rows = np.arange(N)
    if not np.allclose(weights, weights[0]):
        rows = np.random.default_rng(0).choice(N, N, p=weights)
    found = first_order(parameters[rows], expected(normal_scores(values))[rows], groups)
    whole = max(reliable, sum(found.values()))
    return {name: share / whole for name, share in found.items()}


def ranked(
    names: Sequence[str],
    parameters: Array,
    figures: Mapping[str, Array],
    weights: Array,
    joints: Sequence[str],
) -> list[Measurement]:
    """Measurements that narrow most first, by parameters (N, P) and a policy's figures (N, T)."""
    kinds = [group_of(name, joints) for name in names]
    how = dict(kinds)
    shrinks: dict[str, dict[str, float]] = {name: {} for name in how}
    uncertain = {name: x for name, x in figures.items() if reliability(x) > 0}
    for figure, values in uncertain.items():
        shares = shares_of(parameters, values, weights, [name for name, _ in kinds])
        for name, share in shares.items():
            shrinks[name][figure] = 1 - float(np.sqrt(1 - share))
    how["3 trials"] = "swim with this policy and give the results as --trials"
    shrinks["3 trials"] = narrowed_by_trials(uncertain, weights, 3)
    found = [Measurement(name, how[name], shares) for name, shares in shrinks.items() if shares]
    return sorted(found, key=lambda one: -one.mean)


def narrowed_by_trials(
    figures: Mapping[str, Array], weights: Array, trials: int
) -> dict[str, float]:
    """Share by which trials are expected to narrow the interval of each figure, 0 to 1.

    A preposterior analysis (Raiffa and Schlaifer, Applied Statistical Decision Theory, 1961): each
    of 40 draws stands for the robot, and its trials update the forecast; the median is returned.
    The figures of one policy, shape (N, T) each, are those that differ between realities.
    """
    observed = tuple(name for name in figures if name != "success")
    if not observed:
        return dict.fromkeys(figures, 0.0)
    N, T = figures[observed[0]].shape
    mean = np.stack([expected(figures[name]) for name in observed], axis=1)
    chance = np.stack([figures[name] for name in observed], axis=2)
    chance = (chance - chance.mean(axis=1, keepdims=True)).reshape(N * T, -1) * np.sqrt(T / (T - 1))
    rng, shares = np.random.default_rng(0), []
    alone = {name: values[None] for name, values in figures.items()}

    def widths(belief: Array) -> Array:
        ends = [interval(values, belief)[1:] for values in figures.values()]
        return np.diff(ends, axis=1)[:, 0]

    before = widths(weights)
    for truth in rng.choice(N, size=40, p=weights):
        seen = mean[truth] + chance[rng.integers(N * T, size=trials)]
        belief = weights * update([Trials(0, observed, seen)], alone).weights
        shares.append(widths(belief / belief.sum()) / np.maximum(before, 1e-12))
    narrower = 1 - np.median(shares, axis=0)
    return {name: max(0.0, float(x)) for name, x in zip(figures, narrower, strict=True)}


@dataclass(frozen=True)
class TrainingRange:
    """A parameter to randomize in the next training."""

    parameter: str  # its name in ``ranges.json``; latencies are those of single joints
    share: float  # share of the variance between realities that it explains, 0 to 1
    drawn: tuple[float, float]  # its 5 % and 95 % quantile in the realities
    # the same in the training of the policy; None if that does not state it
    trained: tuple[float, float] | None
    # ``widen``, ``narrow``, ``move`` or ``keep`` the range of the training, so that it becomes that
    # of the realities; ``draw`` from that if the training's is not known
    advice: str


def training_ranges(
    names: Sequence[str],
    parameters: Array,
    values: Array,
    weights: Array,
    trained: Mapping[str, Sequence[float]] | None,
) -> list[TrainingRange]:
    """Ranges of the next training: parameters with at least 1 % of the variance, most first.

    ``values`` are of the figure that policies are ranked by, shape (N, T), ``trained`` quantiles of
    the training by name; an effect that it lacks was 0. Errors of the simulator are left out.
    """
    shares = shares_of(parameters, values, weights, names)
    out = []
    for name, column in zip(names, parameters.T, strict=True):
        if name in DEVIATIONS or shares[name] < 0.01:
            continue
        low, high = map(float, quantiles(column[:, None], weights, np.array([0.05, 0.95])))
        before, advice = None, "draw"
        if trained is not None:
            first, last = map(float, trained.get(name, (0.0, 0.0)))
            before, room = (first, last), 0.25 * (high - low)
            less = first > low + room or last < high - room
            more = first < low - room or last > high + room
            advice = ("move" if more else "widen") if less else "narrow" if more else "keep"
        shown = f"body.{name}" if name.startswith("twin.") else name
        out.append(TrainingRange(shown, shares[name], (low, high), before, advice))
    return sorted(out, key=lambda one: -one.share)
