"""Recipes: settings of training of this library and of the paper, and plans from options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rl.observer import PAPER, View
from rl.sac.settings import PLAIN, Settings
from rl.sac.train import Plan
from rl.task import TASKS
from sim2real.errors import InputError


@dataclass(frozen=True)
class Recipe:
    """All settings of a training except robot, simulator and seeds.

    Attributes:
        task: Name of the task.
        energy: Final weight of energy.
        energy_start: Initial weight as a share of ``energy``.
        steps: Control periods of each agent.
        envs: Environments of each agent.
        segment: Control periods between checkpoints.
        view: Definition of the observations.
        settings: Hyper-parameters.
    """

    task: str = "chain"
    energy: float = 7e-4
    energy_start: float = 0.1
    steps: int = 1_600_000
    envs: int = 64
    segment: int = 200_000
    view: View = field(default_factory=View)
    settings: Settings = field(default_factory=lambda: Settings(batch=128))


RECIPES: Mapping[str, Recipe] = {
    "default": Recipe(),
    "paper": Recipe(
        "point", energy=1e-3, energy_start=1.0, steps=800_000, view=PAPER, settings=PLAIN
    ),
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
"""Recipes by the values of ``--recipe``. "brief" continues from small networks that were trained in
another simulator, for each arm of a quick ablation. "fine" continues from policies that nearly
swim, such as in the fluid from those of the twin: full energy weight and little noise from the
start."""
QUICK: dict[str, Any] = {
    "steps": 300_000, "envs": 32, "segment": 60_000, "hidden": [64, 64], "updates_per_step": 0.12,
}  # fmt: skip
"""Settings of ``--quick``: minutes on two cores, in the twin. With 200 000 steps some seeds do not
swim yet with their mean action."""
OPTIONS = (
    "recipe", "task", "steps", "envs", "segment", "updates_per_step", "learning_rate", "discount",
    "hidden", "energy_weight", "energy_start",
)  # fmt: skip
"""Options of a plan, as on the command line; None for the value of the recipe."""


def plan_of(options: Mapping[str, Any], **fields: Any) -> Plan:  # noqa: ANN401 - fields of Plan
    """A plan from options.

    Args:
        options: Some of ``OPTIONS``; those missing or None have the value of the recipe.
        fields: Fields of ``Plan``: seeds, fidelity, device, cell_m, threads.

    Raises:
        InputError: If an option is unknown or out of range.
    """

    def value_of(name: str, default: Any) -> Any:  # noqa: ANN401 - an option's value
        value = options.get(name)
        return default if value is None else value

    name = value_of("recipe", "default")
    if name not in RECIPES:
        raise InputError("train", "--recipe", repr(name), f"one of {', '.join(RECIPES)}")
    recipe = RECIPES[name]
    task = value_of("task", recipe.task)
    if task not in TASKS:
        raise InputError("train", "--task", repr(task), f"one of {', '.join(TASKS)}")
    defaults = recipe.settings
    settings = replace(
        defaults,
        updates_per_step=value_of("updates_per_step", defaults.updates_per_step),
        rate=value_of("learning_rate", defaults.rate),
        gamma=value_of("discount", defaults.gamma),
        hidden=tuple(value_of("hidden", defaults.hidden)),
    )
    envs, segment = value_of("envs", recipe.envs), value_of("segment", recipe.segment)
    shortest = envs * TASKS[task].steps
    if segment < shortest:
        expected = f"at least {shortest}, or no episode ends in one"
        raise InputError("train", "--segment", str(segment), expected)
    return Plan(
        replace(TASKS[task], energy=value_of("energy_weight", recipe.energy)),
        steps=value_of("steps", recipe.steps),
        envs=envs,
        segment=segment,
        settings=settings,
        view=recipe.view,
        energy_start=value_of("energy_start", recipe.energy_start),
        **fields,
    )
