"""Whole trainings from files and plain options, so that any executor can run them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rl.pool import Fidelity, draws_of
from rl.sac.agents import Settings
from rl.sac.train import Arm, Plan, train
from rl.task import TASKS
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import provenance
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

QUICK: dict[str, Any] = {
    "task": "near",
    "steps": 200_000,
    "envs": 32,
    "segment": 40_000,
    "updates_per_step": 0.25,
    "learning_rate": 1e-3,
    "hidden": [128, 128],
    "energy_weight": 1e-4,
}
"""What ``train --quick`` sets: minutes on two cores, in the twin."""


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    name: str = "policy",
    task: str = "point",
    steps: int = 1_000_000,
    envs: int = 64,
    segment: int = 200_000,
    seeds: Sequence[int] = (0,),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    updates_per_step: float = 1.0,
    learning_rate: float = 3e-4,
    discount: float = 0.99,
    hidden: Sequence[int] = (256, 256),
    energy_weight: float | None = None,
    energy_start: float = 1.0,
) -> list[Path]:
    """Train one arm; see ``Plan`` and the command ``train`` for what the options are.

    Returns:
        The agents' folders.

    Raises:
        InputError: If a file or an option is at fault.
    """
    if task not in TASKS:
        raise InputError("train", "--task", repr(task), f"one of {', '.join(TASKS)}")
    if segment < envs * TASKS[task].steps:
        expected = f"at least {envs * TASKS[task].steps}, or no episode ends in one"
        raise InputError("train", "--segment", str(segment), expected)
    fish, fitted = read_robot(robot), read_model(model)
    given = None if ranges is None else read_ranges(ranges)
    chosen = TASKS[task]
    if energy_weight is not None:
        chosen = replace(chosen, energy=energy_weight)
    plan = Plan(
        chosen, steps=steps, envs=envs, segment=segment, seeds=tuple(seeds), fidelity=fidelity,
        device=device, cell_m=cell_m, threads=threads,
        settings=Settings(
            updates_per_step=updates_per_step, rate=learning_rate, gamma=discount,
            hidden=tuple(hidden),
        ),
        energy_start=energy_start,
    )  # fmt: skip
    arm = Arm(name, draws_of(fitted, given, fish, seed=0))
    inputs = [robot, model, *([] if ranges is None else [ranges])]
    return train(folder, fish, [arm], plan, provenance(inputs, None))
