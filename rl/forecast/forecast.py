"""The forecast of policies: predictive intervals, a ranking, and what would sharpen it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rl.experiments.episodes import FIGURES
from rl.experiments.statistics import best, expected, interval
from rl.forecast.trials import (
    Measurement,
    TrainingRange,
    Trials,
    Update,
    ranked,
    training_ranges,
    update,
)
from sim2real.arrays import Array
from sim2real.display import NotebookDisplay
from sim2real.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "sim2real.forecast/1"


@dataclass(frozen=True)
class Limit:
    """A limit of a figure, kept by a ``share`` of the trials, or, if that is None, by the next."""

    figure: str
    above: bool
    value: float
    share: float | None = None

    def kept(self, values: Array) -> Array:
        """1 where values (N, T) keep the limit, else 0."""
        return np.asarray(values >= self.value if self.above else values <= self.value, np.float64)

    def __str__(self) -> str:
        """As on the command line."""
        suffix = "" if self.share is None else f"@{self.share:g}"
        return f"{self.figure}{'>=' if self.above else '<='}{self.value:g}{suffix}"


def limit_of(text: str) -> Limit:
    """A limit from its text; ``time`` and ``path`` stand for ``time_s`` and ``path_m``."""
    match = re.fullmatch(r"(\w+)\s*(<=|>=)\s*([-+.\deE]+)(?:@([.\d]+))?", text.strip())
    try:
        figure, sign, value, share = match.groups() if match else ("", "", "", "")
        name = {"time": "time_s", "path": "path_m"}.get(figure, figure)
        limit = Limit(name, sign == ">=", float(value), None if share is None else float(share))
        if name not in FIGURES or not (limit.share is None or 0 < limit.share <= 1):
            raise ValueError(text)
    except ValueError:
        expected = f"FIGURE<=VALUE or FIGURE>=VALUE@SHARE, with one of {', '.join(FIGURES)}"
        raise InputError("forecast", "limit", repr(text), expected) from None
    return limit


class Row(NamedTuple):
    """A figure of a policy: its mean, and 90 % intervals of the mean and the next trial."""

    policy: str
    figure: str
    mean: float
    mean_90: Sequence[float]
    next_trial_90: Sequence[float]

    @property
    def texts(self) -> tuple[str, str, str]:
        """The mean and both intervals; that of the next trial is empty for success."""
        shape = FIGURES[self.figure].digits
        ends = [f"{low:{shape}} to {high:{shape}}" for low, high in self[3:]]
        return f"{self.mean:{shape}}", ends[0], "" if self.figure == "success" else ends[1]


@dataclass(frozen=True)
class Forecast(NotebookDisplay):
    """What K policies are expected to do on the real robot, from trials in N drawn realities."""

    robot: str
    task: str
    policies: tuple[str, ...]
    joints: tuple[str, ...]
    # results of T trials in each reality, by figure of ``FIGURES``, shape (K, N, T)
    figures: Mapping[str, Array]
    names: tuple[str, ...]  # names of the P parameters in which the realities differ
    parameters: Array  # their values, shape (N, P)
    paths: Array  # positions in the first n realities, every 0.1 s, in m, shape (K, n, S, 2)
    targets: Array  # waypoints of these trials in m, shape (n, W, 2)
    rank_by: str = "reward"  # figure that the policies are ranked by
    # by learned policy, 5 % and 95 % quantile of each parameter in its training; empty if it does
    # not state them
    trained: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()  # limits whose probability is stated
    update: Update | None = None  # weights after trials of the real robot; None before
    notes: tuple[str, ...] = ()  # remarks, one sentence each
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def weights(self) -> Array:
        """Weights of the realities, shape (N,), with sum 1."""
        even = np.full(len(self.parameters), 1 / len(self.parameters))
        return even if self.update is None else self.update.weights

    def interval(
        self, policy: str, figure: str, trials: float = np.inf
    ) -> tuple[float, float, float]:
        """Mean and central 90 % interval of a figure's mean over trials, by default very many."""
        values = self.figures[figure][self.policies.index(policy)]
        return interval(values, self.weights, trials)

    def probability(self, policy: str, limit: Limit) -> float:
        """Probability that a limit is kept by the next trial, or by a share of the trials."""
        kept = limit.kept(self.figures[limit.figure][self.policies.index(policy)])
        if limit.share is None:
            return float(self.weights @ kept.mean(axis=1))
        return float(self.weights @ (expected(kept) >= limit.share))

    def ranking(self) -> list[tuple[str, float]]:
        """Policies, best expected figure first, with the probability of each to be the best."""
        scores = FIGURES[self.rank_by].better * self.figures[self.rank_by]
        mean = np.array([self.weights @ expected(one) for one in scores])
        chance = best(scores, self.weights)
        return [(self.policies[k], float(chance[k])) for k in np.argsort(-mean, kind="stable")]

    def next_measurements(self) -> list[Measurement]:
        """Measurements by how much they narrow the intervals of the best policy."""
        k = self.policies.index(self.ranking()[0][0])
        figures = {name: self.figures[name][k] for name in ("success", "time_s", "energy")}
        return ranked(self.names, self.parameters, figures, self.weights, self.joints)

    def next_ranges(self) -> list[TrainingRange]:
        """Ranges to train the best policy with next, by the share of the figure that ranks it.

        There are none for a controller that is not learned.
        """
        policy = self.ranking()[0][0]
        if policy not in self.trained:
            return []
        values, trained = self.figures[self.rank_by], self.trained[policy] or None
        values = values[self.policies.index(policy)]
        return training_ranges(self.names, self.parameters, values, self.weights, trained)

    def after(self, trials: Sequence[Trials]) -> Forecast:
        """The forecast after trials of the real robot."""
        return replace(self, update=update(trials, self.figures))

    def rows(self) -> list[Row]:
        """The intervals of all policies and figures: rows of every table."""
        out = []
        for policy in self.policies:
            for figure in FIGURES:
                (mean, *ends), (_, *trial) = (self.interval(policy, figure, n) for n in (np.inf, 1))
                out.append(Row(policy, figure, mean, ends, trial))
        return out

    def content(self) -> dict[str, Any]:
        """Content of ``forecast.json``."""
        table: dict[str, dict[str, Any]] = {policy: {} for policy in self.policies}
        for policy, figure, *values in self.rows():
            named = dict(zip(("mean", "mean_90", "next_trial_90"), values, strict=True))
            table[policy][figure] = {"unit": FIGURES[figure].unit, **named}
        for policy, entry in table.items():
            entry["limits"] = {str(x): self.probability(policy, x) for x in self.limits}
        found = self.update
        update = found and {
            "trials": found.trials, "effective_realities": found.effective,
            "p_value": found.p_value, "contradicted": found.contradicted,
        }  # fmt: skip
        return {
            "schema": SCHEMA,
            "robot": self.robot,
            "task": self.task,
            "realities": len(self.parameters),
            "trials": next(iter(self.figures.values())).shape[2],
            "policies": table,
            "ranked_by": self.rank_by,
            "ranking": [{"policy": p, "best": chance} for p, chance in self.ranking()],
            "next": [vars(one) for one in self.next_measurements()],
            "train_next": [vars(one) for one in self.next_ranges()],
            "update": update,
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }

    def __str__(self) -> str:
        """The tables and the notes of the page."""
        import_module("rl.forecast.page")  # registers the section of a forecast
        return super().__str__()

    @property
    def verdict(self) -> str:
        """What the trials of the real robot say of the forecast; empty before."""
        if self.update is None:
            return ""
        found = f"p = {self.update.p_value:.3f}"
        if self.update.contradicted:
            return f"trials: contradict the forecast ({found}): record a swim, then diagnose it"
        number = f"{self.update.effective:.0f} of {len(self.weights)} realities"
        return f"trials: {self.update.trials} agree with the forecast ({found}), {number} count"

    def _repr_html_(self) -> str | None:
        import_module("rl.forecast.page")
        return super()._repr_html_()

    def plot(self) -> Figure:
        """Paths of twenty realities over the pool, a panel for each policy."""
        from rl.experiments.paths import aligned, paths_figure
        from sim2real.report.drawing import ACCENT, MUTED

        ways = {}
        for k, one in enumerate(self.policies):
            arrived = self.figures["success"][k, : len(self.targets), 0] > 0
            trials = zip(self.paths[k], self.targets[:, 0], arrived, strict=True)
            ways[one] = [
                aligned(path[np.isfinite(path).all(axis=1)], target, ACCENT if won else MUTED)
                for path, target, won in trials
            ]
        away = np.linalg.norm(self.targets[:, 0] - self.paths[0, :, 0], axis=1)
        return paths_figure(ways, "Paths over the pool in the first realities", away_m=away)
