"""Policies swim in drawn realities; results are kept, so that an interrupted forecast resumes."""

from __future__ import annotations

import contextlib
import hashlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.controllers import Controller
from rl.experiments.evaluate import Episodes, run_episodes, spent
from rl.experiments.film import Films
from rl.forecast.figures import FIGURES
from rl.forecast.inexact import Inexact, blocks, disturbances
from rl.forecast.realities import Realities
from rl.make import Fidelity, make_world, own_stream
from rl.metrics import path_length
from rl.task import Task
from rl.world import Draws, World
from sim.view.video import Video
from sim2real.arrays import Array, Mask
from sim2real.errors import InputError
from sim2real.output import write_whole
from sim2real.progress import Progress
from sim2real.robot import Robot
from sim2real.structured import read_arrays


@dataclass(frozen=True)
class SimulationSettings:
    """How realities are simulated.

    Attributes:
        fidelity: ``twin`` or ``fluid``.
        device, threads: Device and CPU threads.
        cell_m: Side of a cell of the fluid.
        at_once: Draws in a batch; the results of each are kept in the file.
    """

    fidelity: Fidelity = "twin"
    device: str = "cpu"
    threads: int = 1
    cell_m: float = 0.02
    at_once: int = 50


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


def swim(
    robot: Robot,
    task: Task,
    realities: Realities,
    controllers: Mapping[str, Callable[[int], Controller]],
    *,
    trials: int,
    seed: int,
    settings: SimulationSettings,
    residuals: Sequence[Array] = (),
    file: Path | None = None,
    key: str = "",
    shown: int = 20,
    progress: Progress = lambda share: None,
) -> SimulatedTrials:
    """Run all policies in all realities; starts, noise and disturbances are common to the policies.

    Args:
        robot: The robot.
        task: The task.
        realities: The realities.
        controllers: By name, a function of the number of robots to their controller.
        trials: Trials in each reality.
        seed: Seed of starts, noise and disturbances.
        settings: How they are simulated.
        residuals: Residuals of recordings, of which the disturbances are made; without them, random
            signals of the size that the fit leaves unexplained.
        file: Results so far; the trials in it are not run again if its key is the same.
        key: All that determines the results besides the policies and their number of trials.
        shown: Number of realities whose paths are kept.
        progress: Called with the share that is done.
    """
    N, K, n = len(realities.models), len(controllers), min(shown, len(realities.models))
    samples = -(-(task.steps + 1) // 5)
    digest = hashlib.sha256(repr((key, list(controllers), N, trials, seed)).encode()).hexdigest()
    table = _kept(file, digest) or {
        **{name: np.full((K, N, trials), np.nan) for name in FIGURES},
        "paths": np.full((K, n, samples, 2), np.nan),
        "targets": np.full((n, task.waypoints, 2), np.nan),
    }
    parts = range(0, N, settings.at_once)
    for part, first in enumerate(parts):
        rows = np.arange(first, min(N, first + settings.at_once))
        for k, make in enumerate(controllers.values()):
            if np.isnan(table["success"][k, rows]).any():
                episodes = _episodes(
                    robot, task, realities, rows, make, trials, [seed, part], settings, residuals
                )
                figures = measured(episodes, task)
                more = np.repeat(realities.energy_error[rows], trials) * figures["energy"]
                figures["energy"] = figures["energy"] + more
                figures["reward"] = figures["reward"] - task.energy * more
                for name, values in figures.items():
                    table[name][k, rows] = values.reshape(-1, trials)
                head = rows[rows < n]
                path = episodes.pose[::5, : len(head) * trials : trials, :2]
                table["paths"][k, head, : len(path)] = np.moveaxis(path, 1, 0)
                table["targets"][head] = episodes.targets[: len(head) * trials : trials]
                if file is not None:
                    stream = io.BytesIO()
                    content: dict[str, Any] = {"digest": np.array(digest), **table}
                    np.savez_compressed(stream, **content)
                    write_whole(file, stream.getvalue())
            progress((part * K + k + 1) / (K * len(parts)))
    return SimulatedTrials(
        {name: table[name] for name in FIGURES}, table["paths"], table["targets"]
    )


def film(
    path: Path,
    names: Mapping[int, str],
    robot: Robot,
    task: Task,
    realities: Realities,
    controller: Callable[[int], Controller],
    *,
    trials: int,
    seed: int,
    settings: SimulationSettings,
    residuals: Sequence[Array] = (),
) -> Episodes:
    """Film the first trial in some of the first ``settings.at_once`` realities, side by side.

    They swim as they did in ``swim``, with all trials of their batch.

    Args:
        path: The film, .mp4, .avi or .gif.
        names: By the index of each reality, its name in the film.
        robot: The robot.
        task: The task.
        realities: The realities.
        controller: A function of the number of robots to the controller.
        trials: Trials in each reality.
        seed: As for ``swim``.
        settings: How they are simulated.
        residuals: As for ``swim``.

    Returns:
        The trials of the batch.
    """
    rows = np.arange(min(settings.at_once, len(realities.models)))
    shown = {trials * d: name for d, name in names.items()}
    with Video(path) as video:
        return _episodes(
            robot, task, realities, rows, controller, trials, [seed, 0], settings, residuals,
            lambda world: Films(video, world, shown),
        )  # fmt: skip


def measured(episodes: Episodes, task: Task) -> dict[str, Array]:
    """The figures of episodes, shape (E,) each.

    ``success`` is 1 on arrival, else 0; ``time_s`` in s and ``energy`` in rad2/s2 count trials
    without arrival with the full time, see ``rl.experiments.evaluate.spent``; ``path_m`` is the
    length of the path.
    """
    time, energy = spent(episodes, task)
    return {
        "success": episodes.success.astype(np.float64),
        "time_s": time,
        "energy": energy,
        "reward": episodes.reward,
        "path_m": path_length(episodes.pose[:, :, :2]),
    }


def _episodes(
    robot: Robot,
    task: Task,
    realities: Realities,
    rows: np.ndarray,
    make: Callable[[int], Controller],
    trials: int,
    seeds: list[int],
    settings: SimulationSettings,
    residuals: Sequence[Array],
    watched: Callable[[World], Callable[[Mask], None]] | None = None,
) -> Episodes:
    """Trials of one policy in some of the realities."""
    rng, E = np.random.default_rng(seeds), len(rows) * trials
    each = np.repeat(rows, trials)
    start = task.place(rng, E, len(robot.joints))
    if residuals:
        disturbance = blocks(residuals, task.steps, E, rng)
    else:
        disturbance = disturbances(realities.unexplained, task.steps, E, rng)
    draws = [Draws((realities.models[d],), realities.noise) for d in each]
    error = realities.velocity_error[each]
    with own_stream(settings.device):
        world = make_world(
            robot, replace(task, place=lambda *_: start), draws, n_envs=E,
            fidelity=settings.fidelity, device=settings.device, cell_m=settings.cell_m,
            threads=settings.threads, seed=int(rng.integers(2**31)),
            around=lambda simulator: Inexact(simulator, error, disturbance),
        )  # fmt: skip
        watch = None if watched is None else watched(world)
        return run_episodes(world, make(E), name="forecast", watch=watch)


def _kept(file: Path | None, digest: str) -> dict[str, Array] | None:
    """The results in a file, if they are those of the same forecast."""
    if file is None or not file.exists():
        return None
    with contextlib.suppress(InputError):
        arrays = read_arrays(file, "trials of a forecast")
        if str(arrays.pop("digest", None)) == digest:
            return arrays
    return None
