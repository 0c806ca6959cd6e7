"""``sim2real evaluate``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from rl.experiments.episodes import Episodes, run_episodes, summary
from rl.experiments.film import Film
from rl.experiments.named import controller_of, shown, with_price
from rl.experiments.testbeds import UNSEEN, DrawnTrials, SimulationSettings
from rl.make import draws_of, make_world, own_stream
from rl.sac.plan import RECIPES
from rl.task import TASKS
from sim.view.video import Video, check_video
from sim2real.errors import check_whole
from sim2real.model import read_model
from sim2real.output import check_writable, provenance, write_json
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: argparse.Namespace) -> int:
    """Run the task with each policy; print, write and plot the results."""
    out = None if options.out is None else check_writable(options.out)
    picture = None if options.plot is None else check_writable(options.plot)
    if options.video is not None:
        check_video(options.video)
    torch.set_num_threads(1)
    robot, model = read_robot(options.robot), read_model(options.model)
    ranges = None if options.ranges is None else read_ranges(options.ranges)
    check_whole("evaluate", "--episodes", options.episodes, 1)
    weight = (
        RECIPES["default"].task.energy if options.energy_weight is None else options.energy_weight
    )
    task = replace(TASKS[options.task], energy=weight)
    names = list(dict.fromkeys(options.policies))
    controllers = {name: controller_of(name, robot, gains=options.gains) for name in names}
    settings = SimulationSettings(options.fidelity, options.device, options.threads, options.cell_m)
    trials = DrawnTrials(robot, model, ranges, options.episodes, settings)
    swims = trials.run(task, controllers, options.seed)
    table = {name: summary(episodes, task) for name, episodes in swims.items()}
    content: dict[str, Any] = {"task": options.task, "fidelity": options.fidelity}
    options.result = {**content, "results": table}
    for name, row in table.items():
        print(table_line(name, row))
    if out is not None:
        files = dict.fromkeys(with_price(name)[0] for name in names)
        inputs = [options.robot, options.model, *(file for file in files if Path(file).exists())]
        inputs += [options.ranges] if options.ranges else []
        content |= {"randomized": ranges is not None, "energy_weight": weight, "results": table}
        write_json(out, {**content, "provenance": provenance(inputs, options.seed)})
    if picture is not None:
        from sim2real.report.drawing import save_png

        save_png(trajectories(swims), picture)
    if options.video is not None:
        draws = draws_of(model, ranges, robot, seed=options.seed + UNSEEN, n=1)
        with Video(options.video) as video:
            for name, controller in controllers.items():
                with own_stream(options.device):
                    world = make_world(
                        robot, task, draws, n_envs=1, seed=options.seed, **vars(settings)
                    )
                    with Film(video, world, shown(name)) as film:
                        run_episodes(world, controller, name=name, watch=film)
    return 0


def table_line(name: str, row: dict[str, Any]) -> str:
    """One line of the table."""
    faced = row["faced_target_s"]
    return (
        f"{name}: {100 * row['success']:.0f} % of {row['episodes']} arrive, "
        f"{row['waypoints']:.1f} waypoints, time {row['time_s']:.2f} s, "
        f"reward {row['reward']:.2f}, energy {row['energy']:.0f} rad2/s2, "
        f"faces the target after {'-' if faced is None else f'{faced:.2f} s'}"
    )


def trajectories(swims: Mapping[str, Episodes]) -> Figure:
    """Trajectories over the pool, a panel for each policy."""
    from rl.experiments.figures import pool_figure

    ways, notes = {}, {}
    for name, episodes in swims.items():
        time = episodes.time_s
        ways[shown(name)] = [episodes.pose[:, e, :2] for e in range(min(5, len(time)))]
        notes[shown(name)] = f"{time[0]:.1f} s" if np.isfinite(time[0]) else "does not arrive"
    return pool_figure(ways, next(iter(swims.values())).targets[0], notes)
