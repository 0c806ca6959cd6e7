"""How fast agents learn: updates a second beside Stable-Baselines3's own loop, steps a second.

    python benchmarks/train_speed.py [--device cuda:0] [--agents 1 3 15]
    python benchmarks/train_speed.py --device cuda:0 --whole 0.02 0.01 --agents 1 5

Run in one go, so that the ratios are of one machine in one state. The second form times whole
trainings by the default recipe in the fluid, in cells of so many metres, with an update a step: two
of unlike length, whose difference leaves out what building and compiling cost.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure

from rl.env import action_space, observation_space
from rl.make import draws_of, make_world
from rl.observer import PAPER
from rl.sac.agents import Agents
from rl.sac.recipes import RECIPES
from rl.sac.sac import make_sac
from rl.sac.settings import PLAIN
from rl.sac.train import Arm, Plan, train
from rl.task import TASKS
from rl.world import Draws, World
from sim2real.model import read_model
from sim2real.ranges.entry import read_ranges
from sim2real.robot import read_robot

POOL = Path(__file__).parents[1] / "datasets" / "pool"


def rate(work: Callable[[int], None], device: str, seconds: float = 3.0) -> float:
    """Calls a second of ``work(n)``, warmed up."""
    work(10)
    n = 10
    while True:
        wait(device)
        start = time.perf_counter()
        work(n)
        wait(device)
        spent = time.perf_counter() - start
        if spent > seconds / 2:
            return n / spent
        n = int(n * min(20.0, seconds / max(spent, 1e-3)))


def wait(device: str) -> None:
    """Until the device has done what it was given."""
    if device != "cpu":
        torch.cuda.synchronize()


def world_of(n: int, device: str, fidelity: str, cell_m: float = 0.02) -> World:
    """A world of the shipped robot."""
    robot, model = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
    return make_world(
        robot, TASKS["point"], Draws((model,)), n_envs=n, device=device,
        fidelity=fidelity, cell_m=cell_m,  # type: ignore[arg-type]
    )  # fmt: skip


def ours(world: World, A: int, device: str) -> float:
    """Updates a second of each of A agents."""
    settings = replace(PLAIN, memory=100_000)
    models = [make_sac(world, settings, a, view=PAPER) for a in range(A)]
    agents = Agents(models, settings, world.device)
    O, J = agents.O, agents.J  # noqa: E741
    n = 5000
    made = [torch.randn(A, n, w, device=world.device) for w in (O, J, O)]
    zero = torch.zeros(A, n, device=world.device)
    agents.remember(made[0], torch.tanh(made[1]), zero, zero, made[2], zero)
    return rate(agents.learn, device)


def theirs(world: World, device: str) -> float:
    """Updates a second of Stable-Baselines3's own ``train``."""
    model = make_sac(world, PLAIN, 0, view=PAPER)
    model.policy.to(device)
    model.device = torch.device(device)
    model.log_ent_coef = torch.zeros(1, device=device, requires_grad=True)
    model.ent_coef_optimizer = torch.optim.Adam([model.log_ent_coef], lr=3e-4)
    model.set_logger(configure(None, []))
    buffer = ReplayBuffer(
        100_000, observation_space(world, PAPER), action_space(world), device=device
    )
    rng = np.random.default_rng(0)
    for _ in range(5000):
        seen, after = rng.normal(size=(2, 1, world.size))
        action = rng.uniform(-1, 1, (1, len(world.low)))
        buffer.add(seen, after, action, np.zeros(1), np.zeros(1), [{}])
    model.replay_buffer = buffer
    return rate(lambda n: model.train(n, 256), device)


def whole(device: str, cell_m: float, A: int, envs: int, steps: tuple[int, int]) -> float:
    """Steps a second of each of A agents that learn side by side in the fluid, an update a step."""
    robot, model = read_robot(POOL / "robot.toml"), read_model(POOL / "calibrated.json")
    draws = draws_of(model, read_ranges(POOL / "ranges.json"), robot, seed=0)
    recipe = RECIPES["default"]
    spent = []
    for n in (envs * 16, *steps):  # the first compiles
        settings = replace(recipe.settings, updates_per_step=1.0, warm_up=envs * 8)
        plan = Plan(
            TASKS[recipe.task], steps=n, envs=envs, segment=n, seeds=tuple(range(A)),
            fidelity="fluid", device=device, cell_m=cell_m, settings=settings, view=recipe.view,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            wait(device)
            start = time.perf_counter()
            train(Path(folder) / "run", robot, [Arm("speed", draws)], plan)
            wait(device)
            spent.append(time.perf_counter() - start)
    return (steps[1] - steps[0]) / (spent[2] - spent[1])


def times(options: argparse.Namespace) -> dict[str, float]:
    """Minutes that a million steps take, for each size of cells and number of agents."""
    result: dict[str, float] = {}
    for cell in options.whole:
        first = None
        for A in options.agents:
            each = whole(options.device, cell, A, options.envs, tuple(options.steps))
            name = f"{100 * cell:g} cm, {A} agents of {options.envs} robots"
            result[f"{name}: steps/s of each"] = each
            result[f"{name}: minutes for 1e6 steps"] = minutes = 1e6 / each / 60
            first = first or minutes
            result[f"{name}: times {options.agents[0]} agents"] = minutes / first
            print({k: round(v, 3) for k, v in result.items() if k.startswith(name)}, flush=True)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--agents", type=int, nargs="+", default=[1])
    parser.add_argument("--whole", type=float, nargs="+", metavar="M", default=[])
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--steps", type=int, nargs=2, default=(4096, 12288))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    result = times(options) if options.whole else parts(options)
    for name, value in result.items():
        print(f"{name}: {value:.5g}")
    if options.out:
        options.out.write_text(json.dumps({"device": options.device, **result}, indent=2) + "\n")


def parts(options: argparse.Namespace) -> dict[str, float]:
    """Updates beside Stable-Baselines3's, and steps of the twin."""
    device = options.device
    result: dict[str, float] = {}
    if device != "cpu":
        torch.cuda.set_stream(torch.cuda.Stream(device))
    world = world_of(64, device, "twin")
    action = torch.zeros(64, len(world.low), device=world.device)

    def swim(n: int) -> None:
        for _ in range(n):
            world.step(action)

    result["twin, 64 robots: steps/s"] = 64 * rate(swim, device)
    result["Stable-Baselines3: updates/s"] = theirs(world, device)
    for A in options.agents:
        each = ours(world, A, device)
        result[f"{A} agents side by side: updates/s of each"] = each
        result[f"{A} agents side by side: updates/s over theirs"] = (
            A * each / result["Stable-Baselines3: updates/s"]
        )
    return result


if __name__ == "__main__":
    main()
