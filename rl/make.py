"""Construction of a world from a robot, a simulator and a distribution of episodes.

By default it has the three-joint fish of Lin, Liu and Wang (IEEE RA-L 2025) in the twin, with its
body calibrated to the first shipped swim (``datasets/pool``).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch

from rl.randomize import draw_models, noise_of
from rl.task import TASKS, Task
from rl.world import Draws, World
from sim.robot.live import Simulator, use_stream
from sim2real.errors import InputError, check_choice
from sim2real.model import Model, read_model
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.robot import Robot, read_robot

Fidelity = Literal["twin", "fluid"]
File = str | os.PathLike[str]

FISH = Path(__file__).parent / "fish"
"""The robot, its calibrated model and its ranges that ship with the package."""
DRAWS = 512
"""Number of robots that episodes are drawn from; each occurs a few times in a training."""


def own_stream(device: str) -> AbstractContextManager[Any]:
    """Context manager with the stream that a world on CUDA needs; no effect on a CPU."""
    if device == "cpu" or not torch.cuda.is_available():
        return nullcontext()
    return torch.cuda.stream(torch.cuda.Stream(device))  # type: ignore[no-untyped-call]


def draws_of(model: Model, ranges: Ranges | None, robot: Robot, seed: int, n: int = DRAWS) -> Draws:
    """Episodes of a calibrated model, randomized if ranges are given."""
    if ranges is None:
        return Draws((model,))
    rng = np.random.default_rng(seed)
    models = draw_models(model, ranges, robot, n, rng)
    return Draws(models, noise_of(ranges, [joint.name for joint in robot.joints]))


def episodes_of(robot: str, model: str, ranges: str | None) -> tuple[Robot, Draws, list[str]]:
    """The robot and the episodes of a training, and the files that they are of."""
    fish, drawn = read_robot(robot), None if ranges is None else read_ranges(ranges)
    draws = draws_of(read_model(model), drawn, fish, seed=0)
    return fish, draws, [robot, model, *([] if ranges is None else [ranges])]


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
        task: ``point``, ``near``, ``mixed``, ``chain``, ``turn`` or ``pentagram``; see ``rl.task``.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid, in m.
        seed: Seed of random numbers until the first ``reset(seed=...)``.

    Raises:
        InputError: If a file does not conform to its format, or there is no such task or fidelity.
    """
    check_choice("sim2real/Fish-v0", "task", task, TASKS)
    fish = robot if isinstance(robot, Robot) else read_robot(robot)
    fitted = model if isinstance(model, Model) else read_model(model)
    drawn = ranges if ranges is None or isinstance(ranges, Ranges) else read_ranges(ranges)
    return make_world(
        fish, TASKS[task], draws_of(fitted, drawn, fish, seed), n_envs=n_envs, fidelity=fidelity,
        device=device, cell_m=cell_m, seed=seed,
    )  # fmt: skip


def make_world(
    robot: Robot,
    task: Task,
    draws: Draws | Sequence[Draws],
    *,
    n_envs: int,
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    seed: int = 0,
    threads: int = 1,
    around: Callable[[Simulator], Simulator] = lambda simulator: simulator,
    **options: Any,  # noqa: ANN401 - those of Twin or Swimmer
) -> World:
    """A world of robots in the fluid or in its twin; arguments as for ``World`` and ``world_of``.

    On CUDA all work goes to PyTorch's current stream, which must not be the default one: see
    ``own_stream``. ``around`` wraps the simulator, to add errors that it does not have.

    Raises:
        InputError: If robot, models and device are inconsistent, or the fidelity is unknown.
    """
    check_choice("make_world", "fidelity", fidelity, get_args(Fidelity))
    if device != "cpu":
        if not torch.cuda.is_available():
            raise InputError("train", "--device", device, "a CUDA device, and PyTorch finds none")
        use_stream(device, torch.cuda.current_stream(device).cuda_stream)
    blocks = [draws] if isinstance(draws, Draws) else list(draws)
    models = [blocks[e * len(blocks) // n_envs].models[0] for e in range(n_envs)]
    options |= {"n_envs": n_envs, "device": device, "threads": threads}
    simulator: Simulator
    if fidelity == "twin":
        from sim.twin.twin import Twin

        simulator = Twin(robot, models, **options)
    else:
        from sim.robot.swimmer import Swimmer

        simulator = Swimmer(robot, models, cell_m=cell_m, **options)
    return World(around(simulator), task, blocks, seed)
