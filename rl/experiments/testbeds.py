"""Testbeds of the ablation: the simulator of an arm, or a reality that no policy has seen."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rl.controllers import Controller
from rl.experiments.evaluate import Episodes, run_episodes
from rl.experiments.real_episodes import Starts, run_real_episodes
from rl.experiments.reality import RealityFile
from rl.make import Fidelity, make_world, own_stream
from rl.sac.train import digest
from rl.task import Task
from rl.world import Draws
from sim2real.robot import Robot

Array = NDArray[np.float64]


class Testbed(Protocol):
    """What policies are tried in."""

    @property
    def name(self) -> str:
        """``simulation`` or ``reality``."""

    @property
    def said(self) -> str:
        """What it is, in a few words."""

    def key(self) -> str:
        """SHA-256 of what decides how robots do in it."""

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot."""


class Controllers:
    """Several controllers, each steering its own share of the robots: as many each, in order."""

    def __init__(self, controllers: Sequence[Controller], repeats: int) -> None:
        """Give each controller ``repeats`` robots."""
        self.controllers = list(controllers)
        self.own = np.repeat(np.arange(len(self.controllers)), repeats)

    def of(self, rows: NDArray[np.intp]) -> Controllers:
        """The same controllers for some of the robots."""
        fewer = Controllers(self.controllers, 1)
        fewer.own = self.own[rows]
        return fewer

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Each begins anew where its robots do."""
        for one, rows in self._shares():
            one.reset(mask[rows])

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Each for its own robots."""
        parts = [(rows, one.act(observation[rows])) for one, rows in self._shares()]
        action = np.empty((len(self.own), parts[0][1].shape[1]), dtype=np.float32)
        for rows, part in parts:
            action[rows] = part
        return action

    def _shares(self) -> list[tuple[Controller, NDArray[np.intp]]]:
        shares = [(one, np.flatnonzero(self.own == k)) for k, one in enumerate(self.controllers)]
        return [share for share in shares if len(share[1])]


@dataclass(frozen=True)
class Simulated:
    """The fluid or the twin.

    Attributes:
        name: ``simulation`` or ``reality``.
        draws: Robot and noise of each agent, in the agents' order.
        fidelity: ``twin`` or ``fluid``.
        cell_m: Side of a cell of the fluid.
        options: Further options of the simulator.
        device, threads: What it runs on.
    """

    name: str
    draws: Sequence[Draws]
    fidelity: Fidelity
    cell_m: float
    options: Mapping[str, Any]
    device: str = "cpu"
    threads: int = 1

    @property
    def said(self) -> str:
        """What it is, in a few words."""
        water = f"fluid, cells of {100 * self.cell_m:g} cm"
        return f"the library's laws in the {water if self.fidelity == 'fluid' else 'twin'}"

    def key(self) -> str:
        """SHA-256 of robots and simulator."""
        rest = (self.fidelity, self.cell_m, dict(self.options))
        told = repr(([digest(draws) for draws in self.draws], rest))
        return hashlib.sha256(told.encode()).hexdigest()

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot, all at once."""

        def place(rng: np.random.Generator, n: int, J: int) -> tuple[Array, Array, Array]:
            del rng, n, J
            return starts.pose, starts.joint, starts.targets

        with own_stream(self.device):
            world = make_world(
                robot, replace(task, place=place), self.draws, n_envs=len(controller.own),
                fidelity=self.fidelity, device=self.device, cell_m=self.cell_m,
                threads=self.threads, seed=seed, **self.options,
            )  # fmt: skip
            return run_episodes(world, controller, name=self.name)


@dataclass(frozen=True)
class Real:
    """A reality of one's own, only seen.

    Attributes:
        file: What makes it.
        device: For a surrogate that is computed.
        name: ``reality``.
    """

    file: RealityFile
    device: str = "cpu"
    name: str = "reality"

    @property
    def said(self) -> str:
        """What it is, in a few words."""
        options = "".join(f", {key} {value}" for key, value in self.file.options.items())
        return f"{self.file.path.name}{options}; rewards from what camera and servos show"

    def key(self) -> str:
        """SHA-256 of the file, what it imports from its folder, and its options."""
        told = repr((self.file.sha256, sorted(self.file.options.items())))
        return hashlib.sha256(told.encode()).hexdigest()

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot, as many at a time as the reality has."""
        total = len(controller.own)
        groups = -(-total // (self.file.at_once or total))
        n = -(-total // groups)
        reality = self.file(robot, n, seed, self.device)
        found = []
        for first in range(0, total, n):
            rows = np.arange(first, first + n)
            swims = rows < total
            rows = np.minimum(rows, total - 1)
            episodes = run_real_episodes(
                reality, controller.of(rows), robot, task, starts.of(rows), swims=swims,
                name=str(self.file.path),
            )  # fmt: skip
            found.append(some(episodes, swims))
        return _joined(found)


def some(episodes: Episodes, which: NDArray[np.bool_]) -> Episodes:
    """The episodes of some of the robots, ``which`` of shape (E,)."""
    e = episodes
    return Episodes(
        e.pose[:, which], e.rate[:, which], e.value[:, which], e.reached[which], e.steps[which],
        e.targets[which],
    )  # fmt: skip


def _joined(found: Sequence[Episodes]) -> Episodes:
    """Episodes one beside the other, the shorter recordings filled up with NaN."""
    T = max(len(one.pose) for one in found)

    def long(values: Array) -> Array:
        more = [(0, T - len(values)), *[(0, 0)] * (values.ndim - 1)]
        return np.pad(values, more, constant_values=np.nan)

    return Episodes(
        np.concatenate([long(one.pose) for one in found], axis=1),
        np.concatenate([long(one.rate) for one in found], axis=1),
        np.concatenate([long(one.value) for one in found], axis=1),
        *(
            np.concatenate([getattr(one, key) for one in found])
            for key in ("reached", "steps", "targets")
        ),
    )
