"""Training: several agents side by side in one world, resumable at any moment.

Every ``segment`` steps all episodes begin anew from seeds that depend on the run's seed and the
segment alone, and a checkpoint is written. So a run that was killed goes on from its last
checkpoint exactly as it would have gone on.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from rl.env import desired_angles
from rl.pool import Fidelity, make_world, own_stream
from rl.sac.agents import Agents, Settings
from rl.sac.checkpoint import Progress, load, save
from rl.sac.sac import make_sac
from rl.task import CONTROL_S, Task
from rl.world import Draws, Step, World
from sim2real.errors import InputError
from sim2real.output import write_json
from sim2real.robot import Robot


@dataclass(frozen=True)
class Arm:
    """What one group of agents trains in.

    Attributes:
        name: Names its folder.
        draws: Robots and noise that its episodes are drawn from.
    """

    name: str
    draws: Draws


@dataclass(frozen=True)
class Plan:
    """How to train.

    Attributes:
        task: The task.
        steps: Steps of the environment for each agent.
        envs: Environments of each agent.
        segment: Steps between checkpoints.
        seeds: One agent for each.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid.
        threads: CPU threads of the simulator.
        settings: Hyper-parameters.
        energy_start: Share of the task's energy weight that counts at first; it grows to the whole
            by half of the steps. A robot that cannot swim yet earns nothing by moving.
    """

    task: Task
    steps: int = 1_000_000
    envs: int = 64
    segment: int = 200_000
    seeds: tuple[int, ...] = (0,)
    fidelity: Fidelity = "fluid"
    device: str = "cpu"
    cell_m: float = 0.02
    threads: int = 1
    settings: Settings = field(default_factory=Settings)
    energy_start: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            InputError: If a number is out of its range.
        """
        s = self.settings
        for option, value, fits, expected in (
            ("--steps", self.steps, self.steps >= 1, "at least 1"),
            ("--envs", self.envs, self.envs >= 1, "at least 1"),
            ("--segment", self.segment, self.segment >= 1, "at least 1"),
            ("--updates-per-step", s.updates_per_step, s.updates_per_step > 0, "above 0"),
            ("--learning-rate", s.rate, s.rate > 0, "above 0"),
            ("--discount", s.gamma, 0 <= s.gamma < 1, "from 0 to below 1"),
            ("--energy-start", self.energy_start, 0 <= self.energy_start <= 1, "from 0 to 1"),
        ):
            if not fits:
                raise InputError("train", option, str(value), expected)

    def task_at(self, steps: int) -> Task:
        """The task with the energy weight that counts after so many steps."""
        share = self.energy_start + (1 - self.energy_start) * min(2 * steps / self.steps, 1.0)
        return replace(self.task, energy=share * self.task.energy)

    def content(self) -> dict[str, Any]:
        """All of it that decides the result, as JSON can hold it."""
        kept = {k: v for k, v in asdict(self).items() if k not in ("task", "threads")}
        task = {k: v for k, v in vars(self.task).items() if k != "place"}
        return json.loads(json.dumps({**kept, "task": task}))  # type: ignore[no-any-return]


def train(
    folder: Path, robot: Robot, arms: Sequence[Arm], plan: Plan, note: dict[str, Any] | None = None
) -> list[Path]:
    """Train an agent for each arm and seed, all of them in one batch of robots.

    Args:
        folder: Where the run lives: ``run.json``, ``checkpoint.npz`` and, for each agent,
            ``ARM-SEED/policy.zip`` and ``ARM-SEED/progress.csv``.
        robot: Links, joints and data sheets.
        arms: What each group of agents trains in.
        plan: How to train.
        note: Provenance, kept in ``run.json``.

    Returns:
        The agents' folders: all seeds of the first arm, then those of the next.

    Raises:
        InputError: If the folder holds a run of another plan.
    """
    names = [f"{arm.name}-{seed}" for arm in arms for seed in plan.seeds]
    own = [digest(arm.draws) for arm in arms]
    _begin(folder, {"plan": plan.content(), "agents": names, "draws": own}, note or {})
    with own_stream(plan.device):
        _train(folder, robot, arms, plan, names)
    return [folder / name for name in names]


def digest(draws: Draws) -> str:
    """SHA-256 of what decides the episodes drawn from these."""
    models = [(one.joints, one.body, one.effects) for one in draws.models]
    return hashlib.sha256(repr((models, draws.noise)).encode()).hexdigest()


def _begin(folder: Path, content: dict[str, Any], note: dict[str, Any]) -> None:
    """Write what the run is, or see that it is the same run."""
    path = folder / "run.json"
    if path.exists():
        known = json.loads(path.read_text())
        if {k: known.get(k) for k in content} != content:
            expected = "the same options and files, or a new folder"
            raise InputError(folder, "run.json", "another run", expected)
        return
    write_json(path, {**content, "provenance": note})


def _train(
    folder: Path, robot: Robot, arms: Sequence[Arm], plan: Plan, names: Sequence[str]
) -> None:
    S, A = len(plan.seeds), len(names)
    draws = [arm.draws for arm in arms for _ in plan.seeds]
    world = make_world(
        robot, plan.task, draws, n_envs=A * plan.envs, fidelity=plan.fidelity, device=plan.device,
        cell_m=plan.cell_m, threads=plan.threads,
    )  # fmt: skip
    models = [make_sac(world, plan.settings, plan.seeds[a % S]) for a in range(A)]
    agents = Agents(models, plan.settings, world.device)
    progress = load(folder, agents) or Progress(A)
    bar = tqdm(
        total=plan.steps, initial=progress.steps, desc="train", unit="step", disable=None,
        smoothing=0.05,
    )  # fmt: skip
    while progress.steps < plan.steps:
        last = min(progress.steps + plan.segment, plan.steps)
        _segment(world, agents, plan, progress, last, bar)
        save(folder, agents, progress, names)
    bar.close()


def _segment(
    world: World,
    agents: Agents,
    plan: Plan,
    progress: Progress,
    last: int,
    bar: Any,  # noqa: ANN401
) -> None:
    """From one checkpoint to the next."""
    A, n, settings = len(agents.models), plan.envs, plan.settings
    seed = int(np.random.SeedSequence([*plan.seeds, progress.steps]).generate_state(1)[0])
    world.seed(seed)
    torch.manual_seed(seed)
    observed = world.reset()
    tally = Tally(A, n, world.device)
    noise = torch.randn(A, n, len(world.low), device=world.device)
    kept = math.exp(-CONTROL_S / settings.noise_s) if settings.noise_s > 0 else 0.0
    owed = 0.0
    while progress.steps < last:
        world.task = plan.task_at(progress.steps)
        fresh = torch.randn(noise.shape, device=world.device)
        noise = kept * noise + (1 - kept * kept) ** 0.5 * fresh
        if progress.steps < settings.warm_up:
            action = torch.erf(noise / 2**0.5)  # as likely anywhere between -1 and 1
        else:
            action = agents.act(observed.view(A, n, -1), noise)
        step = world.step(desired_angles(world, action.view(A * n, -1)))
        agents.remember(
            observed.view(A, n, -1), action, step.reward.view(A, n), step.final.view(A, n, -1),
            step.terminated.view(A, n),
        )  # fmt: skip
        observed = step.observation
        tally.add(step, world.task.waypoints)
        progress.steps += n
        bar.update(n)
        if progress.steps >= settings.warm_up:
            owed += settings.updates_per_step * n
            agents.learn(int(owed))
            owed -= int(owed)
        if progress.steps % (20 * n) == 0 and tally.some() or progress.steps >= last:
            progress.note(tally.take(), agents)
            bar.set_postfix_str(progress.said())


class Tally:
    """Sums over the episodes that end, for each agent, kept on the device."""

    def __init__(self, A: int, n: int, device: torch.device) -> None:
        self._return = torch.zeros(A * n, device=device)
        self._length = torch.zeros(A * n, device=device)
        self._sums = torch.zeros(4, A, device=device)
        self._steps = 0

    def add(self, step: Step, waypoints: int) -> None:
        """Count one step of every environment."""
        self._steps += 1
        self._return += step.reward
        self._length += 1
        ended = (step.terminated | step.truncated).float()
        won = ended * (step.reached >= waypoints)
        each = torch.stack([ended, ended * self._return, won, ended * self._length])
        self._sums += each.view(4, self._sums.shape[1], -1).sum(dim=2)
        self._return *= 1 - ended
        self._length *= 1 - ended

    def some(self, least: int = 200) -> bool:
        """Whether enough steps went by to speak of them."""
        return self._steps >= least

    def take(self) -> Tensor:
        """Episodes, mean return, share that arrived, mean length, shape (4, A); begins anew."""
        sums = self._sums.cpu().clone()
        mean = sums[1:] / sums[:1]
        self._sums.zero_()
        self._steps = 0
        return torch.cat([sums[:1], mean])
