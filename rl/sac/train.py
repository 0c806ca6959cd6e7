"""Training of several agents in one world, resumable at any moment.

On a CPU the next decision is simulated while agents learn. Every ``segment`` steps a checkpoint is
written and all episodes restart, with seeds of the run and the segment only: a run that was killed
resumes exactly from its last checkpoint.
"""

import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from rl.make import Fidelity, digest, episodes_of, make_world, own_stream, spread_of
from rl.sac import plan as plans
from rl.sac.agents import Agents
from rl.sac.checkpoint import COLUMNS, Progress, load, save, save_policies
from rl.sac.plan import OPTIONS, Arm, Plan, plan_of
from rl.sac.sac import make_sac, read_agent, start_from
from rl.world import Decisions, Draws, Step
from sim2real.errors import InputError
from sim2real.output import provenance, sha256_of, write_json
from sim2real.robot import Robot
from sim2real.structured import finite_number, read_json

QUICK: dict[str, Any] = {"task": "near", "energy_weight": 2e-4, **plans.QUICK}
"""Settings of ``train --quick``. At the weight of the default recipe some seeds swim so sparingly
that they reach few near targets within the time limit of 10 s."""
ACCEPTED = (*OPTIONS, "first")
"""Options of the command ``train`` that ``train_run`` accepts."""
Report = Callable[[str, dict[str, float]], None]
"""What is called while agents learn: with an agent's name and its newest row of progress."""


def train_run(
    folder: Path,
    *,
    robot: str,
    model: str,
    ranges: str | None = None,
    seeds: Sequence[int] = (0,),
    first: Sequence[str] = (),
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 1,
    report: Report | None = None,
    **options: Any,  # noqa: ANN401
) -> list[Path]:
    """Train one arm from files and JSON ``options`` of ``plan_of``; the folders of the agents.

    With several seeds on a CPU, which are trained in several processes, ``report`` must be a
    picklable function.
    """
    plan = plan_of(
        options, seeds=tuple(seeds), fidelity=fidelity, device=device, cell_m=cell_m,
        threads=threads,
    )  # fmt: skip
    fish, draws, inputs = episodes_of(robot, model, ranges)
    trainer = train_in_parts if device == "cpu" and len(seeds) > 1 else train
    note, policies = provenance([*inputs, *first], None), [Path(path) for path in first]
    return trainer(folder, fish, [Arm("policy", draws)], plan, note, first=policies, report=report)


def train(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    note: dict[str, Any] | None = None,
    *,
    first: Sequence[Path] = (),
    report: Report | None = None,
) -> list[Path]:
    """Train an agent for each arm and seed, all in one batch of robots.

    The folder gets ``run.json`` with ``note``, the provenance, ``checkpoint.npz`` and, for each
    agent, ``ARM-SEED/policy.zip``, ``progress.csv`` and ``policy-STEPS.zip`` of earlier stages.
    ``first`` are policies to continue from, assigned to the seeds of every arm in turn, without
    replay memories. Returned are the agents' folders: all seeds of the first arm, then those of the
    next. A folder of the same run with fewer steps is continued; its schedules are those of the
    longer run from there on. ``report`` gets every new row, see ``train_run``.
    """
    names = agent_names(arms, plan.seeds)
    digests = [digest_of(arm.draws) for arm in arms]
    content = {"plan": plan.content(), "agents": names, "draws": digests}
    for path in first:
        read_agent(path)  # refused, if at all, before anything is written
    if first:
        content["first"] = [sha256_of(path) for path in first]
    check_run(folder, content, note or {})
    with own_stream(plan.device):
        Training(folder, robot, arms, plan, first, report).run()
    return [folder / name for name in names]


def train_in_parts(
    folder: Path,
    robot: Robot,
    arms: Sequence[Arm],
    plan: Plan,
    note: dict[str, Any] | None = None,
    *,
    first: Sequence[Path] = (),
    report: Report | None = None,
) -> list[Path]:
    """Train as ``train`` does in two processes, with every second seed: ``part-0``, ``part-1``.

    With one robot per agent each seed is a part of its own, as batches then save no time.
    """
    parts = len(plan.seeds) if plan.envs == 1 else min(2, len(plan.seeds))
    shares = [range(k, len(plan.seeds), parts) for k in range(parts)]
    trainings = [
        partial(
            train, folder / f"part-{k}", robot, arms,
            replace(plan, seeds=tuple(plan.seeds[i] for i in share), threads=1), note,
            first=[first[i % len(first)] for i in share if first], report=report,
        )
        for k, share in enumerate(shares)
    ]  # fmt: skip
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn, hide_progress) as pool:
        futures = [pool.submit(training) for training in trainings[1:]]
        trained = [*trainings[0](), *(path for future in futures for path in future.result())]
    folders = {path.name: path for path in trained}
    return [folders[name] for name in agent_names(arms, plan.seeds)]


def hide_progress() -> None:
    """Prepare a further process, whose progress bars are hidden."""
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - as long as the process
    torch.set_num_threads(1)


def agent_names(arms: Sequence[Arm], seeds: Sequence[int]) -> list[str]:
    """Names of the agents: all seeds of the first arm, then those of the next."""
    return [f"{arm.name}-{seed}" for arm in arms for seed in seeds]


def digest_of(draws: Draws) -> str:
    """SHA-256 of models and noise."""
    models = [(model.joints, model.body, model.effects) for model in draws.models]
    return digest((models, draws.noise))


def check_run(
    folder: Path, content: dict[str, Any], note: dict[str, Any], same: Sequence[str] = ()
) -> None:
    """Write ``run.json`` with content and provenance, or check that it is of the same run.

    A plan of more steps is of the same run, which is to be continued.
    """
    path = folder / "run.json"
    if not path.exists():
        write_json(path, {**content, "provenance": note})
        return
    existing = read_json(path)
    plan, before = content.get("plan"), existing.get("plan")
    if isinstance(plan, dict) and isinstance(before, dict):
        steps = finite_number(before.get("steps"))
        longer = steps is not None and steps < plan["steps"]
        if longer and {**before, "steps": 0} == {**plan, "steps": 0}:
            existing["plan"] = plan
    origin = existing.get("provenance")
    found = origin if isinstance(origin, dict) else {}
    differs = any(existing.get(k) != content[k] for k in content)
    if differs or any(found.get(k) != note[k] for k in same):
        expected = "the same options and files, or a new folder"
        raise InputError(folder, "run.json", "another run", expected)
    if plan != before:
        write_json(path, existing)


class Training:
    """Agents that learn in one world; arguments as of ``train``."""

    def __init__(
        self,
        folder: Path,
        robot: Robot,
        arms: Sequence[Arm],
        plan: Plan,
        first: Sequence[Path],
        report: Report | None,
    ) -> None:
        self.folder, self.plan, self.report = folder, plan, report
        self.names = agent_names(arms, plan.seeds)
        S, A, self.swims = len(plan.seeds), len(self.names), bool(first)
        if len(first) > S:
            found = f"{len(first)} policies"
            raise InputError("train", "--first", found, f"{S} at most, one a seed")
        arm_of_agent = [arm for arm in arms for _ in plan.seeds]
        self.world = make_world(
            robot, plan.task, [arm.draws for arm in arm_of_agent], n_envs=A * plan.envs,
            fidelity=plan.fidelity, device=plan.device, cell_m=plan.cell_m, threads=plan.threads,
        )  # fmt: skip
        self.decisions = Decisions(self.world, plan.view)
        decisions_per_env = -(-plan.steps // plan.view.period)
        settings = replace(plan.settings, memory=min(plan.settings.memory, decisions_per_env))
        models = []
        for a, arm in enumerate(arm_of_agent):
            models.append(make_sac(self.world, settings, plan.seeds[a % S], view=plan.view))
            models[a].trained_over = spread_of(arm.draws.models)
            if first:
                start_from(models[a], first[a % S % len(first)])
        self.agents = Agents(models, settings, self.world.device)
        self.progress = load(folder, self.agents) or Progress(A)
        self.bar = tqdm(
            total=plan.steps, initial=self.progress.steps, desc="train", unit="step", disable=None,
            smoothing=0.05,
        )  # fmt: skip

    def run(self) -> None:
        """Train to the end of the plan, with a checkpoint after every segment."""
        plan = self.plan
        # of a single robot in the twin the hand-over to a thread takes longer than the simulation
        beside = plan.device == "cpu" and (plan.envs > 1 or plan.fidelity == "fluid")
        quick = torch.inference_mode(plan.device == "cpu")  # less work for each small tensor
        with self.bar, quick, ThreadPoolExecutor(1) if beside else nullcontext() as pool:
            while self.progress.steps < plan.steps:
                self._segment(pool)
                save(self.folder, self.agents, self.progress, self.names)

    def _segment(self, pool: Executor | None) -> None:
        """Train until the next checkpoint."""
        plan, agents, progress, world = self.plan, self.agents, self.progress, self.world
        A, n, settings, J = len(self.names), plan.envs, plan.settings, len(world.low)
        end = min(progress.steps + plan.segment, plan.steps)
        seed = int(np.random.SeedSequence([*plan.seeds, progress.steps]).generate_state(1)[0])
        world.seed(seed)
        torch.manual_seed(seed)
        observed = self.decisions.reset().view(A, n, -1)
        tally = Tally(A, n, world.device)
        noise = torch.randn(A, n, J, device=world.device)
        decay = math.exp(-plan.view.decision_s / settings.noise_s) if settings.noise_s > 0 else 0.0
        due, batch_steps = 0.0, n * plan.view.period
        self._set_prices()
        while progress.steps < end:
            fresh = torch.randn(noise.shape, device=world.device)
            noise = decay * noise + (1 - decay * decay) ** 0.5 * fresh
            if progress.steps < settings.warm_up and not self.swims:
                action = torch.erf(noise / 2**0.5)  # uniform between -1 and 1
            else:
                action = agents.act(observed, noise)
            if progress.steps >= settings.warm_up and agents.filled:
                agents.set_schedule(progress.steps / plan.steps, progress.grown)
                due += settings.updates_per_step * batch_steps
            decision = action.view(A * n, J)
            if pool is None:
                step = self.decisions.step(decision)
                agents.learn(int(due))
            else:
                deciding = pool.submit(torch.inference_mode()(self.decisions.step), decision)
                agents.learn(int(due))
                step = deciding.result()
            due -= int(due)
            gain = step.reward + world.task.energy * step.effort
            agents.remember(
                observed, action, gain.view(A, n), step.effort.view(A, n),
                step.final.view(A, n, -1), step.terminated.view(A, n),
            )  # fmt: skip
            observed = step.observation.view(A, n, -1)
            tally.add(step, world.task.waypoints)
            progress.steps += batch_steps
            self.bar.update(batch_steps)
            if (tally.steps + 1) * n > 1000 or progress.steps >= end:  # decisions of a row
                progress.note(tally.take(), agents, plan)
                self._noted()
                self._set_prices()
                self.bar.set_postfix_str(progress.summary())

    def _noted(self) -> None:
        """Report the newest rows; keep the policies at the end of a stage."""
        progress, plan = self.progress, self.plan
        if self.report is not None:
            for name, rows in zip(self.names, progress.rows, strict=True):
                self.report(name, dict(zip(COLUMNS, rows[-1], strict=True)))
        before = progress.rows[0][-2][0] if len(progress.rows[0]) > 1 else 0
        if any(before < share * plan.steps <= progress.steps for share in plan.kept):
            file = f"policy-{progress.steps}.zip"
            save_policies(self.folder, self.agents, progress, self.names, file)

    def _set_prices(self) -> None:
        prices = [self.plan.price(grown) for grown in self.progress.grown]
        self.agents.price.copy_(torch.tensor(prices)[:, None])


class Tally:
    """Sums over finished episodes of each agent, on the device."""

    def __init__(self, A: int, n: int, device: torch.device) -> None:
        self._return, self._length = torch.zeros(2, A * n, device=device).unbind(0)
        self._sums = torch.zeros(4, A, device=device)
        self.steps = 0

    def add(self, step: Step, waypoints: int) -> None:
        """Count one decision of every environment."""
        self.steps += 1
        self._return += step.reward
        self._length += 1
        ended = step.terminated | step.truncated
        if not ended.any():
            return
        ended = ended.float()
        won = ended * (step.reached >= waypoints)
        sums = torch.stack([ended, ended * self._return, won, ended * self._length])
        self._sums += sums.view(4, self._sums.shape[1], -1).sum(dim=2)
        self._return *= 1 - ended
        self._length *= 1 - ended

    def take(self) -> Tensor:
        """Episodes, mean return, share that arrived, mean length, shape (4, A); resets the sums."""
        sums = self._sums.cpu().clone()
        self._sums.zero_()
        self.steps = 0
        return torch.cat([sums[:1], sums[1:] / sums[:1]])
