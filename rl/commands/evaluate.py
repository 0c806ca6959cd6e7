"""``sim2real evaluate``."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.controllers import Controller
from rl.deploy.export import read_zip
from rl.deploy.forward import read_npz
from rl.experiments.evaluate import Episodes, PolicyController, run_episodes, summary
from rl.experiments.film import Film
from rl.pool import draws_of, make_world, own_stream
from rl.sac.sampled import SampledController
from rl.task import TASKS
from rl.world import World
from sim.view.video import Video, check_video
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import check_writable, provenance, write_json
from sim2real.ranges.entry import read_ranges
from sim2real.robot import Robot, read_robot

CONTROLLERS = ("pnl", "adrc")
"""Those that are not learned, by the names a command line takes in a policy's place."""


def run(options: argparse.Namespace) -> int:
    """Swim the task with each policy; print, write and draw what came of it."""
    out = None if options.out is None else check_writable(options.out)
    picture = None if options.plot is None else check_writable(options.plot)
    if options.video is not None:
        check_video(options.video)
    torch.set_num_threads(1)
    robot, model = read_robot(options.robot), read_model(options.model)
    ranges = None if options.ranges is None else read_ranges(options.ranges)
    if options.episodes < 1:
        raise InputError("evaluate", "--episodes", str(options.episodes), "at least 1")
    task = TASKS[options.task]
    if options.energy_weight is not None:
        task = replace(task, energy=options.energy_weight)
    draws = draws_of(model, ranges, robot, seed=options.seed + 10_000, n=options.episodes)
    swims: dict[str, Episodes] = {}
    with Video(options.video) if options.video else nullcontext() as video:
        for name in options.policies:
            with own_stream(options.device):
                world = make_world(
                    robot, task, draws, n_envs=options.episodes, seed=options.seed,
                    fidelity=options.fidelity, device=options.device, cell_m=options.cell_m,
                    threads=options.threads,
                )  # fmt: skip
                controller = controller_of(name, robot, world, sampled=options.sampled)
                with Film(video, world, shown(name)) if video else nullcontext() as film:
                    swims[name] = run_episodes(world, controller, name=name, watch=film)
    table = {name: summary(episodes) for name, episodes in swims.items()}
    options.result = {"task": options.task, "fidelity": options.fidelity, "results": table}
    for name, row in table.items():
        print(said(name, row))
    if out is not None:
        inputs = [options.robot, options.model, *(p for p in options.policies if Path(p).exists())]
        made = provenance(inputs, options.seed)
        content: dict[str, Any] = {"task": options.task, "fidelity": options.fidelity}
        write_json(out, {**content, "results": table, "provenance": made})
    if picture is not None:
        draw(swims, picture)
    return 0


def controller_of(name: str, robot: Robot, world: World, *, sampled: bool = False) -> Controller:
    """A policy's file, or one of ``CONTROLLERS``.

    Args:
        name: Which.
        robot: Its joints' limits.
        world: Where it swims.
        sampled: Whether a policy's ``.zip`` acts as in training, with noise.

    Raises:
        InputError: If it is neither.
    """
    limits = [joint.limits_rad for joint in robot.joints]
    if name == "pnl":
        from rl.controllers.pnl import ProportionalNavigation

        return ProportionalNavigation(limits, world.n_envs)
    if name == "adrc":
        from rl.controllers.adrc import DisturbanceRejection

        return DisturbanceRejection(limits, world.n_envs)
    from rl.controllers.discrete_cpg import read_policy, read_table

    if (table := read_table(name)) is not None:
        return read_policy(name, table, limits, world.n_envs)
    policy = read_npz(name) if name.endswith(".npz") else read_zip(name)
    if len(policy.joints) != len(limits):
        found = f"{len(policy.joints)} joints"
        raise InputError(name, "joints", found, f"{len(limits)}, as the robot has")
    if sampled and not name.endswith(".npz"):
        return SampledController(name)
    return PolicyController(policy)


def shown(name: str) -> str:
    """A policy's name for people: that of its folder where its own says no more than ``policy``."""
    path = Path(name)
    return path.parent.name if path.stem == "policy" and path.parent.name else path.stem


def said(name: str, row: dict[str, Any]) -> str:
    """One line of the table."""

    def told(key: str, unit: str, digits: int = 2) -> str:
        return "-" if row[key] is None else f"{row[key]:.{digits}f} {unit}".rstrip()

    return (
        f"{name}: {100 * row['success']:.0f} % of {row['episodes']} arrive, "
        f"{told('waypoints', '', 1)} waypoints, time {told('time_s', 's')}, "
        f"reward {told('reward', '')}, energy {told('energy', 'rad2/s2', 0)}, "
        f"faces the target after {told('faced_target_s', 's')}"
    )


def draw(swims: dict[str, Episodes], picture: Path) -> None:
    """Trajectories over the pool, a panel for each policy."""
    from rl.experiments.trajectories import Path as Way
    from rl.experiments.trajectories import draw as draw_ways

    ways: dict[str, Way | list[Way]] = {}
    for name, one in swims.items():
        time = one.time_s
        first = f"{time[0]:.1f} s" if np.isfinite(time[0]) else "does not arrive"
        some = range(min(5, len(time)))
        ways[shown(name)] = [Way(one.pose[:, e, :2], first) for e in some]
    figure = draw_ways(ways, next(iter(swims.values())).targets[0])
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=144)
