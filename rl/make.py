"""Construction of a world from a robot, a simulator and a distribution of episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal, get_args

import numpy as np
import torch

from rl.randomize import draw_models, noise_of
from rl.task import Task
from rl.world import Draws, World
from sim.robot.live import Simulator, use_stream
from sim2real.errors import InputError, check_choice
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

Fidelity = Literal["twin", "fluid"]

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
    """A world of robots in the fluid or in its twin.

    Args:
        robot: Links, joints and data sheets.
        task: The task.
        draws: Distribution of episodes; several share the environments evenly.
        n_envs: Number of environments.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``. On CUDA all work goes to PyTorch's current stream, which
            must not be the default one: see ``own_stream``.
        cell_m: Side of a cell of the fluid.
        seed: Seed of everything random.
        threads: CPU threads.
        around: Wraps the simulator, to add errors that it does not have.
        options: Further options of the simulator.

    Raises:
        InputError: If robot, models and device are inconsistent, or the fidelity is unknown.
    """
    check_choice("make_world", "fidelity", fidelity, get_args(Fidelity))
    if device != "cpu" and not torch.cuda.is_available():
        raise InputError("train", "--device", device, "a CUDA device, and PyTorch finds none")
    if device != "cpu":
        use_stream(device, torch.cuda.current_stream(device).cuda_stream)
    blocks = [draws] if isinstance(draws, Draws) else list(draws)
    models = [blocks[e * len(blocks) // n_envs].models[0] for e in range(n_envs)]
    simulator: Simulator
    if fidelity == "twin":
        from sim.twin.twin import Twin

        simulator = Twin(robot, models, n_envs=n_envs, device=device, threads=threads, **options)
    else:
        from sim.robot.swimmer import Swimmer

        simulator = Swimmer(
            robot, models, n_envs=n_envs, device=device, cell_m=cell_m, threads=threads, **options
        )
    return World(around(simulator), task, draws=blocks, seed=seed)
