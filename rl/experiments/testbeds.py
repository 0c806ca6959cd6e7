"""Testbeds of the ablation: the simulator of an arm, or a reality not used in training."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from rl.controllers import Controller
from rl.experiments.evaluate import Episodes, run_episodes
from rl.experiments.real_episodes import Starts, run_real_episodes
from rl.experiments.reality import RealityFile
from rl.make import Fidelity, make_world, own_stream
from rl.sac.train import digest
from rl.task import Task
from rl.world import Draws
from sim2real.arrays import Array, Array32, Index, Mask
from sim2real.robot import Robot


class Testbed(Protocol):
    """A simulator or reality that policies are tested in."""

    @property
    def name(self) -> str:
        """``simulation`` or ``reality``."""

    @property
    def description(self) -> str:
        """What it is, in a few words."""

    def key(self) -> str:
        """SHA-256 of all that determines the results in it."""

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot."""


class Controllers:
    """Several controllers, each for an equal share of the robots, in order."""

    def __init__(self, controllers: Sequence[Controller], repeats: int) -> None:
        """Give each controller ``repeats`` robots."""
        self.controllers = list(controllers)
        self.owner = np.repeat(np.arange(len(self.controllers)), repeats)

    def of(self, rows: Index) -> Controllers:
        """The same controllers for some of the robots."""
        fewer = Controllers(self.controllers, 1)
        fewer.owner = self.owner[rows]
        return fewer

    def reset(self, mask: Mask) -> None:
        """Reset the controllers of the robots in ``mask``."""
        for controller, rows in self._shares():
            controller.reset(mask[rows])

    def act(self, observation: Array32) -> Array32:
        """Actions of all robots."""
        parts = [(rows, controller.act(observation[rows])) for controller, rows in self._shares()]
        action = np.empty((len(self.owner), parts[0][1].shape[1]), dtype=np.float32)
        for rows, part in parts:
            action[rows] = part
        return action

    def _shares(self) -> list[tuple[Controller, Index]]:
        shares = [
            (controller, np.flatnonzero(self.owner == k))
            for k, controller in enumerate(self.controllers)
        ]
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
        device, threads: Device and CPU threads of the simulation.
    """

    name: str
    draws: Sequence[Draws]
    fidelity: Fidelity
    cell_m: float
    options: Mapping[str, Any]
    device: str = "cpu"
    threads: int = 1

    @property
    def description(self) -> str:
        """What it is, in a few words."""
        water = f"fluid, cells of {100 * self.cell_m:g} cm"
        return f"the library's laws in the {water if self.fidelity == 'fluid' else 'twin'}"

    def key(self) -> str:
        """SHA-256 of robots and simulator settings."""
        settings = (self.fidelity, self.cell_m, dict(self.options))
        content = repr(([digest(draws) for draws in self.draws], settings))
        return hashlib.sha256(content.encode()).hexdigest()

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot, all at once."""

        def place(rng: np.random.Generator, n: int, J: int) -> tuple[Array, Array, Array]:
            del rng, n, J
            return starts.pose, starts.joint, starts.targets

        with own_stream(self.device):
            world = make_world(
                robot, replace(task, place=place), self.draws, n_envs=len(controller.owner),
                fidelity=self.fidelity, device=self.device, cell_m=self.cell_m,
                threads=self.threads, seed=seed, **self.options,
            )  # fmt: skip
            return run_episodes(world, controller, name=self.name)


@dataclass(frozen=True)
class Real:
    """A user-defined reality.

    Attributes:
        file: Its Python file.
        device: Device of a simulated surrogate.
        name: ``reality``.
    """

    file: RealityFile
    device: str = "cpu"
    name: str = "reality"

    @property
    def description(self) -> str:
        """What it is, in a few words."""
        options = "".join(f", {key} {value}" for key, value in self.file.options.items())
        return f"{self.file.path.name}{options}; rewards from what camera and servos show"

    def key(self) -> str:
        """SHA-256 of the file, its imports from its folder, and its options."""
        content = repr((self.file.sha256, sorted(self.file.options.items())))
        return hashlib.sha256(content.encode()).hexdigest()

    def swim(
        self, controller: Controllers, robot: Robot, task: Task, starts: Starts, seed: int
    ) -> Episodes:
        """One episode of each robot, at most ``at_once`` robots at a time."""
        total = len(controller.owner)
        groups = -(-total // (self.file.at_once or total))
        n = -(-total // groups)
        reality = self.file(robot, n, seed, self.device)
        parts = []
        for first in range(0, total, n):
            rows = np.arange(first, first + n)
            swims = rows < total
            rows = np.minimum(rows, total - 1)
            episodes = run_real_episodes(
                reality, controller.of(rows), robot, task, starts.of(rows), swims=swims,
                name=str(self.file.path),
            )  # fmt: skip
            parts.append(subset(episodes, swims))
        return _joined(parts)


def subset(episodes: Episodes, mask: Mask) -> Episodes:
    """The episodes of some of the robots, ``which`` of shape (E,)."""
    e = episodes
    return Episodes(
        e.pose[:, mask], e.rate[:, mask], e.value[:, mask], e.reached[mask], e.steps[mask],
        e.targets[mask],
    )  # fmt: skip


def _joined(parts: Sequence[Episodes]) -> Episodes:
    """Concatenate episodes, padding the shorter recordings with NaN."""
    T = max(len(part.pose) for part in parts)

    def padded(values: Array) -> Array:
        padding = [(0, T - len(values)), *[(0, 0)] * (values.ndim - 1)]
        return np.pad(values, padding, constant_values=np.nan)

    return Episodes(
        np.concatenate([padded(part.pose) for part in parts], axis=1),
        np.concatenate([padded(part.rate) for part in parts], axis=1),
        np.concatenate([padded(part.value) for part in parts], axis=1),
        *(
            np.concatenate([getattr(part, key) for part in parts])
            for key in ("reached", "steps", "targets")
        ),
    )
