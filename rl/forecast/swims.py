"""Policies swim in drawn realities; results are kept, so that an interrupted forecast resumes."""

from __future__ import annotations

import contextlib
import hashlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.experiments.episodes import FIGURES, Episodes, measured
from rl.experiments.film import Film
from rl.experiments.reality import Starts
from rl.experiments.statistics import interval
from rl.experiments.testbeds import SimulationSettings, simulate
from rl.forecast.inexact import Inexact, blocks, disturbances
from rl.forecast.realities import Realities
from rl.task import Task
from rl.world import Draws, World
from sim.view.video import Video
from sim2real.archives import read_arrays
from sim2real.arrays import Array, Mask
from sim2real.errors import InputError
from sim2real.output import write_whole
from sim2real.progress import Progress
from sim2real.robot import Robot

Makers = Mapping[str, Callable[[int], Controller]]
"""By name, a function of the number of robots to their controller."""


@dataclass(frozen=True)
class SimulatedTrials:
    """Results of K policies in N realities, T trials in each.

    Attributes:
        figures: Each of ``FIGURES``, shape (K, N, T).
        paths: Positions of the first trial in the first realities, every 0.1 s, in m, NaN after the
            end, shape (K, n, S, 2).
        targets: Waypoints of these trials in m, shape (n, W, 2).
    """

    figures: Mapping[str, Array]
    paths: Array
    targets: Array


@dataclass(frozen=True)
class Forecaster:
    """Trials of policies in drawn realities; starts, noise and disturbances are common to them.

    Attributes:
        robot: The robot.
        task: The task.
        realities: The realities.
        trials: Trials in each reality.
        seed: Seed of starts, noise and disturbances.
        settings: How they are simulated.
        residuals: Residuals of recordings, of which the disturbances are made; without them, random
            signals of the size that the fit leaves unexplained.
    """

    robot: Robot
    task: Task
    realities: Realities
    trials: int
    seed: int
    settings: SimulationSettings
    residuals: Sequence[Array] = ()

    def swim(
        self,
        controllers: Makers,
        *,
        file: Path | None = None,
        key: str = "",
        shown: int = 20,
        progress: Progress = lambda share: None,
    ) -> SimulatedTrials:
        """Run all policies in all realities.

        Args:
            controllers: The policies.
            file: Results so far; trials in it are not run again if its key is the same.
            key: All that determines the results besides the policies and their number of trials.
            shown: Number of realities whose paths are kept.
            progress: Called with the share that is done.
        """
        N, K, T = len(self.realities.models), len(controllers), self.trials
        n, samples = min(shown, N), -(-(self.task.steps + 1) // 5)
        inputs = (key, list(controllers), N, T, self.seed)
        digest = hashlib.sha256(repr(inputs).encode()).hexdigest()
        table = _kept(file, digest) or {
            **{name: np.full((K, N, T), np.nan) for name in FIGURES},
            "paths": np.full((K, n, samples, 2), np.nan),
            "targets": np.full((n, self.task.waypoints, 2), np.nan),
        }
        parts = -(-N // self.settings.at_once)
        for part in range(parts):
            rows = self._rows(part)
            for k, make in enumerate(controllers.values()):
                if np.isnan(table["success"][k, rows]).any():
                    episodes = self._episodes(part, make)
                    for name, values in self._figures(episodes, rows).items():
                        table[name][k, rows] = values.reshape(-1, T)
                    head = rows[rows < n]
                    path = episodes.pose[::5, : len(head) * T : T, :2]
                    table["paths"][k, head, : len(path)] = np.moveaxis(path, 1, 0)
                    table["targets"][head] = episodes.targets[: len(head) * T : T]
                    if file is not None:
                        stream = io.BytesIO()
                        content: dict[str, Any] = {"digest": np.array(digest), **table}
                        np.savez_compressed(stream, **content)
                        write_whole(file, stream.getvalue())
                progress((part * K + k + 1) / (K * parts))
        figures = {name: table[name] for name in FIGURES}
        return SimulatedTrials(figures, table["paths"], table["targets"])

    def film(
        self, path: Path, names: Mapping[int, str], controller: Callable[[int], Controller]
    ) -> Episodes:
        """Film the first trial in some of the first ``settings.at_once`` realities, side by side.

        They swim as they did in ``swim``, with all trials of their batch, which are returned.
        ``names`` are those in the film, by the index of each reality.
        """
        robots = {self.trials * d: name for d, name in names.items()}
        with Video(path) as video:
            width = 2 * (video.width // 4)
            return self._episodes(
                0, controller, lambda world: Film(video, world, robots, width=width)
            )

    def _rows(self, part: int) -> np.ndarray:
        """Numbers of the realities of a batch."""
        first, N = part * self.settings.at_once, len(self.realities.models)
        return np.arange(first, min(N, first + self.settings.at_once))

    def _episodes(
        self,
        part: int,
        make: Callable[[int], Controller],
        watched: Callable[[World], Callable[[Mask], None]] | None = None,
    ) -> Episodes:
        """Trials of one policy in the realities of a batch."""
        each = np.repeat(self._rows(part), self.trials)
        rng, E, steps = np.random.default_rng([self.seed, part]), len(each), self.task.steps
        starts = Starts(*self.task.place(rng, E, len(self.robot.joints)))
        if self.residuals:
            disturbance = blocks(self.residuals, steps, E, rng)
        else:
            disturbance = disturbances(self.realities.unexplained, steps, E, rng)
        draws = [Draws((self.realities.models[d],), self.realities.noise) for d in each]
        around = partial(Inexact, law=self.realities.law[each, :3], disturbance=disturbance)
        return simulate(
            self.robot, self.task, starts, draws, make(E), self.settings, name="forecast",
            seed=int(rng.integers(2**31)), watched=watched, around=around,
        )  # fmt: skip

    def _figures(self, episodes: Episodes, rows: np.ndarray) -> dict[str, Array]:
        """Figures of a batch, with the error of the energy of each reality."""
        figures = measured(episodes, self.task)
        more = np.repeat(self.realities.law[rows, 3], self.trials) * figures["energy"]
        figures["energy"] = figures["energy"] + more
        figures["reward"] = figures["reward"] - self.task.energy * more
        return figures


def _kept(file: Path | None, digest: str) -> dict[str, Array] | None:
    """The results in a file, if they are those of the same forecast."""
    if file is None or not file.exists():
        return None
    with contextlib.suppress(InputError):
        arrays = read_arrays(file, "trials of a forecast")
        if str(arrays.pop("digest", None)) == digest:
            return arrays
    return None


def predict_arms(
    forecaster: Forecaster, arms: Mapping[str, Sequence[Callable[[int], Controller]]], file: Path,
    key: str,
) -> dict[str, Any]:  # fmt: skip
    """Forecast of every arm of an ablation, the mean over its agents in each reality.

    Args:
        forecaster: The realities and the task.
        arms: The agents of each arm.
        file: File of the trials so far, which are not run again if their key is the same.
        key: Digest of the agents.

    Returns:
        By arm and figure its mean with a 90 % interval; ``loses`` is the reward of the arm "all"
        less that of the arm, in the same realities.
    """
    each = {f"{arm}-{k}": make for arm, of_arm in arms.items() for k, make in enumerate(of_arm)}
    task, N = forecaster.task, len(forecaster.realities.models)
    inputs = (key, forecaster.realities.digest(), forecaster.robot, task.name, task.energy,
              task.steps, forecaster.settings)  # fmt: skip
    figures = forecaster.swim(each, file=file, key=repr(inputs)).figures
    even, first, mean = np.full(N, 1 / N), 0, {}
    for arm, of_arm in arms.items():
        own = slice(first, first := first + len(of_arm))
        mean[arm] = {figure: x[own].mean(axis=0) for figure, x in figures.items()}
    out: dict[str, Any] = {
        arm: {figure: interval(x, even) for figure, x in of_arm.items()}
        for arm, of_arm in mean.items()
    }
    for arm in out.keys() - {"all"} if "all" in out else ():
        out[arm]["loses"] = interval(mean["all"]["reward"] - mean[arm]["reward"], even)
    return out
