"""Exported policies against the one that was trained: NumPy, C and ONNX say what SB3 says."""

import argparse
import re

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO, SAC

from rl.commands.policies import export as run
from rl.deploy.export import c_header, policy_of, read_zip
from rl.deploy.policy import PolicyController, npz, read_npz
from rl.observer import observation_bounds
from sim2real.errors import InputError

LOW, HIGH = np.array([-0.8, -0.3, -1.1], np.float32), np.array([0.5, 0.9, 0.2], np.float32)


class Spaces(gymnasium.Env):
    def __init__(self, low=LOW, high=HIGH) -> None:
        bound = np.array(observation_bounds(3), dtype=np.float32)
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = spaces.Box(low, high, dtype=np.float32)


def agent_of(widths=(32, 32), env=None) -> SAC:
    """An untrained agent whose answers fill its range of actions."""
    network = {"net_arch": {"pi": list(widths), "qf": [8]}}
    options = {"policy_kwargs": network, "buffer_size": 1, "seed": 1, "device": "cpu"}
    agent = SAC("MlpPolicy", env or Spaces(), **options)
    generator = torch.Generator().manual_seed(2)
    with torch.no_grad():
        for parameter in agent.actor.parameters():
            sd = (2.0 / parameter.shape[1]) ** 0.5 if parameter.ndim == 2 else 0.2
            parameter.normal_(0.0, sd, generator=generator)
    return agent


@pytest.fixture(scope="module")
def observations() -> np.ndarray:
    spread = np.array([0.5, 0.5, 2, *[0.6] * 3, *[3] * 3, 2, 2])
    return (spread * np.random.default_rng(4).normal(size=(10_000, 11))).astype(np.float32)


@pytest.mark.parametrize("widths", [[256, 256], [5, 16, 7, 9], []])
def test_a_policy_says_what_stable_baselines3_says(observations, tmp_path, widths):
    agent = agent_of(widths)
    action, _ = agent.predict(observations, deterministic=True)
    spread = np.ptp(action, axis=0) / (HIGH - LOW)
    assert spread.min() > 0.5, "a test that sees little of the range shows little"
    (tmp_path / "policy.npz").write_bytes(npz(policy_of(agent)))
    answer = PolicyController(read_npz(tmp_path / "policy.npz")).act(observations)
    assert answer.dtype == np.float32
    assert np.abs(answer - action).max() < 1e-5


def test_actions_of_one_become_the_joints_angles(observations, tmp_path):
    """Agents made by ``rl.sac.sac`` act between -1 and 1 and say what that means."""
    agent = agent_of(env=Spaces(-np.ones(3, np.float32), np.ones(3, np.float32)))
    agent.joints, agent.joint_low, agent.joint_high = ["front", "middle", "tail"], LOW, HIGH
    agent.save(tmp_path / "policy.zip")
    policy = read_zip(tmp_path / "policy.zip")
    action, _ = agent.predict(observations, deterministic=True)
    assert policy.joints == ("front", "middle", "tail")
    assert policy.observation[3:5] == ("front.position_rad", "middle.position_rad")
    angle = LOW + (action + 1) / 2 * (HIGH - LOW)
    assert np.abs(PolicyController(policy).act(observations) - angle).max() < 1e-5


def test_the_header_tells_order_units_and_origin(tmp_path):
    agent_of().save(tmp_path / "agent.zip")
    text = c_header(read_zip(tmp_path / "agent.zip"))
    for told in (
        "observation[0]  surge_m_s (10)",
        "observation[10]  target_left_m (20)",
        "action[1]  j2, desired angle in rad, -0.3 to 0.9",
        "agent.zip, SHA-256",
    ):
        assert told in text
    assert "malloc" not in text
    assert max(map(len, text.splitlines())) < 200


def options_of(policy, out, formats=None, price=None) -> argparse.Namespace:
    return argparse.Namespace(policy=policy, out=out, format=formats, seed=0, price=price)


def test_the_command_writes_what_is_asked_for(tmp_path, capsys):
    agent_of().save(tmp_path / "agent.zip")
    assert run(options_of(tmp_path / "agent.zip", tmp_path / "p.npz", ["c", "npz", "c"])) == 0
    assert run(options_of(tmp_path / "agent.zip", tmp_path / "q.h")) == 0
    assert {file.name for file in tmp_path.iterdir()} == {"agent.zip", "p.npz", "p.h", "q.h"}
    assert len(read_npz(tmp_path / "p.npz").provenance["inputs"]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_a_price_of_energy_is_one_that_the_agent_learned_for(observations, tmp_path):
    agent = agent_of()
    agent.by_price = {"prices": 2.0, "column": np.full(32, 0.4, np.float32), "share": 0.0}
    agent.save(tmp_path / "agent.zip")
    agent_of().save(tmp_path / "one.zip")
    actions = [
        PolicyController(read_zip(tmp_path / "agent.zip", price=price)).act(observations)
        for price in (None, 1.0, 0.5, 2.0)
    ]
    assert np.array_equal(actions[0], actions[1])
    assert all(np.abs(action - actions[1]).max() > 0.01 for action in actions[2:])
    for file, price, expected in (
        ("agent", 2.1, "2.1, expected 0.5 to 2"),
        ("agent", float("nan"), "nan, expected 0.5 to 2"),
        ("one", 0.5, "0.5, expected 1, as in training"),
    ):
        with pytest.raises(InputError, match=re.escape(expected)):
            run(options_of(tmp_path / f"{file}.zip", tmp_path / "p.npz", price=price))
    assert not (tmp_path / "p.npz").exists()


def test_odd_zips_are_refused_and_nothing_is_written(tmp_path):
    file, other = tmp_path / "ppo.zip", tmp_path / "columns.zip"
    PPO("MlpPolicy", Spaces(), device="cpu").save(file)
    agent_of(env=Spaces(LOW[:2], HIGH[:2])).save(other)
    for one in (file, other):
        with pytest.raises(InputError) as refused:
            run(options_of(one, tmp_path / "out.npz", ["npz", "c"]))
        assert "\n" not in str(refused.value)
        assert str(one) in str(refused.value)
    assert not list(tmp_path.glob("out*"))


def test_a_format_that_fails_leaves_no_file_of_another(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "onnx", None)
    agent_of().save(tmp_path / "agent.zip")
    with pytest.raises(InputError, match="no package onnx"):
        run(options_of(tmp_path / "agent.zip", tmp_path / "out.npz", ["npz", "onnx"]))
    with pytest.raises(InputError, match="the ending '.txt'"):
        run(options_of(tmp_path / "agent.zip", tmp_path / "out.txt"))
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"schema": np.array("other/1")}, "schema"),
        ({"bias_1": None}, "bias_1"),
        ({"weight_1": np.zeros((32, 31), np.float32)}, "weight_1"),
        ({"weight_0": None}, "weight_"),
        ({"low_rad": np.zeros(2, np.float32)}, "low_rad"),
        ({"joints": np.array(["a", "b"])}, "joints"),
        ({"bias_0": np.full(32, np.nan, np.float32)}, "finite"),
        ({"bias_0": np.full(32, 1e300)}, "finite"),
        ({"observation": np.array(["x"] * 10)}, "observation"),
        ({"view": np.array('{"period": 0}')}, "a view"),
        ({"view": None}, "view"),
        ({"provenance": np.array("{")}, "an invalid array"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, change, told):
    file = tmp_path / "policy.npz"
    file.write_bytes(npz(policy_of(agent_of())))
    with np.load(file) as stored:
        content = {**stored, **change}
    np.savez(file, **{name: array for name, array in content.items() if array is not None})
    with pytest.raises(InputError, match=told):
        read_npz(file)
