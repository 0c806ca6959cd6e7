"""The task of the paper: swim to a target.

Lin, Liu, Wang, "Learning Agile Swimming: An End-to-End Approach without CPGs" (IEEE RA-L 2025),
Sec. III-A. Arrays have a leading axis of E environments; angles in rad, the rest SI.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from torch import Tensor

from rl.observer import CONTROL_S as CONTROL_S
from sim2real.arrays import Array, Index

DOMAIN_M = (3.6, 3.6)
"""Length and width of the pool; its centre is the origin."""
_HALF_M = np.array(DOMAIN_M) / 2 - 0.4
"""Starts and targets are at least 0.4 m from the walls."""


def reward(task: Task, nearer: Tensor, energy: Tensor, ending: Tensor) -> Tensor:
    """10 (d[t-1] - d[t]) - 0.001 |J'|^2 + (10 on arrival, -10 on leaving the pool)."""
    return task.approach * nearer + ending - task.energy * energy


class Starts(NamedTuple):
    """Where n episodes begin: poses (n, 3), joint angles (n, J), waypoints (n, W, 2)."""

    pose: Array
    joint: Array
    targets: Array

    def of(self, rows: Index) -> Starts:
        """The starts of some of the episodes."""
        return Starts(*(x[rows] for x in self))


@dataclass(frozen=True)
class Task:
    """Definition of a task."""

    name: str  # name of the task
    # function of a random generator, n and J that draws starts
    place: Callable[[np.random.Generator, int, int], Starts]
    waypoints: int = 1  # number of waypoints W; an episode ends at the last
    steps: int = 1000  # time limit of an episode, in control periods
    arrive_m: float = 0.05  # distance at which a waypoint is reached
    # weights of the reward's terms
    approach: float = 10.0
    energy: float = 0.001
    bonus: float = 10.0
    # length and width of the pool; outside it an episode ends
    domain_m: tuple[float, float] = DOMAIN_M


def point(rng: np.random.Generator, n: int, J: int) -> Starts:
    """Random start and target in the pool, random heading and small joint angles."""
    pose = np.column_stack([rng.uniform(-_HALF_M, _HALF_M, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    joint = rng.uniform(-0.2, 0.2, (n, J))
    return Starts(pose, joint, rng.uniform(-_HALF_M, _HALF_M, (n, 1, 2)))


def near(rng: np.random.Generator, n: int, J: int) -> Starts:
    """As ``point``, with the target 0.3 to 1 m away in a random direction, for quick training."""
    pose, joint, _ = point(rng, n, J)
    pose[:, :2] *= 0.4
    target = pose[:, :2] + _ways(rng, rng.uniform(0.3, 1.0, n))
    return Starts(pose, joint, target[:, None])


def mixed(rng: np.random.Generator, n: int, J: int) -> Starts:
    """As ``point``, for training: targets 0.12 to 2 m away, uniform in the distance's logarithm."""
    pose, joint, target = point(rng, n, J)
    away, todo = _distances(rng, n), np.arange(n)
    while todo.size:
        pose[todo, :2] = rng.uniform(-_HALF_M, _HALF_M, (todo.size, 2))
        target[todo, 0] = pose[todo, :2] + _ways(rng, away[todo])
        todo = todo[(np.abs(target[todo, 0]) > _HALF_M).any(axis=1)]
    return Starts(pose, joint, target)


def _distances(rng: np.random.Generator, n: int) -> Array:
    """Distances of the targets of ``mixed`` in m, shape (n,)."""
    return np.asarray(0.12 * (2.0 / 0.12) ** rng.uniform(size=n))


def _ways(rng: np.random.Generator, away: Array) -> Array:
    """Ways of these lengths in random directions, shape (n, 2)."""
    around = rng.uniform(-np.pi, np.pi, len(away))
    return np.asarray(away[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1))


def chain(rng: np.random.Generator, n: int, J: int) -> Starts:
    """Three successive targets, each at a distance from the previous one as in ``mixed``.

    40 % of the episodes start as in ``turn``, with the first target behind the robot: the most
    difficult start.
    """
    pose, joint, first = mixed(rng, n, J)
    behind = rng.uniform(size=n) < 0.4
    away = pose[:, :2] - first[:, 0]
    heading = np.arctan2(away[:, 1], away[:, 0]) + rng.normal(0, 0.2, n)
    pose[behind, 2], joint[behind] = heading[behind], 0.0
    ways = [first, first.copy(), first.copy()]
    for last, following in zip(ways[:-1], ways[1:], strict=True):
        todo = np.arange(n)
        while todo.size:
            following[todo, 0] = last[todo, 0] + _ways(rng, _distances(rng, todo.size))
            todo = todo[(np.abs(following[todo, 0]) > _HALF_M).any(axis=1)]
    return Starts(pose, joint, np.concatenate(ways, axis=1))


def turn(rng: np.random.Generator, n: int, J: int) -> Starts:
    """A turn by 180 degrees: at rest, straight, the target 1.5 m behind, at a random place."""
    heading = rng.uniform(-np.pi, np.pi, n)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    middle = rng.uniform(-0.3, 0.3, (n, 2))
    pose = np.column_stack([middle + 0.75 * ahead, heading])
    return Starts(pose, np.zeros((n, J)), (middle - 0.75 * ahead)[:, None])


class Zone(NamedTuple):
    """A square of the pool, its centre on the x axis."""

    x_m: float
    side_m: float = 0.6

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Random points, shape (n, 2)."""
        return rng.uniform(-self.side_m / 2, self.side_m / 2, (n, 2)) + [self.x_m, 0.0]


START_ZONE, TARGET_ZONE = Zone(-1.0), Zone(1.0)
"""Zones of the task ``zones``; the paper's Fig. 4 does not state where they are."""


def zones(rng: np.random.Generator, n: int, J: int) -> Starts:
    """At rest at a random place of the start zone, facing the target zone within 30 degrees."""
    heading = rng.uniform(-np.pi / 6, np.pi / 6, n)
    pose = np.column_stack([START_ZONE.draw(rng, n), heading])
    return Starts(pose, np.zeros((n, J)), TARGET_ZONE.draw(rng, n)[:, None])


def pentagram(rng: np.random.Generator, n: int, J: int) -> Starts:
    """A five-pointed star of radius 1.2 m: 21 waypoints, four per side and the first again."""
    angle = np.pi / 2 + 4 * np.pi / 5 * np.arange(6)
    corner = 1.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    share = np.arange(4)[:, None] / 4
    sides = [a + share * (b - a) for a, b in zip(corner[:-1], corner[1:], strict=True)]
    path = np.concatenate([*sides, corner[-1:]])
    ahead = np.arctan2(*(corner[1] - corner[0])[::-1])
    start = corner[0] - 0.15 * np.array([np.cos(ahead), np.sin(ahead)])
    pose = np.column_stack([start + rng.normal(0, 0.02, (n, 2)), ahead + rng.normal(0, 0.1, n)])
    return Starts(pose, np.zeros((n, J)), np.tile(path, (n, 1, 1)))


TASKS = {
    "point": Task("point", point),
    "near": Task("near", near, steps=500),
    "mixed": Task("mixed", mixed),
    "chain": Task("chain", chain, waypoints=3),
    "turn": Task("turn", turn),
    "zones": Task("zones", zones),
    "pentagram": Task("pentagram", pentagram, waypoints=21, steps=6000),
}
"""All tasks by name."""
