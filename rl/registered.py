"""The environments of ``gymnasium.make("sim2real/Fish-v0")`` and ``gymnasium.make_vec``.

    env = gymnasium.make("sim2real/Fish-v0", task="turn")
    envs = gymnasium.make_vec("sim2real/Fish-v0", num_envs=64, fidelity="fluid")

By default they simulate the three-joint fish of Lin, Liu and Wang (IEEE RA-L 2025) in the twin,
with its body calibrated to the first shipped swim (``datasets/pool``).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, get_args

from gymnasium.vector import AutoresetMode

from rl.env import FishEnv, FishVectorEnv
from rl.make import Fidelity, draws_of, make_world
from rl.observer import View
from rl.task import TASKS
from rl.world import World
from sim2real.errors import check_choice
from sim2real.model import Model, read_model
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.robot import Robot, read_robot

File = str | os.PathLike[str]
FISH = Path(__file__).parent / "fish"
"""The robot, its calibrated model and its ranges that ship with the package."""


def make_fish(
    *,
    render_mode: str | None = None,
    view: View = View(),  # noqa: B008 - frozen
    **options: Any,  # noqa: ANN401
) -> FishEnv:
    """Environment of one robot, observed through ``view``; other options as for ``world_of``."""
    return FishEnv(world_of(1, **options), view, render_mode=render_mode)


def make_fish_vec(
    num_envs: int = 1,
    *,
    view: View = View(),  # noqa: B008 - frozen
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,  # noqa: ANN401
) -> FishVectorEnv:
    """Batch of robots, observed through ``view``; other options as for ``world_of``.

    ``autoreset_mode`` is the step in which an episode is reset, see ``FishVectorEnv``.
    """
    return FishVectorEnv(world_of(num_envs, **options), view, autoreset_mode=autoreset_mode)


def world_of(
    n_envs: int,
    *,
    robot: Robot | File = FISH / "robot.toml",
    model: Model | File = FISH / "model.json",
    ranges: Ranges | File | None = None,
    task: str = "point",
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    seed: int = 0,
) -> World:
    """A batch of robots with their task, for ``FishEnv``, ``FishVectorEnv`` and ``FishVecEnv``.

    Args:
        n_envs: Number of robots.
        robot: The robot, or its ``robot.toml``.
        model: Model of its servos and body, or ``MODEL.json``.
        ranges: Randomization ranges, or ``ranges.json``; without them every episode has the same
            robot and no noise.
        task: ``point``, ``near``, ``mixed``, ``chain``, ``turn`` or ``pentagram``; see
            ``rl.task``.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid, in m.
        seed: Seed of random numbers until the first ``reset(seed=...)``.

    Raises:
        InputError: If a file does not conform to its format, or there is no such task or fidelity.
    """
    check_choice("sim2real/Fish-v0", "task", task, TASKS)
    check_choice("sim2real/Fish-v0", "fidelity", fidelity, get_args(Fidelity))
    fish = robot if isinstance(robot, Robot) else read_robot(robot)
    fitted = model if isinstance(model, Model) else read_model(model)
    drawn = ranges if ranges is None or isinstance(ranges, Ranges) else read_ranges(ranges)
    draws = draws_of(fitted, drawn, fish, seed)
    return make_world(
        fish, TASKS[task], draws, n_envs=n_envs, fidelity=fidelity, device=device, cell_m=cell_m,
        seed=seed,
    )  # fmt: skip
