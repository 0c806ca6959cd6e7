"""The environments: what their users' own checkers say, and that no rows are swapped."""

import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import gymnasium.utils.env_checker
import gymnasium.wrappers.vector
import numpy as np
import pytest
import stable_baselines3
import stable_baselines3.common.env_checker
import stable_baselines3.common.monitor
import torch
from gymnasium.vector import AutoresetMode

import rl  # noqa: F401 - it registers sim2real/Fish-v0
from rl.env import FishEnv, FishVectorEnv
from rl.make import FISH
from rl.observer import PAPER, View
from rl.task import TASKS, Task
from rl.vec_env import FishVecEnv
from rl.world import Draws, Noise
from sim2real.errors import InputError


@pytest.mark.parametrize("view", [View(), PAPER])
def test_both_checkers_pass_without_a_warning(world_of, view):
    env = FishEnv(world_of(1), view)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.utils.env_checker.check_env(env, skip_render_check=True)
        stable_baselines3.common.env_checker.check_env(env)


def test_the_registered_environment_passes_too():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("sim2real/Fish-v0", render_mode="rgb_array")
        gymnasium.utils.env_checker.check_env(env.unwrapped)
        stable_baselines3.common.env_checker.check_env(env)
    picture = env.render()
    assert picture.shape[2] == 3 and picture.dtype == np.uint8
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10, "there is something to see"


@pytest.mark.parametrize("view", [View(), PAPER])
def test_actions_of_any_type_are_cast_and_clipped(view):
    env = gymnasium.make("sim2real:sim2real/Fish-v0", view=view).unwrapped
    seen = []
    for action in ([3.0, -2, 0.1], np.array([1.0, -1.0, 0.1])):
        env.reset(seed=4)
        seen.append(env.step(action)[0])
    assert np.array_equal(*seen)
    several = gymnasium.make_vec("sim2real/Fish-v0", num_envs=2, view=view)
    several.reset(seed=4)
    steps = several.step([[9, -9, 0.1], [1.0, -1, 0.1]])
    assert np.abs(steps[0][:, -3:]).max() <= (1.0 if view.memory else 20.0)


def test_weights_of_the_reward_are_options():
    options = {"energy_weight": 0.2, "reward": {"approach": 1.0, "energy": 5.0}}
    task = gymnasium.make("sim2real/Fish-v0", task=TASKS["turn"], **options).unwrapped.world.task
    assert (task.name, task.approach, task.energy, task.bonus) == ("turn", 1.0, 0.2, 10.0)
    for wrong in ({"reward": {"speed": 1.0}}, {"energy_weight": -1.0}, {"reward": {"bonus": "x"}}):
        with pytest.raises(InputError, match=r"speed|weight of (energy|bonus)"):
            gymnasium.make("sim2real/Fish-v0", **wrong)


@pytest.mark.parametrize("view", [View(), PAPER])
def test_a_film_runs_at_the_speed_of_the_robot(world_of, view):
    """A picture a step: what it is shown for is what the step takes."""
    env = FishEnv(world_of(1), view, render_mode="rgb_array")
    env.reset(seed=0)
    before = float(env.world.simulator.live().clock.numpy()[0])
    env.step(np.zeros(3, dtype=np.float32))
    took = float(env.world.simulator.live().clock.numpy()[0]) - before
    assert 1 / env.metadata["render_fps"] == pytest.approx(took, rel=1e-4)


def test_a_window_shows_the_pool(monkeypatch):
    """SDL's driver without a screen, so that it needs none."""
    pygame = pytest.importorskip("pygame", reason="the extra 'render' is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        seen = gymnasium.make("sim2real/Fish-v0", render_mode="human")
        seen.reset(seed=3)
        seen.step(np.full(3, 0.5, dtype=np.float32))
    pixels = np.swapaxes(pygame.surfarray.array3d(pygame.display.get_surface()), 0, 1)
    drawn = gymnasium.make("sim2real/Fish-v0", render_mode="rgb_array")
    drawn.reset(seed=3)
    drawn.step(np.full(3, 0.5, dtype=np.float32))
    assert np.array_equal(pixels, drawn.render())
    seen.close()


def test_a_window_without_pygame_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(InputError, match=r"sim2real\[render\]"):
        gymnasium.make("sim2real/Fish-v0", render_mode="human")


def test_the_terms_of_the_reward_add_up_to_it(world_of):
    """In all three environments; arriving and leaving stand in the bonus alone."""
    names = {"reward_progress", "reward_bonus", "reward_energy"}

    def placed(rng: np.random.Generator, n: int, J: int):
        pose = np.zeros((n, 3))
        pose[1, 0] = 1.81
        return pose, np.zeros((n, J)), np.tile([[0.02, 0.0]], (n, 1, 1))

    one = FishEnv(world_of(1, "near"))
    one.reset(seed=2)
    for _ in range(5):
        _, reward, _, _, info = one.step(np.array([0.9, -0.9, 0.9], dtype=np.float32))
        assert sum(info[name] for name in names) == pytest.approx(reward, abs=1e-5)
    assert info["reward_energy"] < 0
    effort = -info["reward_energy"] / one.world.task.energy
    assert effort > 0 and info["reward_bonus"] == 0

    several = FishVectorEnv(world_of(2, Task("placed", placed)))
    several.reset()
    _, rewards, terminated, _, infos = several.step(np.zeros((2, 3), dtype=np.float32))
    assert terminated.all()
    assert np.allclose(sum(infos[name] for name in names), rewards, atol=1e-5)
    assert infos["reward_bonus"].tolist() == [10.0, -10.0]
    assert infos["is_success"].tolist() == [True, False]

    theirs = FishVecEnv(world_of(2, Task("placed", placed)))
    theirs.reset()
    _, rewards, _, told = theirs.step(np.zeros((2, 3), dtype=np.float32))
    sums = [sum(info[name] for name in names) for info in told]
    assert np.allclose(sums, rewards, atol=1e-5)
    assert [info["is_success"] for info in told] == [True, False]


def test_stable_baselines_logs_the_success_rate(world_of):
    """Its own logger reads ``is_success`` where an episode ends, from one environment or many."""
    task = replace(TASKS["near"], steps=8)
    one = stable_baselines3.common.monitor.Monitor(FishEnv(world_of(1, task)))
    for env in (one, FishVecEnv(world_of(3, task))):
        agent = stable_baselines3.SAC("MlpPolicy", env, learning_starts=1000)
        agent.learn(12)
        assert len(agent.ep_success_buffer) > 0


def test_an_episode_begins_once(world_of):
    """The step that ends one draws no other: that is for ``reset`` to do."""
    env = FishEnv(world_of(1, replace(TASKS["near"], steps=12)))
    env.reset(seed=5)
    target = env.world.targets.clone()
    ends = [env.step(np.zeros(3, dtype=np.float32))[3] for _ in range(3)]
    assert ends == [False, False, True]
    assert torch.equal(env.world.targets, target)
    env.reset()
    assert not torch.equal(env.world.targets, target)


def test_a_batch_by_make_vec_is_gymnasiums_vector_environment():
    envs = gymnasium.make_vec("sim2real/Fish-v0", num_envs=3, task="near")
    assert envs.unwrapped.world.n_envs == 3
    first, _ = envs.reset(seed=1)
    again, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(first)
    assert np.array_equal(first, again)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP, "Gymnasium's default"
    envs = gymnasium.make_vec(
        "sim2real/Fish-v0", num_envs=3, task="near", autoreset_mode=AutoresetMode.SAME_STEP
    )
    envs.reset(seed=1)
    envs.unwrapped.world.elapsed[1] = TASKS["near"].steps - 1
    seen, reward, _, truncated, infos = envs.step(envs.action_space.sample())
    assert truncated.tolist() == [False, True, False]
    assert infos["_final_obs"].tolist() == [False, True, False]
    assert reward.shape == (3,)
    assert not np.array_equal(infos["final_obs"][1], seen[1])
    with pytest.raises(InputError, match="pentagram"):
        gymnasium.make_vec("sim2real/Fish-v0", num_envs=2, task="somersault")


def test_the_next_step_begins_the_next_episode(world_of):
    """As Gymnasium's own vector environments: no action, no reward, the first observation."""
    task = replace(TASKS["near"], steps=12)
    envs, same = (
        FishVectorEnv(world_of(3, task, seed=7), autoreset_mode=mode)
        for mode in ("NextStep", "SameStep")
    )
    envs.reset(), same.reset()
    envs.world.elapsed[1] = same.world.elapsed[1] = 8
    action = np.full((3, 3), 0.3, dtype=np.float32)
    last, _, _, late, _ = envs.step(action)
    begun, _, _, also, told = same.step(action)
    assert late.tolist() == also.tolist() == [False, True, False]
    assert np.array_equal(last[1], told["final_obs"][1])
    assert np.array_equal(last[[0, 2]], begun[[0, 2]])
    target = envs.world.targets.clone()
    first, rewards, _, late, infos = envs.step(action)
    moved = (envs.world.targets != target).any(dim=(1, 2)).tolist()
    assert moved == [False, True, False], "one robot begins anew"
    assert rewards[1] == 0 and rewards[0] != 0
    assert not late.any()
    assert infos["_reached"].tolist() == [True, False, True]
    assert envs.world.elapsed.tolist() == [8, 0, 8]
    assert np.allclose(first[1, 3:6], envs.decisions.observer.observe(envs.world._last)[1, 3:6])
    with pytest.raises(ValueError, match="Disabled"):
        FishVectorEnv(world_of(1), autoreset_mode="Disabled")


def test_the_docs_count_the_columns(world_of):
    """What the how-to says of the observation's size is what the environment has."""
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "gymnasium.md").read_text()
    told = [int(count) for count in re.findall(r"(\d+) columns", page)]
    sizes = [FishEnv(world_of(1), view).observation_space.shape[0] for view in (View(), PAPER)]
    assert told == sizes
    assert f"{1000 * View().decision_s:.0f} ms" in page


def test_the_fish_of_the_package_is_that_of_the_shipped_swims():
    data = FISH.parents[1] / "datasets" / "pool"
    for ours, theirs in (
        ("robot.toml",) * 2,
        ("ranges.json",) * 2,
        ("model.json", "calibrated.json"),
    ):
        assert (FISH / ours).read_bytes() == (data / theirs).read_bytes()


def marked(rng: np.random.Generator, n: int, J: int):
    """Every episode at rest with a target that no other has."""
    pose = np.column_stack([rng.uniform(-1, 1, (n, 2)), rng.uniform(-3, 3, n)])
    return pose, np.zeros((n, J)), rng.uniform(-1, 1, (n, 1, 2))


def test_no_row_is_swapped_at_resets(world_of):
    """64 robots that end at different times keep their own targets, clocks and observations."""
    task = Task("marked", marked, steps=7)
    env = FishVecEnv(world_of(64, task), PAPER)
    env.reset()
    world = env.world
    stagger = torch.arange(64) % 7
    world.elapsed[:] = stagger
    action = np.linspace(-0.5, 0.5, 64 * 3, dtype=np.float32).reshape(64, 3)
    for n in range(1, 15):
        before = world.targets.clone()
        seen, _, ended, infos = env.step(action)
        expected = ((stagger.numpy() + n) % 7) == 0
        assert np.array_equal(ended, expected)
        moved = (world.targets != before).any(dim=(1, 2)).numpy()
        assert np.array_equal(moved, expected), "only those that ended have another target"
        own = world._observed().numpy()
        assert np.array_equal(seen, own)
        for e in range(64):
            assert ("terminal_observation" in infos[e]) == bool(expected[e])
            assert infos[e].get("TimeLimit.truncated", False) == bool(expected[e])
        still = np.abs(seen[expected][:, 3:6])
        assert not still.size or still.max() < 1e-6, "a robot begins straight"


def test_reward_is_the_papers(world_of):
    world = world_of(8, "point")
    before = torch.linalg.vector_norm(world.targets[:, 0] - world.pose[:, :2], dim=1)
    step = world.step(torch.full((8, 3), 0.4))
    after = torch.linalg.vector_norm(world.targets[:, 0] - world.pose[:, :2], dim=1)
    expected = 10 * (before - after) - 0.001 * (world.rate**2).sum(dim=1)
    assert torch.allclose(step.reward, expected, atol=1e-5)


def test_waypoints_follow_one_another(world_of):
    world = world_of(1, "pentagram")
    first = world.targets[:, 0].clone()
    world.targets[0, 0] = world.pose[0, :2]
    step = world.step(torch.zeros(1, 3))
    assert world.waypoint.tolist() == [1]
    assert not step.terminated.any()
    assert not torch.equal(world.targets[:, 0], first)


def test_noise_has_the_size_asked_for(world_of, model):
    noise = Noise(position_m=0.02, yaw_rad=0.05, joint_rad=(0.01, 0.02, 0.03))
    world = world_of(4000, "near", Draws((model,), noise))
    error = world._past[:, -1] - torch.cat([world.pose, world.joint], dim=1)
    expected = [0.02, 0.02, 0.05, 0.01, 0.02, 0.03]
    assert np.allclose(error.std(dim=0).numpy(), expected, rtol=0.06)


def test_mixed_targets_are_near_as_often_as_far_and_all_in_the_pool():
    pose, _, target = TASKS["mixed"].place(np.random.default_rng(3), 4_000, 3)
    away = np.hypot(*(target[:, 0] - pose[:, :2]).T)
    assert away.min() > 0.12 - 1e-9
    assert away.max() < 2.0
    assert np.median(away) == pytest.approx(np.sqrt(0.12 * 2.0), rel=0.05)
    assert np.abs(np.concatenate([pose[:, :2], target[:, 0]])).max() <= 1.4


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_a_fidelity_that_there_is_not_is_refused(make):
    with pytest.raises(InputError, match=r"fidelity: found 'real', expected one of twin, fluid"):
        make("sim2real/Fish-v0", fidelity="real")
