"""A world seen through an ``Observer``: a step is one decision."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rl.observer import Observer, View
from rl.world import Step, World


class Decisions:
    """Robots that take a decision every few control periods.

    Episodes that end between two decisions count until then; the next begins with the next
    decision, so that all robots decide at once.

    Attributes:
        world: The robots at their task, in steps of 20 ms.
        observer: What they see and remember.
        size: Width F of an observation.
    """

    def __init__(self, world: World, view: View) -> None:
        self.world, self.view = world, view
        self.observer = Observer(view, world.low, world.high, world.n_envs)
        self.size = view.size(len(world.low))

    def reset(self) -> Tensor:
        """Begin an episode everywhere; its first observations, shape (E, F)."""
        seen = self.world.reset()
        self.observer.begin(seen)
        return self.observer.see(seen)  # type: ignore[no-any-return]

    def step(self, action: Tensor, *, begin: bool = True) -> Step:
        """Take a decision and go on to the next.

        Args:
            action: Desired angles, -1 and 1 at the ends of each joint's range, shape (E, J).
            begin: Begin an episode where one has ended.

        Returns:
            As ``World.step``, with reward, effort and bonus summed over the decision's periods.
        """
        self.observer.decide(action)
        told = self.world.step(self.observer.set_points(0), begin=False)
        for tick in range(1, self.view.period):
            ended = told.terminated | told.truncated
            told = _added(told, self.world.step(self.observer.set_points(tick), begin=False), ended)
        final = self.observer.see(told.final)
        seen = self.begin(told.terminated | told.truncated) if begin else final
        return replace(told, observation=seen, final=final)

    def begin(self, which: Tensor) -> Tensor:
        """Begin an episode in the environments ``which``, shape (E,).

        Returns:
            The observations of all environments, shape (E, F).
        """
        raw = self.world.begin(which)
        self.observer.begin(raw, which)
        return self.observer.see(raw)  # type: ignore[no-any-return]


def _added(told: Step, step: Step, ended: Tensor) -> Step:
    """Two steps as one, the second counting only where no episode had ended."""
    goes = ~ended
    return Step(
        step.observation,
        told.reward + goes * step.reward,
        told.effort + goes * step.effort,
        told.bonus + goes * step.bonus,
        told.terminated | goes & step.terminated,
        told.truncated | goes & step.truncated,
        torch.where(goes, step.reached, told.reached),
        torch.where(goes[:, None], step.final, told.final),
    )
