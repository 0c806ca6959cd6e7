"""The forecast of policies: predictive intervals, a ranking, and what would sharpen it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from sim2real.report.drawing import svg
from sim2real.report.notebook import result_section
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture
from sim2real.structured import read_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "sim2real.forecast/1"
SEALED = Path(__file__).with_name("sealed.json")
"""Results of 90 % intervals on sets of realities, by ``benchmarks/forecast_realities.py``."""
_PATHS = (
    "The first trial in twenty realities, with the start at the right and the target at the left; "
    "grey where it is not reached."
)


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

    def rows(self) -> list[tuple[str, str, float, list[float], list[float]]]:
        """Policy, figure, its mean, 90 % intervals of the mean and the next trial; of all."""
        out = []
        for policy in self.policies:
            for figure in FIGURES:
                (mean, *ends), (_, *trial) = (self.interval(policy, figure, n) for n in (np.inf, 1))
                out.append((policy, figure, mean, ends, trial))
        return out

    def content(self) -> dict[str, Any]:
        """Content of ``forecast.json``."""
        table: dict[str, dict[str, Any]] = {policy: {} for policy in self.policies}
        for policy, figure, mean, ends, trial in self.rows():
            intervals = {"mean": mean, "mean_90": ends, "next_trial_90": trial}
            table[policy][figure] = {"unit": FIGURES[figure].unit, **intervals}
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

    def plot(self) -> Figure:
        """Paths of twenty realities over the pool, a panel for each policy."""
        from rl.experiments.figures import aligned, paths_figure
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


@result_section.register
def _forecast(forecast: Forecast) -> Section:
    """All sections in one, for a terminal or a notebook."""
    first, *others = sections(forecast, plots=False)
    parts = ((Text(one.lead, one.title), *one.blocks) for one in others)
    return Section(first.title, first.lead, [*first.blocks, *(x for part in parts for x in part)])


def write_forecast_page(forecast: Forecast, path: str | os.PathLike[str]) -> None:
    """Write the page: intervals, paths, ranking, what to do next."""
    title = f"Forecast of {forecast.robot}"
    number = f"{len(forecast.parameters)} realities that agree with what is known"
    subtitle = f"The task “{forecast.task}” in {number}"
    write_page(path, title, subtitle, sections(forecast), forecast.provenance)


def sections(forecast: Forecast, *, plots: bool = True) -> list[Section]:
    """Sections of the page, or those without plots."""
    rows = []
    for policy, figure, mean, *intervals in forecast.rows():
        shape = FIGURES[figure].digits
        ends = [f"{low:{shape}} to {high:{shape}}" for low, high in intervals]
        trial = "" if figure == "success" else ends[1]
        rows.append((policy, FIGURES[figure].label, f"{mean:{shape}}", ends[0], trial))
    header = ("policy", "figure", "expected", "mean, 90 % interval", "next trial, 90 %")
    caption = (
        "The interval of the mean is that of many trials of the real robot; that of the next trial "
        "contains the chance of a single one. Trials without arrival count with the full time."
    )
    blocks: list[Block] = [Table(header, rows, caption)]
    blocks += [
        Note("info", f"{policy}: P({limit}) = {forecast.probability(policy, limit):.2f}")
        for policy in forecast.policies
        for limit in forecast.limits
    ]
    blocks.append(Note("info", _worth()))
    blocks += [Note("warn", note) for note in forecast.notes]
    if forecast.update is not None:
        kind: Any = "warn" if forecast.update.contradicted else "good"
        blocks.insert(0, Note(kind, forecast.verdict))
    lead = f"{forecast.task} of {forecast.robot} in {len(forecast.parameters)} realities."
    out = [Section("What to expect", lead, blocks)]
    if plots:
        out.append(Section("Paths", _PATHS, [Picture(svg(forecast.plot()), "")]))
    if len(forecast.policies) > 1:
        order = [(policy, f"{chance:.2f}") for policy, chance in forecast.ranking()]
        lead = f"By {FIGURES[forecast.rank_by].label}, best first."
        table = Table(("policy", "probability to be the best"), order)
        out.append(Section("Which policy", lead, [table]))
    following = forecast.next_measurements()
    if following:
        narrower = [
            (x.what, x.how, *(f"{100 * y:.0f} %" for y in (x.mean, *x.shrinks.values())))
            for x in following
        ]
        figures = [FIGURES[name].label for name in following[0].shrinks]
        lead = "By how much narrower the intervals of the means are expected to be after it."
        table = Table(("what", "measurement", "mean", *figures), narrower)
        out.append(Section("What to measure next", lead, [table]))
    if ranges := forecast.next_ranges():
        best = forecast.ranking()[0][0]
        lead = (
            f"Parameters by the share of the variance of the {FIGURES[forecast.rank_by].label} of "
            f"{best} between realities that each explains alone. To train over all that the robot "
            "may be, and no more, give the range of the realities to sim2real train --ranges."
        )
        table = Table(("parameter", "share", "realities, 90 %", "training, 90 %", "next training"),
            [(x.parameter, f"{100 * x.share:.0f} %", _range(x.drawn), _range(x.trained), x.advice)
             for x in ranges])  # fmt: skip
        out.append(Section("What to randomize next", lead, [table]))
    return out


def _range(ends: tuple[float, float] | None) -> str:
    if ends is None:
        return "not stated"
    low, high = (f"{x:.3g}" for x in ends)
    return low if low == high else f"{low} to {high}"


def _worth() -> str:
    """What intervals of forecasts have been worth on sets of simulated realities."""
    parts = []
    for entry in read_json(SEALED)["sets"]:
        names = ("mean time_s", "mean energy", "next time_s", "next energy")
        parts.append(
            "of {} {} they contained the mean time in {:.0f} %, the mean energy in {:.0f} %, the "
            "next trial's in {:.0f} and {:.0f} %".format(
                entry["realities"], entry["of"], *(100 * entry["held"][name] for name in names)
            )
        )
    return f"What 90 % intervals have been worth: {'; '.join(parts)}. No real robot is among them."
