"""Training of several agents in one world, resumable at any moment.

On a CPU, simulation of the next decision and learning run in parallel. Every ``segment`` steps a
checkpoint is written and all episodes restart, with seeds that depend only on the seed of the run
and the segment. A run that was killed therefore resumes exactly from its last checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from rl.decisions import Decisions
from rl.make import Fidelity, make_world, own_stream
from rl.observer import View
from rl.randomize import spread_of
from rl.sac.agents import Agents
from rl.sac.checkpoint import Progress, load, save
from rl.sac.sac import make_sac, read_agent, start_from
from rl.sac.settings import Settings
from rl.task import Task
from rl.world import Draws, Step
from sim2real.errors import InputError
from sim2real.output import write_json
from sim2real.robot import Robot
from sim2real.structured import read_json


@dataclass(frozen=True)
class Arm:
    """Training conditions of one group of agents.

    Attributes:
        name: Name, also of its folder.
        draws: Robots and noise that its episodes are drawn from.
        energy: Final weight of energy; default: that of the task.
    """

    name: str
    draws: Draws
    energy: float | None = None


@dataclass(frozen=True)
class Plan:
    """Plan of a training.

    Attributes:
        task: The task.
        steps: Control periods of the environments for each agent.
        envs: Environments of each agent.
        segment: Control periods between checkpoints.
        seeds: Random seeds, one agent for each.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid.
        threads: CPU threads of the simulator.
        settings: Hyper-parameters.
        view: Definition of the observations.
        energy_start: Initial weight of energy as a share of that of the task. With the full weight,
            a robot that cannot swim yet would learn not to move.
        ramp: Shares of the steps: when the weight starts to grow, and how long it takes to reach
            its final value.
        gate: Share of an agent's last episodes that must have succeeded for its weight to grow, so
            that agents that learn late are not penalised.
    """

    task: Task
    steps: int = 1_600_000
    envs: int = 64
    segment: int = 200_000
    seeds: tuple[int, ...] = (0,)
    fidelity: Fidelity = "fluid"
    device: str = "cpu"
    cell_m: float = 0.02
    threads: int = 1
    settings: Settings = field(default_factory=Settings)
    view: View = field(default_factory=View)
    energy_start: float = 0.1
    ramp: tuple[float, float] = (0.15, 0.25)
    gate: float = 0.7

    def __post_init__(self) -> None:
        """Check the values.

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

    def grown(self, before: float, steps: int, more: int, success: float) -> float:
        """Growth of an agent's energy weight, from 0 to 1.

        Args:
            before: Growth so far.
            steps: Control periods so far.
            more: Control periods since the last call.
            success: Share of its last episodes that succeeded.
        """
        begin, length = self.ramp
        if steps < begin * self.steps or not success >= self.gate:
            return before
        return min(before + more / max(length * self.steps, 1.0), 1.0)

    def price(self, arm: Arm, grown: float) -> float:
        """Weight of energy of an agent, given its growth."""
        full = self.task.energy if arm.energy is None else arm.energy
        return full * (self.energy_start + (1 - self.energy_start) * grown)

    def content(self) -> dict[str, Any]:
        """All that determines the result, as JSON values."""
        fields = {k: v for k, v in asdict(self).items() if k not in ("task", "threads")}
        task = {k: v for k, v in vars(self.task).items() if k != "place"}
        return json.loads(json.dumps({**fields, "task": task}))  # type: ignore[no-any-return]


def train(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    note: dict[str, Any] | None = None,
    *,
    first: Sequence[Path] = (),
) -> list[Path]:
    """Train an agent for each arm and seed, all in one batch of robots.

    Args:
        folder: Folder of the run, with ``run.json``, ``checkpoint.npz`` and, for each agent,
            ``ARM-SEED/policy.zip`` and ``ARM-SEED/progress.csv``.
        robot: Links, joints and data sheets.
        arms: The simulator that each group of agents trains in.
        plan: Plan of the training.
        note: Provenance, written to ``run.json``.
        first: Policies (``policy.zip``) to continue from, assigned to the seeds of every arm in
            turn; random networks if empty. Replay memories are not part of them.

    Returns:
        Folders of the agents: all seeds of the first arm, then those of the next.

    Raises:
        InputError: If the folder has a run of another plan, or the first policies do not fit.
    """
    names = agent_names(arms, plan.seeds)
    digests = [digest(arm.draws) for arm in arms]
    prices = [arm.energy for arm in arms]
    content = {"plan": plan.content(), "agents": names, "draws": digests, "energy": prices}
    if first:
        for path in first:
            read_agent(path)  # refused, if at all, before anything is written
        content["first"] = [hashlib.sha256(path.read_bytes()).hexdigest() for path in first]
    _write_run(folder, content, note or {})
    with own_stream(plan.device):
        _train(folder, robot, arms, plan, names, first)
    return [folder / name for name in names]


def train_in_parts(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    note: dict[str, Any] | None = None,
    *,
    first: Sequence[Path] = (),
    parts: int = 2,
) -> list[Path]:
    """Train as ``train`` does, with the seeds distributed over processes to use several cores.

    Args:
        folder: Folder of the runs, in ``part-0`` and so on.
        robot: See ``train``.
        arms: See ``train``.
        plan: See ``train``; each process has one simulator thread.
        note: See ``train``.
        first: See ``train``.
        parts: Number of processes.
    """
    shares = [range(k, len(plan.seeds), parts) for k in range(min(parts, len(plan.seeds)))]
    trainings = [
        partial(
            train, folder / f"part-{k}", robot, arms,
            replace(plan, seeds=tuple(plan.seeds[i] for i in share), threads=1), note,
            first=[first[i % len(first)] for i in share if first],
        )
        for k, share in enumerate(shares)
    ]  # fmt: skip
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max(len(shares) - 1, 1), spawn, _hide_progress) as pool:
        futures = [pool.submit(training) for training in trainings[1:]]
        trained = [*trainings[0](), *(path for future in futures for path in future.result())]
    folders = {path.name: path for path in trained}
    return [folders[name] for name in agent_names(arms, plan.seeds)]


def _hide_progress() -> None:
    """Initialise a further process, whose progress bar is hidden."""
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - as long as the process
    torch.set_num_threads(1)


def agent_names(arms: Sequence[Arm], seeds: Sequence[int]) -> list[str]:
    """Names of the agents: all seeds of the first arm, then those of the next."""
    return [f"{arm.name}-{seed}" for arm in arms for seed in seeds]


def digest(draws: Draws) -> str:
    """SHA-256 of models and noise."""
    models = [(model.joints, model.body, model.effects) for model in draws.models]
    return hashlib.sha256(repr((models, draws.noise)).encode()).hexdigest()


def _write_run(folder: Path, content: dict[str, Any], note: dict[str, Any]) -> None:
    """Write ``run.json``, or check that an existing one is of the same run."""
    path = folder / "run.json"
    if path.exists():
        existing = read_json(path)
        if {k: existing.get(k) for k in content} != content:
            expected = "the same options and files, or a new folder"
            raise InputError(folder, "run.json", "another run", expected)
        return
    write_json(path, {**content, "provenance": note})


def _train(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    names: Sequence[str],
    first: Sequence[Path],
) -> None:
    S, A = len(plan.seeds), len(names)
    arm_of_agent = [arm for arm in arms for _ in plan.seeds]
    draws = [arm.draws for arm in arm_of_agent]
    world = make_world(
        robot, plan.task, draws, n_envs=A * plan.envs, fidelity=plan.fidelity, device=plan.device,
        cell_m=plan.cell_m, threads=plan.threads,
    )  # fmt: skip
    decisions = Decisions(world, plan.view)
    decisions_per_env = -(-plan.steps // plan.view.period)
    settings = replace(plan.settings, memory=min(plan.settings.memory, decisions_per_env))
    models = [make_sac(world, settings, plan.seeds[a % S], view=plan.view) for a in range(A)]
    for model, one in zip(models, draws, strict=True):
        model.trained_over = spread_of(one.models)
    if len(first) > S:
        raise InputError("train", "--first", f"{len(first)} policies", f"{S} at most, one a seed")
    for a, model in enumerate(models if first else []):
        start_from(model, first[a % S % len(first)])
    agents = Agents(models, settings, world.device)
    progress = load(folder, agents) or Progress(A)
    bar = tqdm(
        total=plan.steps, initial=progress.steps, desc="train", unit="step", disable=None,
        smoothing=0.05,
    )  # fmt: skip
    with bar, ThreadPoolExecutor(1) if plan.device == "cpu" else nullcontext() as pool:
        while progress.steps < plan.steps:
            end = min(progress.steps + plan.segment, plan.steps)
            _segment(
                decisions, agents, arm_of_agent, plan, progress, end, bar, pool, swims=bool(first)
            )
            save(folder, agents, progress, names)


def _segment(
    decisions: Decisions,
    agents: Agents,
    arms: Sequence[Arm],
    plan: Plan,
    progress: Progress,
    end: int,
    bar: Any,  # noqa: ANN401
    pool: Executor | None,
    *,
    swims: bool,
) -> None:
    """Train from one checkpoint to the next; with ``swims`` the first actions are not random."""
    A, n, settings, world = len(agents.models), plan.envs, plan.settings, decisions.world
    J = len(world.low)
    seed = int(np.random.SeedSequence([*plan.seeds, progress.steps]).generate_state(1)[0])
    world.seed(seed)
    torch.manual_seed(seed)
    observed = decisions.reset().view(A, n, -1)
    tally = Tally(A, n, world.device)
    noise = torch.randn(A, n, J, device=world.device)
    decay = math.exp(-plan.view.decision_s / settings.noise_s) if settings.noise_s > 0 else 0.0
    due, batch_steps = 0.0, n * plan.view.period
    _set_price(agents, arms, plan, progress)
    while progress.steps < end:
        fresh = torch.randn(noise.shape, device=world.device)
        noise = decay * noise + (1 - decay * decay) ** 0.5 * fresh
        if progress.steps < settings.warm_up and not swims:
            action = torch.erf(noise / 2**0.5)  # uniform between -1 and 1
        else:
            action = agents.act(observed, noise)
        if progress.steps >= settings.warm_up and agents.filled:
            agents.set_schedule(progress.steps / plan.steps, progress.grown)
            due += settings.updates_per_step * batch_steps
        decide = partial(decisions.step, action.view(A * n, J))
        step = _while(pool, decide, partial(agents.learn, int(due)))
        due -= int(due)
        gain = step.reward + world.task.energy * step.effort
        agents.remember(
            observed, action, gain.view(A, n), step.effort.view(A, n), step.final.view(A, n, -1),
            step.terminated.view(A, n),
        )  # fmt: skip
        observed = step.observation.view(A, n, -1)
        tally.add(step, world.task.waypoints)
        progress.steps += batch_steps
        bar.update(batch_steps)
        if tally.some() or progress.steps >= end:
            before = progress.noted()
            progress.note(tally.take(), agents)
            progress.grow(plan.grown, before)
            _set_price(agents, arms, plan, progress)
            bar.set_postfix_str(progress.summary())


def _while(pool: Executor | None, decide: Callable[[], Step], learn: Callable[[], None]) -> Step:
    """The step of ``decide``, in parallel with ``learn`` if there is a ``pool``."""
    if pool is None:
        step = decide()
        learn()
        return step
    deciding = pool.submit(decide)
    learn()
    return deciding.result()


def _set_price(agents: Agents, arms: Sequence[Arm], plan: Plan, progress: Progress) -> None:
    prices = [plan.price(arm, grown) for arm, grown in zip(arms, progress.grown, strict=True)]
    agents.price.copy_(torch.tensor(prices)[:, None])


class Tally:
    """Sums over finished episodes of each agent, on the device."""

    def __init__(self, A: int, n: int, device: torch.device) -> None:
        self._return = torch.zeros(A * n, device=device)
        self._length = torch.zeros(A * n, device=device)
        self._sums = torch.zeros(4, A, device=device)
        self._steps = 0

    def add(self, step: Step, waypoints: int) -> None:
        """Count one decision of every environment."""
        self._steps += 1
        self._return += step.reward
        self._length += 1
        ended = (step.terminated | step.truncated).float()
        won = ended * (step.reached >= waypoints)
        sums = torch.stack([ended, ended * self._return, won, ended * self._length])
        self._sums += sums.view(4, self._sums.shape[1], -1).sum(dim=2)
        self._return *= 1 - ended
        self._length *= 1 - ended

    def some(self, least: int = 50) -> bool:
        """Whether enough decisions were counted for a row of statistics."""
        return self._steps >= least

    def take(self) -> Tensor:
        """Episodes, mean return, share that arrived, mean length, shape (4, A); resets the sums."""
        sums = self._sums.cpu().clone()
        mean = sums[1:] / sums[:1]
        self._sums.zero_()
        self._steps = 0
        return torch.cat([sums[:1], mean])
