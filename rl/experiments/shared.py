"""A beginning that the arms of an ablation share: what it costs to learn to swim is paid once.

Most of a training goes by before an agent swims at all, and when it does is chance: the spread of
that hides what arms differ in. Here one agent a seed learns first, and every arm of that seed goes
on from it: pairs of agents differ by their arms alone. It learns in the simulators of all arms
alike (``every``), so that none is nearer to where it begins. From the old simulator's defaults, a
stiff drive without latency, the arm without a calibrated servo had the shortest way, and the others
were still learning when it was judged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rl.sac.train import Arm, Plan, train
from rl.world import Draws
from sim2real.robot import Robot


def from_shared(first: Arm, plan: Plan) -> Callable[..., list[Path]]:
    """A trainer, called as ``train``, whose agents go on from those of one arm.

    Args:
        first: The arm that all begin in.
        plan: How that is trained; its seeds are those of the plan that the trainer is given.
    """

    def trained(
        folder: Path,
        robot: Robot,
        arms: Sequence[Arm],
        then: Plan,
        note: dict[str, Any] | None = None,
    ) -> list[Path]:
        begun = train(folder / "shared", robot, [first], replace(plan, seeds=then.seeds), note)
        own = [agent / "policy.zip" for _ in arms for agent in begun]
        return train(folder, robot, arms, then, note, first=own)

    return trained


def every(arms: Sequence[Arm]) -> Arm:
    """An arm whose episodes are drawn from all of these alike: no arm is nearer to it than another.

    Args:
        arms: What parts after it; the noise is the first one's.
    """
    most = max(len(arm.draws.models) for arm in arms)
    models = [arm.draws.models[k % len(arm.draws.models)] for k in range(most) for arm in arms]
    return Arm("every", Draws(tuple(models), arms[0].draws.noise))
