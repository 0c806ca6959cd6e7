"""The batched update against Stable-Baselines3's own, on the same batches and the same noise."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from rl.deploy.export import set_price
from rl.observer import PAPER, View
from rl.sac.agents import Agents, Batch, mirrored
from rl.sac.checkpoint import Progress, save
from rl.sac.plan import PLAIN, Settings
from rl.sac.sac import make_sac, read_agent
from rl.task import Task
from rl.world import Decisions
from sim2real.errors import InputError

SETTINGS = replace(PLAIN, hidden=(32, 24), memory=490, batch=64)


def batch_of(A: int, O: int, J: int, generator: torch.Generator, B: int = 64) -> Batch:  # noqa: E741
    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    done = (torch.rand(A, B, generator=generator) < 0.1).float()
    action = torch.tanh(normal(A, B, J))
    return Batch(normal(A, B, O), action, normal(A, B), normal(A, B, O), done)


def theirs(model: SAC, batches: list[Batch], noises: list, a: int, monkeypatch) -> None:
    """Stable-Baselines3's train() on given batches and noise."""
    for batch, noise in zip(batches, noises, strict=True):
        done, reward = batch.done[a][:, None], batch.reward[a][:, None]
        given = batch.observation[a], batch.action[a], batch.following[a], done, reward
        sample = MagicMock(return_value=ReplayBufferSamples(*given))
        model.replay_buffer, queue = SimpleNamespace(sample=sample), [noise[0][a], noise[1][a]]

        def drawn(self, *_: object, queue: list = queue) -> torch.Tensor:
            return self.mean + self.stddev * queue.pop(0)

        with monkeypatch.context() as patch:
            patch.setattr(torch.distributions.Normal, "rsample", drawn)
            model.train(gradient_steps=1, batch_size=64)
        assert not queue


@pytest.mark.parametrize("norm", [False, True])
def test_an_update_is_stable_baselines3s(world_of, monkeypatch, norm):
    """With layer normalization in the critics, too: there autograd is the reference."""
    world, generator = world_of(1), torch.Generator().manual_seed(3)
    settings = replace(SETTINGS, norm=norm, entropy_target=(-1.5, -1.5))
    references = [make_sac(world, settings, seed, view=PAPER) for seed in (0, 1, 2)]
    own = [make_sac(world, settings, seed, view=PAPER) for seed in (0, 1, 2)]
    agents = Agents(own, settings, torch.device("cpu"))
    batches = [batch_of(3, 11, 3, generator) for _ in range(20)]
    noises = [tuple(torch.randn(2, 3, 64, 3, generator=generator)) for _ in range(20)]
    logger = pytest.importorskip("stable_baselines3.common.logger")
    for a, reference in enumerate(references):
        reference.set_logger(logger.configure(None, []))
        theirs(reference, batches, noises, a, monkeypatch)
    for batch, noise in zip(batches, noises, strict=True):
        agents.update(batch, noise)
    moved = 0.0
    for a, reference in enumerate(references):
        fresh = make_sac(world, settings, a, view=PAPER)
        for name, value in reference.policy.state_dict().items():
            ours = own[a].policy.state_dict()[name]
            assert torch.allclose(ours, value, atol=1e-5, rtol=0), name
            moved = max(moved, float((value - fresh.policy.state_dict()[name]).abs().max()))
        assert torch.allclose(own[a].log_ent_coef, reference.log_ent_coef, atol=1e-5)
    assert moved > 1e-3, "twenty updates must have moved the parameters"


def test_memories_wrap_and_agents_draw_from_their_own(world_of):
    world = world_of(1)
    models = [make_sac(world, SETTINGS, seed, view=PAPER) for seed in (0, 1)]
    agents = Agents(models, SETTINGS, world.device)
    agents.price.fill_(0.5)
    for n in range(30):
        mark = torch.tensor([n + 0.0, 1000.0 + n])[:, None].expand(2, 20)
        agents.remember(
            torch.zeros(2, 20, 11), torch.zeros(2, 20, 3), mark + 3, torch.full((2, 20), 6.0),
            torch.zeros(2, 20, 11), mark < 0,
        )  # fmt: skip
    assert agents.filled == SETTINGS.memory
    assert agents.memory[0, :, 14].min() == 5 + 3, "the last 490, across the memory's end"
    drawn = agents._sample().reward
    assert drawn[0].min() >= 5
    assert drawn[0].max() < 30
    assert drawn[1].min() >= 1005
    agents.price.fill_(0.0)
    assert agents._sample().reward[0].min() >= 8, "energy is paid at the price of now"


@pytest.mark.parametrize("view", [View(), PAPER])
def test_a_mirrored_transition_is_what_the_mirrored_robot_does(world_of, view):
    """The world itself, left and right exchanged."""

    def placed(rng: np.random.Generator, n: int, J: int):
        pose = np.array([[0.1, 0.2, 0.3], [0.1, -0.2, -0.3]])
        target = np.array([[[0.6, 0.5]], [[0.6, -0.5]]])
        return pose, np.array([[0.1, -0.2, 0.3], [-0.1, 0.2, -0.3]]), target

    world = world_of(2, Task("placed", placed))
    decisions = Decisions(world, view)
    decisions.reset()
    F = view.size(3)
    odd = mirrored(view.odd(3), 3, world.device)
    assert odd[F : F + 6].tolist() == [1, 1, 1, 0, 0, *view.odd(3)[:1]]
    odd = odd[:F]
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = torch.tensor(rng.uniform(-0.7, 0.7, 3), dtype=torch.float32)
        step = decisions.step(torch.stack([action, -action]))
        left, right = step.observation
        assert torch.allclose(left * (1 - 2 * odd), right, atol=2e-4)
        assert torch.allclose(step.reward[0], step.reward[1], atol=1e-4)


def test_schedules_reach_the_updates(world_of):
    world = world_of(1)
    settings = Settings(hidden=(8, 8), memory=100, batch=16, rate=1e-2, rate_end=0.0)
    agents = Agents([make_sac(world, settings, 0, view=View())], settings, world.device)
    batch = batch_of(1, 1 + View().size(3), 3, torch.Generator().manual_seed(0), B=16)
    agents.set_schedule(0.5, [0.25])
    assert agents._rate.item() == pytest.approx(5e-3)
    assert agents._entropy.item() == pytest.approx(-3 * 1.375)
    agents.set_schedule(0.1, [0.25])  # no farther than the training has come
    assert agents._entropy.item() == pytest.approx(-3 * 1.15)
    agents.set_schedule(0.5, [0.25])
    before = agents.critic.flat.clone()
    agents.update(batch)
    moved = (agents.critic.flat - before).abs().max()
    assert moved == pytest.approx(5e-3, rel=0.01), "Adam's first step is the rate"
    agents.set_schedule(1.0, [1.0])
    kept = agents.critic.flat.clone()
    agents.update(batch)
    assert torch.equal(agents.critic.flat, kept)


def test_the_saved_actor_follows_the_one_that_learns(world_of):
    world = world_of(1)
    settings = Settings(hidden=(8, 8), memory=100, batch=16, average=0.25)
    model = make_sac(world, settings, 0, view=View())
    agents = Agents([model], settings, world.device)
    batch = batch_of(1, 1 + View().size(3), 3, torch.Generator().manual_seed(0), B=16)
    agents.update(batch)
    first = agents.actor.flat.clone()
    agents.update(batch)
    own = agents.actor.flat.clone()
    bias = model.actor.mu.bias.clone()
    with agents.averaged():
        assert torch.allclose(agents.actor.flat, 0.2 * first + 0.8 * own)
        assert not torch.equal(model.actor.mu.bias, bias)
    assert torch.equal(agents.actor.flat, own)
    assert torch.equal(model.actor.mu.bias, bias)


def test_rewards_are_paid_at_the_price_that_networks_are_told(world_of):
    world = world_of(1)
    settings = Settings(hidden=(8, 8), memory=100, batch=64, prices=3.0, mirror=False)
    agents = Agents([make_sac(world, settings, 0, view=View())], settings, world.device)
    F = View().size(3)
    agents.price.fill_(0.5)
    agents.remember(
        torch.zeros(1, 20, F), torch.zeros(1, 20, 3), torch.full((1, 20), 7.0),
        torch.full((1, 20), 4.0), torch.ones(1, 20, F), torch.zeros(1, 20),
    )  # fmt: skip
    drawn = agents._sample()
    share = drawn.observation[..., 0]
    assert share.min() < -0.8 < 0.8 < share.max()
    assert torch.equal(share, drawn.following[..., 0])
    assert torch.allclose(drawn.reward, 7 - 0.5 * 4 * 3.0**share)
    assert (drawn.following[..., 1:] == 1).all()


def test_a_saved_policy_swims_at_the_price_that_it_is_set_to(world_of, tmp_path):
    world = world_of(1)
    settings = Settings(hidden=(16, 8), memory=100, batch=16)
    models = [make_sac(world, settings, seed, view=View()) for seed in (0, 1)]
    agents = Agents(models, settings, world.device)
    for one in agents.actor.weights:  # what a training would have made of it
        one.add_(0.3 * torch.randn(one.shape, generator=torch.Generator().manual_seed(1)))
    agents.average.copy_(agents.actor.flat)
    save(tmp_path, agents, Progress(2), ["a", "b"])
    F = View().size(3)
    seen = torch.randn(7, F)
    for a, name in enumerate("ab"):
        loaded = read_agent(tmp_path / name / "policy.zip")
        for share in (0.0, -1.0, 0.6, 0.0):
            set_price(loaded, 2.0**share)
            action, _ = loaded.predict(seen.numpy(), deterministic=True)
            told = torch.cat([torch.full((7, 1), share), seen], dim=1)
            mean = agents.actor.forward(told.expand(2, 7, F + 1)).output[a, :, :3]
            assert np.allclose(action, torch.tanh(mean).numpy(), atol=1e-5), share
            loaded.save(tmp_path / "again.zip")
            loaded = read_agent(tmp_path / "again.zip")
        with pytest.raises(InputError, match=r"0\.5 to 2"):
            set_price(loaded, 2.1)
