"""The pool of the recordings as a reality for ``sim2real ablate --reality``: policies swim in it.

The world of ``p1`` and more: its skin, and besides gains 7 to 10 % off the bench's, friction and
play in the servos, latencies that drift, and two rough materials. Camera and servos show what they
show in the recordings. Nothing here may be read by a fit or a training. What the interface is:
``rl.experiments.reality``.
"""

from __future__ import annotations

import numpy as np
from camera import filmed, reported
from numpy.typing import NDArray
from truth import AREAS, Truth
from world import World

from sim2real.robot import Robot

Array = NDArray[np.float64]

CONCEALED = Truth(
    "reality",
    {
        "skin_viscoelasticity": {"stiffness_Nm_per_rad": 0.9, "relaxation_s": 0.4},
        "coulomb_friction": {"torque_Nm": 0.03},
        "backlash": {"gap_rad": 0.02},
        "latency_drift": {"sd_s": 0.008, "time_s": 3.0},
        "surface_friction.rubber": {"coefficient": 0.02},
        "surface_friction.abs": {"coefficient": 0.005},
    },
    kp=(2.3, 1.85, 2.05),
    kd=(0.07, 0.076, 0.061),
    areas=AREAS,
)


def at_once(*, cell_m: float) -> int:
    """Boxes in one batch: 20 of cells of 0.5 cm, or as much memory in others, 7.5 GB."""
    return max(1, int(20 * (cell_m / 0.005) ** 3))


class Pool:
    """Robots in the pool, as camera and servos see them."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self._world, self._rng = world, rng

    def reset(self, pose: Array, joint: Array) -> tuple[Array, Array]:
        """Put all robots at rest: poses (n, 3), joint angles (n, J); what is seen of them."""
        self._world.reset(pose, joint)
        return self._shown()

    def step(self, desired: Array) -> tuple[Array, Array]:
        """Send joint angles in rad, shape (n, J); what is seen a control period later."""
        self._world.step(desired)
        return self._shown()

    def rate(self) -> Array:
        """True joint rates in rad/s, shape (n, J), which no camera or servo shows."""
        return self._world.rate()

    def _shown(self) -> tuple[Array, Array]:
        pose, joint = self._world.where()
        pose, joint = filmed(pose, self._rng), reported(joint, self._rng)
        lost = self._world.stopped()
        pose[lost], joint[lost] = np.nan, np.nan
        return pose, joint


def make(robot: Robot, n: int, seed: int, device: str, *, cell_m: float = 0.005) -> Pool:
    """The robots in their boxes of water.

    Args:
        robot: Links and joints.
        n: How many.
        seed: Of noise and drift.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the water.
    """
    rng = np.random.default_rng(seed)
    world = World([CONCEALED] * n, device=device, cell_m=cell_m, rng=rng, robot=robot)
    return Pool(world, rng)
