"""The forecast of policies: predictive intervals, a ranking, and what would sharpen it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.forecast.causes import Measurement, ranked
from rl.forecast.figures import FIGURES
from rl.forecast.limits import Limit
from rl.forecast.statistics import best, expected, interval
from rl.forecast.training_ranges import TrainingRange, training_ranges
from rl.forecast.trials import Trials, Update, update
from sim2real.arrays import Array
from sim2real.display import NotebookDisplay

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "sim2real.forecast/1"


@dataclass(frozen=True)
class Forecast(NotebookDisplay):
    """What K policies are expected to do on the real robot, from trials in N drawn realities.

    Attributes:
        robot: Name of the robot.
        task: Name of the task.
        policies: Names of the policies.
        joints: Names of the robot's joints.
        figures: Results of T trials in each reality, by figure, shape (K, N, T): ``success``,
            ``time_s`` in s, ``energy`` in rad2/s2, ``reward``, ``path_m`` in m.
        names: Names of the P parameters in which the realities differ.
        parameters: Their values, shape (N, P).
        paths: Positions in the first n realities, every 0.1 s, in m, shape (K, n, S, 2).
        targets: Waypoints of these trials in m, shape (n, W, 2).
        rank_by: Figure that the policies are ranked by.
        trained: By learned policy, 5 % and 95 % quantile of each parameter in its training; empty
            if it does not state them.
        limits: Limits whose probability is stated.
        update: Weights after trials of the real robot; None before.
        notes: Remarks, one sentence each.
        provenance: As returned by ``sim2real.output.provenance``.
    """

    robot: str
    task: str
    policies: tuple[str, ...]
    joints: tuple[str, ...]
    figures: Mapping[str, Array]
    names: tuple[str, ...]
    parameters: Array
    paths: Array
    targets: Array
    rank_by: str = "reward"
    trained: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    update: Update | None = None
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def weights(self) -> Array:
        """Weights of the realities, shape (N,), with sum 1."""
        N = len(self.parameters)
        return np.full(N, 1 / N) if self.update is None else self.update.weights

    def interval(
        self, policy: str, figure: str, trials: float = np.inf, level: float = 0.9
    ) -> tuple[float, float, float]:
        """Mean and central interval of a figure's mean over a number of trials.

        Args:
            policy: Name of the policy.
            figure: Name of the figure.
            trials: Number of trials; by default so many that chance within a reality averages out.
            level: Probability of the interval.
        """
        values = self.figures[figure][self.policies.index(policy)]
        return interval(values, self.weights, trials, level)

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

    def next_measurements(self, policy: str | None = None) -> list[Measurement]:
        """Measurements by the expected narrowing of the intervals of one policy.

        Args:
            policy: Its name; by default the first of the ranking.
        """
        k = self.policies.index(policy or self.ranking()[0][0])
        figures = {name: self.figures[name][k] for name in ("success", "time_s", "energy")}
        return ranked(self.names, self.parameters, figures, self.weights, self.joints)

    def next_ranges(self, policy: str | None = None) -> list[TrainingRange]:
        """Ranges to train with next, by the share of the figure that policies are ranked by.

        There are none for a controller that is not learned.

        Args:
            policy: Its name; by default the first of the ranking.
        """
        policy = policy or self.ranking()[0][0]
        if policy not in self.trained:
            return []
        values = self.figures[self.rank_by][self.policies.index(policy)]
        trained = self.trained[policy] or None
        return training_ranges(self.names, self.parameters, values, self.weights, trained)

    def after(self, trials: Sequence[Trials]) -> Forecast:
        """The forecast after trials of the real robot."""
        return replace(self, update=update(trials, self.figures))

    def content(self) -> dict[str, Any]:
        """Content of ``forecast.json``."""
        table = {
            policy: {
                figure: {
                    "unit": measure.unit,
                    **_ends("mean", self.interval(policy, figure)),
                    **_ends("next_trial", self.interval(policy, figure, 1)),
                }
                for figure, measure in FIGURES.items()
            }
            | {"limits": {str(x): self.probability(policy, x) for x in self.limits}}
            for policy in self.policies
        }
        out: dict[str, Any] = {
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
            "update": None,
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }
        if self.update is not None:
            out["update"] = {
                "trials": self.update.trials,
                "effective_realities": self.update.effective,
                "p_value": self.update.p_value,
                "contradicted": self.update.contradicted,
            }
        return out

    def __str__(self) -> str:
        """Intervals of each policy, the ranking, and what to do next."""
        N = len(self.parameters)
        lines = [f"{self.task} of {self.robot} in {N} realities; 90 % intervals", ""]
        for policy in self.policies:
            lines.append(policy)
            for figure, measure in FIGURES.items():
                mean, low, high = self.interval(policy, figure)
                _, least, most = self.interval(policy, figure, 1)
                shape = measure.digits
                row = f"  {figure:<8} {mean:>9{shape}} {measure.unit:<8}"
                row += f" mean {low:{shape}} to {high:{shape}}"
                if figure != "success":
                    row += f", next trial {least:{shape}} to {most:{shape}}"
                lines.append(row)
            lines += [f"  P({x}) = {self.probability(policy, x):.2f}" for x in self.limits]
        if len(self.policies) > 1:
            order = ", ".join(f"{policy} {chance:.2f}" for policy, chance in self.ranking())
            lines += ["", f"best by {self.rank_by}, with its probability: {order}"]
        lines += ["", "narrower by"]
        lines += [f"  {100 * x.mean:3.0f} %  {x.what}: {x.how}" for x in self.next_measurements()]
        if self.update is not None:
            lines += ["", self.verdict]
        return "\n".join([*lines, *(f"  ! {note}" for note in self.notes)])

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
        import_module("rl.forecast.page")  # registers the section of a forecast
        return super()._repr_html_()

    def plot(self, policy: str | None = None) -> Figure:
        """Paths of twenty realities over the pool; of all policies, or of one."""
        from rl.forecast.paths import paths_figure

        shown = self.policies if policy is None else (policy,)
        which = [self.policies.index(one) for one in shown]
        arrived = self.figures["success"][which, : len(self.targets), 0] > 0
        return paths_figure(shown, self.paths[which], self.targets, arrived)


def _ends(name: str, values: tuple[float, float, float]) -> dict[str, Any]:
    mean, low, high = values
    return {f"{name}_90": [low, high]} | ({"mean": mean} if name == "mean" else {})
