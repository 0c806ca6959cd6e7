"""Trainings from files and JSON options, for any executor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rl.make import Fidelity, draws_of
from rl.sac.recipes import QUICK, plan_of
from rl.sac.train import Arm, train, train_in_parts
from sim2real.model import read_model
from sim2real.output import provenance
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

__all__ = ["QUICK", "train_run"]


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    name: str = "policy",
    seeds: Sequence[int] = (0,),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    recipe: str = "default",
    task: str | None = None,
    steps: int | None = None,
    envs: int | None = None,
    segment: int | None = None,
    updates_per_step: float | None = None,
    learning_rate: float | None = None,
    discount: float | None = None,
    hidden: Sequence[int] | None = None,
    energy_weight: float | None = None,
    energy_start: float | None = None,
    first: Sequence[str] = (),
) -> list[Path]:
    """Train one arm; see ``Plan``, ``Recipe`` and the command ``train`` for the options.

    Returns:
        Folders of the agents.

    Raises:
        InputError: If a file or an option is wrong.
    """
    options = {
        "recipe": recipe, "task": task, "steps": steps, "envs": envs, "segment": segment,
        "updates_per_step": updates_per_step, "learning_rate": learning_rate,
        "discount": discount, "hidden": hidden, "energy_weight": energy_weight,
        "energy_start": energy_start,
    }  # fmt: skip
    plan = plan_of(
        options,
        seeds=tuple(seeds),
        fidelity=fidelity,
        device=device,
        cell_m=cell_m,
        threads=threads,
    )
    fish, fitted = read_robot(robot), read_model(model)
    drawn = None if ranges is None else read_ranges(ranges)
    arm = Arm(name, draws_of(fitted, drawn, fish, seed=0))
    inputs = [robot, model, *([] if ranges is None else [ranges])]
    policies = [Path(path) for path in first]
    several = device == "cpu" and len(seeds) > 1
    trainer = train_in_parts if several else train
    return trainer(folder, fish, [arm], plan, provenance([*inputs, *first], None), first=policies)
