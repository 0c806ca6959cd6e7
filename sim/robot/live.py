"""The live state of a batch of robots, for loops that never leave the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import warp as wp

from sim.robot.effects import Outside
from sim2real.arrays import Array, Index, Mask
from sim2real.model import Model
from sim2real.robot import Robot


@dataclass(frozen=True)
class Live:
    """Warp arrays that a simulator reads and writes; take them by DLPack, without a copy.

    Attributes:
        command: Set-points of the next period in rad, shape (E, J), float64; write here.
        q: x, y of the head's centre of mass and heading in the water's frame, joint angles,
            shape (E, 3 + J), float64.
        v: Their rates, likewise.
        measured: Angles measured by the joints' sensors, shape (E, J), float64.
        clock: Seconds since the robot's start, shape (E,), float64.
        stopped: Cell of supersonic flow at which a box was stopped, or -1, shape (E,), int32.
    """

    command: Any
    q: Any
    v: Any
    measured: Any
    clock: Any
    stopped: Any


class Simulator(Protocol):
    """Interface of the fluid's swimmer and the twin."""

    robot: Robot
    n_envs: int

    @property
    def outside(self) -> Outside:
        """Effects on the robots."""

    def live(self) -> Live:
        """The live state."""

    def advance(self) -> None:
        """Advance by one control period with the set-points in ``live().command``."""

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Assign other models to some robots, before their reset."""

    def reset(
        self,
        mask: Mask | None = None,
        pose: Array | None = None,
        joint: Array | None = None,
    ) -> None:
        """Put robots at rest."""


@cache
def _wrapped(device: str, pointer: int) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Warp's view of another library's stream; cached, as a freed view would destroy the stream."""
    return wp.Stream(wp.get_device(device), cuda_stream=pointer)


def use_stream(device: str, pointer: int) -> None:
    """Use another library's stream for all further work on a CUDA device."""
    chosen: Any = wp.get_device(device)
    wp.set_stream(_wrapped(device, pointer), chosen)
