"""Where policies are tested, a simulator or a reality, and the choice of agents by such trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rl.controllers import Controller
from rl.deploy.export import policy_of, set_price
from rl.deploy.policy import PolicyController
from rl.experiments.episodes import Episodes, run_episodes, summary
from rl.experiments.named import controller_of
from rl.experiments.reality import RealityFile, real_world
from rl.make import Fidelity, digest, draws_of, make_world, own_stream
from rl.sac.sac import read_agent
from rl.sac.train import digest_of
from rl.task import TASKS, Starts, Task
from rl.world import Draws, World
from sim2real.arrays import Array, Array32, Index, Mask
from sim2real.model import Model
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot

UNSEEN = 10_000
"""Offset of the seed, so that trials do not use robots drawn in training."""


@dataclass(frozen=True)
class SimulationSettings:
    """Arguments of ``make_world``."""

    fidelity: Fidelity = "twin"
    device: str = "cpu"
    threads: int = 1
    cell_m: float = 0.02


Watcher = Callable[[World], Callable[[Mask], None]]
"""From a world to what is called after each of its control periods, see ``run_episodes``."""


def unwatched(_: World) -> Callable[[Mask], None]:
    """Watch nothing."""
    return lambda going: None


class Controllers:
    """Several controllers, each for ``repeats`` of the robots, in order."""

    def __init__(self, controllers: Sequence[Controller], repeats: int) -> None:
        self.controllers = list(controllers)
        self.owner = np.repeat(np.arange(len(self.controllers)), repeats)

    def of(self, rows: Index) -> Controllers:
        """The same controllers for some of the robots, in increasing order."""
        fewer = Controllers(self.controllers, 1)
        fewer.owner = self.owner[rows]
        return fewer

    def reset(self) -> None:
        """All robots begin anew."""
        for controller in self.controllers:
            controller.reset()

    def act(self, observation: Array32) -> Array32:
        """Actions of all robots, shape (n, J), for their observations (n, O)."""
        owners = np.unique(self.owner)
        acted = [self.controllers[k].act(observation[self.owner == k]) for k in owners]
        order = np.argsort(self.owner, kind="stable")
        return np.asarray(np.concatenate(acted)[np.argsort(order)])


def trials_of(
    swim: Callable[..., Episodes],
    controllers: Sequence[Controller],
    robot: Robot,
    task: Task,
    repeats: int,
    seed: int,
    watcher: Watcher = unwatched,
) -> list[Episodes]:
    """``repeats`` episodes of each controller, with the same starts for all; see ``Testbed``."""
    placed = task.place(np.random.default_rng(seed), repeats, len(robot.joints))
    K, who = len(controllers), Controllers(controllers, repeats)
    starts = Starts(*(np.tile(x, (K, *[1] * (x.ndim - 1))) for x in placed))
    swims = swim(who, robot, task, starts, seed, watcher)
    return [swims.of(who.owner == k) for k in range(K)]


def simulate(
    who: Controller,
    robot: Robot,
    task: Task,
    starts: Starts,
    seed: int,
    watcher: Watcher = unwatched,
    *,
    draws: Sequence[Draws],
    settings: SimulationSettings,
    name: str,
    **options: Any,  # noqa: ANN401
) -> Episodes:
    """One episode of each robot in the fluid or the twin; ``options`` are of ``make_world``."""
    with own_stream(settings.device):
        world = make_world(
            robot, replace(task, place=lambda *_: starts), draws, n_envs=len(starts.pose),
            seed=seed, **vars(settings), **options,
        )  # fmt: skip
        return run_episodes(world, who, name=name, watch=watcher(world))


@dataclass(frozen=True)
class DrawnTrials:
    """Trials of controllers: the same starts, targets and robots, of ranges if any, for each."""

    robot: Robot
    model: Model
    ranges: Ranges | None = None
    episodes: int = 20  # of each controller
    settings: SimulationSettings = SimulationSettings()

    def run(
        self, task: Task, controllers: Mapping[str, Controller], seed: int = 0
    ) -> dict[str, Episodes]:
        """The episodes of each controller, by its name."""
        n, steering = self.episodes, list(controllers.values())
        drawn = draws_of(self.model, self.ranges, self.robot, seed=seed + UNSEEN, n=n)
        draws = [Draws((m,), drawn.noise) for m in drawn.models] * len(steering)
        swim = partial(simulate, draws=draws, settings=self.settings, name=task.name)
        swims = trials_of(swim, steering, self.robot, task, n, seed)
        return dict(zip(controllers, swims, strict=True))

    def summaries(
        self, tasks: Sequence[Task], controllers: Mapping[str, Controller], seed: int
    ) -> dict[str, dict[str, Any]]:
        """The summary of each task, by controller and task."""
        rows: dict[str, dict[str, Any]] = {name: {} for name in controllers}
        for task in tasks:
            for name, episodes in self.run(task, controllers, seed).items():
                rows[name][task.name] = summary(episodes, task)
        return rows


class Testbed(NamedTuple):
    """A simulator or a reality; ``key`` is the SHA-256 of all that determines its results."""

    name: str
    description: str
    key: str
    # from controllers, robot, task, starts, a seed and a ``Watcher`` of the first world to episodes
    swim: Callable[..., Episodes]


def simulated(
    name: str,
    draws: Sequence[Draws],
    settings: SimulationSettings,
    **options: Any,  # noqa: ANN401 - those of the simulator
) -> Testbed:
    """The fluid or the twin, with robot and noise of each agent, in the agents' order."""
    swim = partial(simulate, draws=draws, settings=settings, name=name, **options)
    fluid = settings.fidelity == "fluid"
    water = f"fluid, cells of {100 * settings.cell_m:g} cm" if fluid else "twin"
    content = ([digest_of(one) for one in draws], (settings.fidelity, settings.cell_m, options))
    return Testbed(name, f"the library's laws in the {water}", digest(content), swim)


def real(file: RealityFile, device: str = "cpu") -> Testbed:
    """A user-defined reality; its robots swim in groups of equal size, at most ``at_once``."""

    def swim(
        who: Controllers, robot: Robot, task: Task, starts: Starts, seed: int,
        watcher: Watcher = unwatched,
    ) -> Episodes:  # fmt: skip
        total = len(who.owner)
        n = max(n for n in range(1, (file.at_once or total) + 1) if total % n == 0)
        reality = file(robot, n, seed, device)
        parts: list[Episodes] = []
        for rows in np.arange(total).reshape(-1, n):
            world = real_world(reality, robot, task, starts.of(rows), str(file.files[0]))
            watch = (unwatched if parts else watcher)(world)
            parts.append(run_episodes(world, who.of(rows), name="reality", watch=watch))
        return _joined(parts)

    options = "".join(f", {key} {value}" for key, value in file.options.items())
    description = f"{file.files[0].name}{options}; rewards from what camera and servos show"
    key = digest((file.sha256, sorted(file.options.items())))
    return Testbed("reality", description, key, swim)


def _joined(parts: Sequence[Episodes]) -> Episodes:
    """Concatenate episodes, padding the shorter recordings with NaN."""
    T = max(len(part.pose) for part in parts)
    joined: dict[str, Any] = {}
    for name in vars(parts[0]):
        values = [getattr(part, name) for part in parts]
        if timed := name in ("pose", "rate", "value"):
            values = [
                np.concatenate([x, np.full((T - len(x), *x.shape[1:]), np.nan)]) for x in values
            ]
        joined[name] = np.concatenate(values, axis=int(timed))
    return Episodes(**joined)


HELD_OUT = ("turn", "mixed")
"""Tasks of the trials; an agent's score is the mean of its rewards in them."""
EXPONENTS = (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)
"""Exponents of the prices tested: -1 is the lowest that an agent was trained for, 0 its default."""
PRICED = ("turn", "near")
SEED = 77_000
PRICE_SEED = 78_000


def held_out(
    trials: DrawnTrials,
    folders: Sequence[Path],
    energy: float,
    names: Sequence[str] = HELD_OUT,
) -> dict[str, Any]:
    """Test agents, with their mean actions, in the same randomized trials at one weight of energy.

    Returns in training are no substitute: there actions are sampled and the energy weight grows.
    ``names`` are those of the tasks. The result: ``best``, the folder name of the agent with the
    highest score, and by name ``score``, the ``success`` over all tasks and the summary of each.
    """
    files = {folder.name: str(folder / "policy.zip") for folder in folders}
    controllers = {name: controller_of(file, trials.robot) for name, file in files.items()}
    tasks = [replace(TASKS[name], energy=energy) for name in names]
    agents = trials.summaries(tasks, controllers, SEED)
    for rows in agents.values():
        for mean, figure in (("score", "reward"), ("success", "success")):
            rows[mean] = float(np.mean([rows[name][figure] for name in names]))
    best = max(agents, key=lambda agent: agents[agent]["score"])
    return {"best": best, "energy_weight": energy, "episodes": trials.episodes, "agents": agents}


def choose_prices(trials: DrawnTrials, folders: Sequence[Path]) -> dict[str, float]:
    """Set each agent's price of energy to the best one relative to proportional navigation.

    The chosen one minimises the larger of the ratios of time and energy to those of proportional
    navigation at middle pace, over all tasks tested. The agents' ``policy.zip`` are rewritten. The
    result: the price, relative to the training's, by name of the folder.
    """
    read: dict[Path, Any] = {folder: read_agent(folder / "policy.zip") for folder in folders}
    agents = {
        folder: agent
        for folder, agent in read.items()
        if getattr(agent, "by_price", {}).get("column") is not None
    }
    controllers = {"pnl": controller_of("pnl", trials.robot)}
    for folder, agent in agents.items():
        for exponent in EXPONENTS:
            set_price(agent, agent.by_price["prices"] ** exponent)
            controllers[f"{folder}@{exponent}"] = PolicyController(policy_of(agent))
    tasks = [TASKS[name] for name in PRICED] if agents else []
    rows = trials.summaries(tasks, controllers, PRICE_SEED)

    def spent(name: str) -> Array:
        return np.array([[rows[name][task][x] for x in ("time_s", "energy")] for task in PRICED])

    chosen = {}
    for folder, agent in agents.items():
        ratios = [spent(f"{folder}@{x}") / np.maximum(spent("pnl"), 1e-9) for x in EXPONENTS]
        worst = [one.max() for one in ratios]
        chosen[folder.name] = float(agent.by_price["prices"] ** EXPONENTS[int(np.argmin(worst))])
        set_price(agent, chosen[folder.name])
        agent.save(folder / "policy.zip")
    return chosen
