"""A world with an ``Observer``: a step is one decision."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rl.observer import Observer, View
from rl.world import Step, World


class Decisions:
    """Robots that take a decision every few control periods.

    If an episode ends between two decisions, later rewards are ignored and the next episode starts
    with the next decision, so that the decisions of all robots are synchronous.

    Attributes:
        world: The robots at their task, in steps of 20 ms.
        observer: Their observations and past decisions.
        size: Width F of an observation.
    """

    def __init__(self, world: World, view: View) -> None:
        self.world, self.view = world, view
        self.observer = Observer(view, world.low, world.high, world.n_envs)
        self.size = view.size(len(world.low))

    def reset(self) -> Tensor:
        """Start an episode in all environments; the first observations, shape (E, F)."""
        observed = self.world.reset()
        self.observer.begin(observed)
        return self.observer.observe(observed)  # type: ignore[no-any-return]

    def step(self, action: Tensor, *, begin: bool = True) -> Step:
        """Apply a decision and simulate until the next.

        Args:
            action: Desired angles, -1 and 1 at the ends of each joint's range, shape (E, J).
            begin: Whether to start an episode where one has ended.

        Returns:
            As ``World.step``, with reward, effort and bonus summed over the decision's periods.
        """
        self.observer.decide(action)
        total = self.world.step(self.observer.set_points(0), begin=False)
        for tick in range(1, self.view.period):
            ended = total.terminated | total.truncated
            total = _added(
                total, self.world.step(self.observer.set_points(tick), begin=False), ended
            )
        final = self.observer.observe(total.final)
        observed = self.begin(total.terminated | total.truncated) if begin else final
        return replace(total, observation=observed, final=final)

    def begin(self, mask: Tensor) -> Tensor:
        """Start an episode where ``mask``, shape (E,), is true.

        Returns:
            The observations of all environments, shape (E, F).
        """
        raw = self.world.begin(mask)
        self.observer.begin(raw, mask)
        return self.observer.observe(raw)  # type: ignore[no-any-return]


def _added(total: Step, step: Step, ended: Tensor) -> Step:
    """Sum of two steps; the second is ignored where an episode has ``ended``."""
    active = ~ended
    return Step(
        step.observation,
        total.reward + active * step.reward,
        total.effort + active * step.effort,
        total.bonus + active * step.bonus,
        total.terminated | active & step.terminated,
        total.truncated | active & step.truncated,
        torch.where(active, step.reached, total.reached),
        torch.where(active[:, None], step.final, total.final),
    )
