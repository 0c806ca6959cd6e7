"""Commands on trained policies: ``evaluate``, ``forecast`` and ``export``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from rl import verbs
from rl.experiments.episodes import Episodes, run_episodes, summary
from rl.experiments.film import Film
from rl.experiments.named import controller_of, shown, with_price
from rl.experiments.testbeds import UNSEEN, DrawnTrials, SimulationSettings
from rl.make import draws_of, make_world, own_stream
from rl.sac.plan import RECIPES
from rl.task import TASKS
from sim.view.video import Video, check_video
from sim2real.commands.command import arguments_of
from sim2real.errors import InputError, check_whole, if_installed
from sim2real.model import read_model
from sim2real.output import beside, check_writable, is_stream, provenance, write_json
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ENDINGS = {".npz": "npz", ".h": "c", ".onnx": "onnx"}


def evaluate(options: argparse.Namespace) -> int:
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


def forecast(options: argparse.Namespace) -> int:
    """Forecast, print and write the intervals, and a page; trials so far are kept."""
    torch.set_num_threads(1)
    out = check_writable(options.out)
    kept = None if is_stream(out) else beside(out, f"{out.stem}.trials.npz")
    found = verbs.forecast(**arguments_of(verbs.forecast, options, kept=kept))
    options.result = found.content()
    write_json(out, options.result)
    print(found)
    if not options.no_page:
        page = beside(out, f"{out.stem}.html")
        with if_installed("page"):
            from rl.forecast.forecast import write_forecast_page

            write_forecast_page(found, page)
            print(f"\npage: {page}")
    return 0


def export(options: argparse.Namespace) -> int:
    """Write a policy in each format asked for."""
    out: Path = check_writable(options.out)
    if not options.format and out.suffix not in ENDINGS:
        ending = f"the ending {out.suffix!r}" if out.suffix else "no ending"
        raise InputError(out, "--out", ending, f"{', '.join(ENDINGS)}, or --format")
    formats = tuple(dict.fromkeys(options.format or [ENDINGS[out.suffix]]))
    from rl.deploy.export import read_zip, write_policy

    policy = read_zip(options.policy, seed=options.seed, price=options.price)
    for file in write_policy(policy, out, formats):
        print(f"{file}: {len(policy.observation)} in, {len(policy.joints)} angles in rad out")
    return 0
