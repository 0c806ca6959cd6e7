"""How fast agents learn: updates a second beside Stable-Baselines3's own loop, steps a second.

    python benchmarks/train_speed.py [--device cuda:0] [--agents 1 3 15]

Run in one go, so that the ratios are of one machine in one state.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure

from rl.env import action_space, observation_space
from rl.make import make_world
from rl.observer import PAPER
from rl.sac.agents import PLAIN, Agents
from rl.sac.sac import make_sac
from rl.task import TASKS
from rl.world import Draws, World
from sim2real.model import read_model
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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--agents", type=int, nargs="+", default=[1])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    device = options.device
    torch.set_num_threads(1)
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
    for name, value in result.items():
        print(f"{name}: {value:.5g}")
    if options.out:
        options.out.write_text(json.dumps({"device": device, **result}, indent=2) + "\n")


if __name__ == "__main__":
    main()
