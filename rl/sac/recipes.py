"""Recipes: how this library trains, how the paper did, and both from a command line's options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rl.observer import PAPER, View
from rl.sac.agents import PLAIN, Settings
from rl.sac.train import Plan
from rl.task import TASKS
from sim2real.errors import InputError


@dataclass(frozen=True)
class Recipe:
    """All of a training but robot, water and seeds.

    Attributes:
        task: Name of the task.
        energy: Weight of energy in the end.
        energy_start: Share of it at first.
        steps: Control periods of each agent.
        envs: Environments of each agent.
        segment: Control periods between checkpoints.
        view: How agents look at the task.
        settings: Hyper-parameters.
    """

    task: str = "chain"
    energy: float = 7e-4
    energy_start: float = 0.1
    steps: int = 800_000
    envs: int = 64
    segment: int = 200_000
    view: View = field(default_factory=View)
    settings: Settings = field(default_factory=lambda: Settings(batch=128))


RECIPES: Mapping[str, Recipe] = {
    "default": Recipe(),
    "paper": Recipe("point", energy=1e-3, energy_start=1.0, view=PAPER, settings=PLAIN),
    "fine": Recipe(
        energy_start=1.0,
        steps=200_000,
        envs=32,
        segment=32_000,
        settings=Settings(
            batch=128,
            rate=3e-4,
            rate_end=0.3,
            warm_up=20_000,
            entropy_target=(-2.0, -2.5),
            prices=1.0,
        ),
    ),
    "brief": Recipe(
        energy=4e-4,
        energy_start=1.0,
        steps=160_000,
        envs=32,
        segment=160_000,
        settings=Settings(batch=64, hidden=(64, 64), prices=1.0, average=0.5),
    ),
}
"""By the names that ``--recipe`` takes. "brief" goes on from small networks that swim
elsewhere, for each arm of a quick ablation. "fine" goes on from policies that nearly swim here,
such as from the twin's in the fluid: all of the energy weight, little noise at once."""
QUICK: dict[str, Any] = {
    "steps": 300_000, "envs": 32, "segment": 60_000, "hidden": [64, 64], "updates_per_step": 0.12,
}  # fmt: skip
"""What ``--quick`` sets: minutes on two cores, in the twin. With 200 000 steps some of the seeds do
not swim by their mean action yet."""
OPTIONS = (
    "recipe", "task", "steps", "envs", "segment", "updates_per_step", "learning_rate", "discount",
    "hidden", "energy_weight", "energy_start",
)  # fmt: skip
"""Of a plan, as a command line has them; None is the recipe's."""


def plan_of(given: Mapping[str, Any], **water: Any) -> Plan:  # noqa: ANN401 - fields of Plan
    """A plan from options.

    Args:
        given: Some of ``OPTIONS``; what is missing or None is the recipe's.
        water: Fields of ``Plan``: seeds, fidelity, device, cell_m, threads.

    Raises:
        InputError: If an option is none or out of its range.
    """

    def chosen(name: str, otherwise: Any) -> Any:  # noqa: ANN401 - an option's value
        value = given.get(name)
        return otherwise if value is None else value

    name = chosen("recipe", "default")
    if name not in RECIPES:
        raise InputError("train", "--recipe", repr(name), f"one of {', '.join(RECIPES)}")
    recipe = RECIPES[name]
    task = chosen("task", recipe.task)
    if task not in TASKS:
        raise InputError("train", "--task", repr(task), f"one of {', '.join(TASKS)}")
    own = recipe.settings
    settings = replace(
        own,
        updates_per_step=chosen("updates_per_step", own.updates_per_step),
        rate=chosen("learning_rate", own.rate),
        gamma=chosen("discount", own.gamma),
        hidden=tuple(chosen("hidden", own.hidden)),
    )
    envs, segment = chosen("envs", recipe.envs), chosen("segment", recipe.segment)
    least = envs * TASKS[task].steps
    if segment < least:
        expected = f"at least {least}, or no episode ends in one"
        raise InputError("train", "--segment", str(segment), expected)
    return Plan(
        replace(TASKS[task], energy=chosen("energy_weight", recipe.energy)),
        steps=chosen("steps", recipe.steps),
        envs=envs,
        segment=segment,
        settings=settings,
        view=recipe.view,
        energy_start=chosen("energy_start", recipe.energy_start),
        **water,
    )
