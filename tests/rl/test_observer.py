"""The one observer: what it sees, and that all who deploy a policy see and do the same."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rl.deploy.export import c_header, policy_of, write_policy
from rl.deploy.policy import PolicyController, read_npz
from rl.observer import PAPER, Observer, View
from rl.sac.plan import Settings
from rl.sac.sac import make_sac
from rl.task import TASKS
from rl.world import Decisions, Draws, Noise

COMPILER = shutil.which("gcc") or shutil.which("cc")
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror")

MAIN = """
#include <stdio.h>
#include "policy.h"
int main(void) {
    float gone, observation[11], action[3];
    static policy_memory memory;
    while (fread(&gone, sizeof gone, 1, stdin) == 1) {
        if (fread(observation, sizeof observation, 1, stdin) != 1) return 1;
        if (gone < 0) policy_begin(&memory, observation);
        policy(&memory, gone < 0 ? 1 : (int)gone, observation, action);
        if (fwrite(action, sizeof action, 1, stdout) != 1) return 1;
    }
    return 0;
}
"""

LOW, HIGH = np.full(3, -0.8, np.float32), np.array([0.8, 0.7, 0.8], np.float32)
VIEWS = [View(), PAPER, View(period=3, memory=3, scaled=False), View(1, False, 0, True, True)]


def seen_at(bearing: float, distance: float = 1.0) -> np.ndarray:
    """The task's columns of a robot at rest with a target there."""
    columns = np.zeros((1, 11), np.float32)
    columns[0, -2:] = distance * np.cos(bearing), distance * np.sin(bearing)
    return columns


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_numpy_and_pytorch_see_the_same(view):
    rng, E = np.random.default_rng(0), 40
    one = Observer(view, LOW, HIGH, E)
    other = Observer(view, torch.tensor(LOW), torch.tensor(HIGH), E)
    raw = rng.normal(size=(E, 11)).astype(np.float32)
    one.begin(raw)
    other.begin(torch.tensor(raw))
    for _ in range(30):
        raw = (raw + 0.3 * rng.normal(size=raw.shape)).astype(np.float32)
        told = other.observe(torch.tensor(raw))
        columns = one.observe(raw)
        assert columns.shape == (E, view.size(3))
        assert columns.dtype == np.float32
        assert columns == pytest.approx(told.numpy(), abs=1e-5)
        action = np.tanh(rng.normal(size=(E, 3))).astype(np.float32)
        one.decide(action)
        other.decide(torch.tensor(action))
        tick = int(rng.integers(view.period))
        set_points = other.set_points(tick).numpy()
        assert one.set_points(tick) == pytest.approx(set_points, abs=1e-6)


def test_the_bearing_keeps_its_side_until_far_round():
    view = View()
    column = 3 + 2 * 3 + 3
    observer = Observer(view, LOW, HIGH, 1)
    observer.begin(seen_at(2.5))
    told = [
        np.pi * observer.observe(seen_at(b))[0, column] for b in (3.0, 3.3, 3.9, 4.0, -3.0, 3.3)
    ]
    # on the left over half a turn; beyond 225 degrees it has changed its side, and keeps that
    assert told == pytest.approx([3.0, 3.3, 3.9, 4.0 - 2 * np.pi, -3.0, 3.3 - 2 * np.pi], abs=1e-5)


def test_a_stroke_keeps_its_side_and_decisions_are_remembered():
    view = View()
    side, first = 3 + 2 * 3 + 4, 3 + 2 * 3 + 5
    observer = Observer(view, LOW, HIGH, 1)
    observer.begin(seen_at(-1.0))
    assert observer.observe(seen_at(-1.0))[0, side] == -1, "at first the target's"
    for mean, expected in ((0.1, -1), (0.4, 1), (0.0, 1), (-0.4, -1)):
        observer.decide(np.full((1, 3), mean, np.float32))
        columns = observer.observe(seen_at(-1.0))[0]
        assert columns[side] == expected
        assert columns[first] == np.float32(mean)
    assert columns[first + 3] == 0.0


def test_set_points_go_on_a_line_from_where_the_joints_are():
    observer = Observer(View(), LOW, HIGH, 1)
    start = seen_at(0.0)
    start[0, 3:6] = 0.4, 0.3, -0.2
    observer.begin(start)
    observer.decide(np.array([[1.0, -1.0, 0.0]], np.float32))
    line = np.array([observer.set_points(tick)[0] for tick in range(4)])
    goal = np.array([0.8, -0.8, 0.0])
    expected = start[0, 3:6] + (goal - start[0, 3:6]) * np.arange(1, 5)[:, None] / 4
    assert line == pytest.approx(expected, abs=1e-6)


NETWORKS = [(VIEWS[0], (24, 24)), (PAPER, (24, 7, 16)), (PAPER, ())]
"""Views and hidden layers."""


@pytest.fixture(scope="module", params=NETWORKS, ids=str)
def trained(request, robot, model):
    """An agent that moves a lot, as a policy."""
    from rl.make import make_world

    view, hidden = request.param
    world = make_world(robot, TASKS["near"], Draws((model,)), n_envs=1)
    agent = make_sac(world, Settings(hidden=hidden), 3, view=view)
    with torch.no_grad():
        for parameter in agent.actor.parameters():
            parameter.mul_(2.0)
    return agent, policy_of(agent)


@pytest.mark.parametrize("trained", [NETWORKS[0], (PAPER, (24, 24))], indirect=True, ids=str)
def test_a_policy_does_in_training_what_it_does_outside(trained, world_of, model):
    """Decisions on the device, and NumPy at 50 Hz, on one noisy swim."""
    agent, policy = trained
    noise = Draws((model,), Noise(0.002, 0.01, (0.003,)))
    task = replace(TASKS["chain"], steps=400)
    decisions = Decisions(world_of(4, task, noise, seed=2), policy.view)
    outside = world_of(4, task, noise, seed=2)
    for one in (decisions.world, outside):
        one.seed(5)
    columns = decisions.reset()
    seen = outside.reset()
    controller = PolicyController(policy)
    for _ in range(400 // policy.view.period):
        with torch.no_grad():
            action = agent.actor(columns, deterministic=True)
        step = decisions.step(action, begin=False)
        gained = torch.zeros(4)
        for _ in range(policy.view.period):
            told = outside.step(torch.from_numpy(controller.act(seen.numpy())), begin=False)
            seen = told.observation
            gained += told.reward
        assert torch.allclose(outside.pose, decisions.world.pose, atol=1e-3)
        assert torch.allclose(step.reward, gained, atol=1e-2)
        columns = step.observation
    assert float((outside.joint.abs()).max()) > 0.05


SWUM_STEPS = 1200


@pytest.fixture(scope="module")
def swum(trained, robot, model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A swim of 24 s through latency with every tenth frame lost: what was seen, gone, sent."""
    from rl.make import make_world

    _, policy = trained
    task = replace(TASKS["pentagram"], steps=SWUM_STEPS)
    world = make_world(robot, task, Draws((model,), Noise(0.002, 0.01, (0.003,))), n_envs=1)
    controller, rng = PolicyController(policy), np.random.default_rng(0)
    seen, gone = world.reset(), -1
    rows, waits, sent = [], [], []
    for _ in range(SWUM_STEPS):
        if gone < 0 or rng.random() > 0.1:
            rows.append(seen[0].numpy())
            waits.append(gone)
            sent.append(controller.act(seen.numpy(), max(gone, 1))[0])
            gone = 0
        seen = world.step(torch.from_numpy(sent[-1])[None], begin=False).observation
        gone += 1
    return np.array(rows), np.array(waits, dtype=np.float32), np.array(sent)


def answered_in_c(folder: Path, gone: np.ndarray, observations: np.ndarray) -> np.ndarray:
    """What the header in ``folder`` answers; -1 periods gone begin a swim."""
    (folder / "main.c").write_text(MAIN)
    program = folder / "main"
    built = [COMPILER, *FLAGS, str(folder / "main.c"), "-o", str(program), "-lm"]
    subprocess.run(built, check=True, capture_output=True, text=True)
    sent = np.column_stack([gone, observations]).astype(np.float32).tobytes()
    told = subprocess.run([program], input=sent, capture_output=True, check=True)
    return np.frombuffer(told.stdout, dtype=np.float32).reshape(-1, 3)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_npz_and_c_agree_on_a_swim_with_lost_frames(trained, swum, tmp_path):
    _, policy = trained
    rows, gone, sent = swum
    assert np.ptp(sent, axis=0).min() > 0.1
    write_policy(policy, tmp_path / "policy.npz", ("npz",))
    again = PolicyController(read_npz(tmp_path / "policy.npz"))
    told = [again.act(row[None], max(int(k), 1))[0] for row, k in zip(rows, gone, strict=True)]
    assert np.array_equal(np.array(told), sent)
    (tmp_path / "policy.h").write_text(c_header(policy))
    assert np.abs(answered_in_c(tmp_path, gone, rows) - sent).max() < 1e-5


def test_onnx_agrees_on_a_swim_with_lost_frames(trained, swum, tmp_path):
    """Called where a decision is due; what is sent is its line, from where the lost frames left."""
    pytest.importorskip("onnx", reason="the extra 'onnx' is not installed")
    from onnx.reference import ReferenceEvaluator

    _, policy = trained
    rows, gone, sent = swum
    assert (gone > 1).sum() > 100
    (file,) = write_policy(policy, tmp_path / "policy.npz", ("onnx",))
    graph, period = ReferenceEvaluator(str(file)), policy.view.period
    memory = np.zeros((1, max(policy.view.memory, 2) * 3 + 2), np.float32)
    told, since = [], 0
    for row, k in zip(rows, gone, strict=True):
        since = 0 if k < 0 else since + int(k)
        if k < 0 or since >= period:
            since %= period
            begin = np.full((1, 1), k < 0, np.float32)
            given = {"observation": row[None], "memory": memory, "begin": begin}
            line, memory = graph.run(None, given)
        told.append(line[0, since])
    assert np.abs(np.array(told) - sent).max() < 1e-5
