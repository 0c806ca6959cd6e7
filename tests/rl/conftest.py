"""Small worlds on the twin."""

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="the extra 'rl' is not installed")

from rl.make import make_world  # noqa: E402
from rl.task import TASKS, Task  # noqa: E402
from rl.world import Draws, World  # noqa: E402
from sim2real.model import Model, read_model  # noqa: E402
from sim2real.robot import Robot, read_robot  # noqa: E402

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"


@pytest.fixture(scope="session")
def robot() -> Robot:
    return read_robot(POOL / "robot.toml")


@pytest.fixture(scope="session")
def model() -> Model:
    return read_model(POOL / "model.json")


@pytest.fixture
def world_of(robot, model):
    """Makes a world of n robots at a task."""

    def make(n: int, task: str | Task = "near", draws: Draws | None = None, seed: int = 0) -> World:
        chosen = TASKS[task] if isinstance(task, str) else task
        return make_world(robot, chosen, draws or Draws((model,)), n_envs=n, seed=seed)

    return make
