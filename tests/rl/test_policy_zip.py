"""Policies from strangers: nothing in a file is executed, and what is wrong is told in a line."""

import base64
import hashlib
import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, SAC

from rl.controllers.discrete_cpg import TABLE, DiscreteCPGEnv, make_dqn, read_policy
from rl.deploy.export import read_zip, set_price
from rl.experiments.named import controller_of
from rl.observer import PAPER, View
from rl.sac.plan import Settings
from rl.sac.policy_zip import LARGEST_BYTES, read_policy_zip
from rl.sac.sac import make_sac, read_agent, start_from
from rl.vec_env import FishVecEnv
from sim2real.cli import main
from sim2real.errors import InputError

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
FILES = ["--robot", str(POOL / "robot.toml"), "--model", str(POOL / "calibrated.json")]
LIMITS = [(-0.8, 0.8)] * 3
SETTINGS = Settings(hidden=(16, 8), memory=10)


class Evil:
    """An object that makes a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def sac_of(world_of, view=View()):  # noqa: B008 - frozen
    agent = make_sac(world_of(1), SETTINGS, 0, view=view)
    agent.trained_over = {"j1.kp_Nm_per_rad": [0.5, 0.7]}
    column = np.linspace(-1, 1, 16).astype(np.float32) / 3
    agent.by_price = {"prices": 2.0, "column": column, "share": 0.0}
    return agent


def dqn_of(world_of):
    agent = make_dqn(DiscreteCPGEnv(FishVecEnv(world_of(2), PAPER)), 0)
    agent.gaits, agent.joints = TABLE.content(), ["j1", "j2", "j3"]
    return agent


@pytest.fixture
def agents(world_of):
    return {"sac": sac_of(world_of), "dqn": dqn_of(world_of)}


@pytest.fixture
def old(agents, tmp_path) -> dict[str, Path]:
    """Files as version 0.3 wrote them: those of Stable-Baselines3, with pickled settings."""
    files = {name: tmp_path / f"old-{name}.zip" for name in agents}
    SAC.save(agents["sac"], files["sac"])
    DQN.save(agents["dqn"], files["dqn"])
    assert all(":serialized:" in members(file)["data"].decode() for file in files.values())
    return files


def members(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(file: Path, content: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return file


def poisoned(file: Path, mark: Path, *, weights: bool = False) -> Path:
    """The file with an evil object in the place of every pickled one, and one more."""
    content = members(file)
    evil = base64.b64encode(pickle.dumps(Evil(mark))).decode()
    data = json.loads(content["data"])
    for value in data.values():
        if isinstance(value, dict) and ":serialized:" in value:
            value[":serialized:"] = evil
    data["more"] = {":type:": "x", ":serialized:": evil}
    content["data"] = json.dumps(data).encode()
    if weights:
        stream = io.BytesIO()
        torch.save({"actor.mu.weight": Evil(mark)}, stream)
        content["policy.pth"] = stream.getvalue()
        content["pytorch_variables.pth"] = stream.getvalue()
    return write(file.with_name(f"evil-{file.name}"), content)


def test_the_poison_works(old, tmp_path):
    """Otherwise the tests below would see nothing."""
    with pytest.raises(Exception):  # noqa: B017, PT011 - of many kinds
        SAC.load(poisoned(old["sac"], tmp_path / "mark"))
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize("weights", [False, True])
@pytest.mark.parametrize("kind", ["sac", "dqn"])
def test_nothing_in_a_file_is_executed(old, agents, robot, tmp_path, kind, weights):
    mark = tmp_path / "mark"
    file = poisoned(old[kind], mark, weights=weights)
    readers = {
        "agent": lambda: read_agent(file),
        "zip": lambda: read_zip(file),
        "first": lambda: start_from(agents["sac"], file),
        "gaits": lambda: read_policy(file, LIMITS),
        "named": lambda: controller_of(str(file), robot),
        "at a price": lambda: controller_of(f"{file}@0.5", robot),
    }
    harmless = {"gaits", "named"} if kind == "dqn" and not weights else set()
    for name, read in readers.items():
        try:
            read()
            assert name in harmless
        except InputError as error:
            assert name not in harmless
            assert str(file) in str(error)
            assert "\n" not in str(error)
        assert not mark.exists(), name


COMMANDS = {
    "train": ["train", "--quick", "--first", "POLICY", *FILES, "--out", "OUT/run"],
    "ablate": ["ablate", "--quick", "--first", "POLICY", *FILES, "--ranges",
               str(POOL / "ranges.json"), "--reality", str(POOL / "reality.json"), "--arms", "all",
               "--seeds", "1", "--out", "OUT/a"],
}  # fmt: skip
"""Those that keep files before they read further policies; the others call the readers above."""


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_executes_anything(old, tmp_path, capsys, command):
    mark = tmp_path / "mark"
    poison = [poisoned(old[kind], mark, weights=True) for kind in ("sac", "dqn")]
    files = {one.name for one in tmp_path.iterdir()}
    for file in poison:
        given = [x.replace("POLICY", str(file)) for x in COMMANDS[command]]
        assert main([x.replace("OUT", str(tmp_path)) for x in given]) == 2
        told = capsys.readouterr().err.strip().splitlines()
        assert len(told) == 1, told
        assert file.name in told[0]
        assert not mark.exists()
        assert {one.name for one in tmp_path.iterdir()} <= files


@pytest.mark.parametrize("view", [View(), PAPER])
def test_files_of_former_versions_give_the_same_actions(world_of, tmp_path, view):
    agent = sac_of(world_of, view)
    SAC.save(agent, tmp_path / "policy.zip")
    theirs, ours = SAC.load(tmp_path / "policy.zip"), read_agent(tmp_path / "policy.zip")
    seen = np.random.default_rng(0).normal(size=(50, view.size(3))).astype(np.float32)
    for price in (None, 0.6):
        for one in (theirs, ours):
            if price is not None:
                set_price(one, price)
        assert np.array_equal(*(one.predict(seen, deterministic=True)[0] for one in (theirs, ours)))
    assert (ours.view, ours.joints, ours.trained_over) == (
        theirs.view, theirs.joints, theirs.trained_over,
    )  # fmt: skip
    for end in ("joint_low", "joint_high"):
        assert np.array_equal(getattr(ours, end), getattr(theirs, end))
    assert torch.equal(ours.log_ent_coef, theirs.log_ent_coef)


def test_gaits_of_former_versions_are_chosen_as_before(old, agents):
    controller = read_policy(old["dqn"], LIMITS)
    seen = np.random.default_rng(2).normal(0, 0.5, (40, 13)).astype(np.float32)
    mine, theirs = (one.predict(seen, deterministic=True)[0] for one in (
        controller.model, agents["dqn"]))  # fmt: skip
    assert np.array_equal(mine, theirs)


def test_the_same_policy_gives_the_same_bytes(agents, tmp_path):
    for name, agent in agents.items():
        files = [tmp_path / f"{name}-{k}.zip" for k in range(2)]
        agent.save(files[0])
        agent.start_time = 1.0
        torch.manual_seed(3)
        agent.save(files[1])
        digests = {hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
        assert len(digests) == 1
        content = members(files[0])
        assert set(content) == {"data", "policy.pth", "pytorch_variables.pth"}
        assert b"serialized" not in content["data"]
    again = read_agent(tmp_path / "sac-0.zip")
    again.save(tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == (tmp_path / "sac-0.zip").read_bytes()
    controller = read_policy(tmp_path / "dqn-0.zip", LIMITS)
    assert controller.table.content() == TABLE.content()
    for mine, theirs in zip(
        controller.model.policy.parameters(), agents["dqn"].policy.parameters(), strict=True
    ):
        assert torch.equal(mine, theirs)


def with_weight(content: dict[str, bytes], name: str, value: object) -> dict[str, bytes]:
    """The members with another tensor; without it for None."""
    tensors = torch.load(io.BytesIO(content["policy.pth"]), weights_only=True)
    tensors = {k: v for k, v in {**tensors, name: value}.items() if v is not None}
    stream = io.BytesIO()
    torch.save(tensors, stream)
    return {**content, "policy.pth": stream.getvalue()}


def with_setting(content: dict[str, bytes], name: str, value: object) -> dict[str, bytes]:
    data = {**json.loads(content["data"]), name: value}
    return {**content, "data": json.dumps(data).encode()}


WRONG = {
    "a member": lambda c: {**c, "run.py": b"print()"},
    "members": lambda c: {"data": c["data"]},
    "finite": lambda c: with_weight(c, "actor.mu.bias", torch.full((3,), torch.nan)),
    "size mismatch": lambda c: with_weight(c, "actor.mu.bias", torch.zeros(4)),
    "critic.qf0": lambda c: with_weight(c, "critic.qf0.0.weight", torch.zeros(4)),
    "float32": lambda c: with_weight(c, "actor.mu.bias", torch.zeros(3, dtype=torch.float64)),
    "larger than": lambda c: with_weight(
        c, "actor.latent_pi.0.weight", torch.zeros(1).expand(10**6, 10**6)
    ),
    "Missing key": lambda c: with_weight(c, "critic.qf1.0.bias", None),
    "Unexpected key": lambda c: with_weight(c, "more", torch.zeros(1)),
    "tensors by torch.save": lambda c: {**c, "policy.pth": pickle.dumps({"a": 1})},
    "no JSON": lambda c: {**c, "data": b"[" * 100_000},
    "a JSON list": lambda c: {**c, "data": b"[]"},
    "schema": lambda c: with_setting(c, "schema", "other/1"),
    "algorithm": lambda c: with_setting(c, "algorithm", "PPO"),
    "view": lambda c: with_setting(c, "view", {"period": 10**9}),
    "joints": lambda c: with_setting(c, "joints", ["a"]),
    "joint_low": lambda c: with_setting(c, "joint_low", [0, 0, float("nan")]),
    "action_low": lambda c: with_setting(c, "action_low", [2, 2, 2]),
    "trained_over": lambda c: with_setting(c, "trained_over", {"a": 1}),
    "by_price": lambda c: with_setting(c, "by_price", {"prices": 2.0, "column": None, "share": 0}),
    "column": lambda c: with_setting(c, "by_price", {"prices": 2, "column": [1], "share": 0}),
    "num_timesteps": lambda c: with_setting(c, "num_timesteps", "x"),
}


@pytest.mark.parametrize("told", WRONG)
def test_what_does_not_fit_is_refused(agents, tmp_path, told):
    agents["sac"].save(tmp_path / "policy.zip")
    write(tmp_path / "policy.zip", WRONG[told](members(tmp_path / "policy.zip")))
    with pytest.raises(InputError, match=told) as refused:
        read_zip(tmp_path / "policy.zip")
    assert "\n" not in str(refused.value)


def test_a_policy_with_other_layers_is_refused(old, tmp_path):
    """As the reader makes networks of known layers, it must know that they were these."""
    content = members(old["sac"])
    for name, value in (
        ("policy_kwargs", {"activation_fn": "<class 'torch.nn.modules.activation.Tanh'>"}),
        ("policy_kwargs", {"features_extractor_class": "<class 'mine.Scaled'>"}),
        ("policy_class", {"__module__": "mine"}),
        ("policy_class", {"__module__": ["mine"]}),
        ("use_sde", True),
    ):
        file = write(tmp_path / "p.zip", with_setting(content, name, value))
        with pytest.raises(InputError, match=r"policy"):
            read_agent(file)


def test_a_zip_bomb_is_not_unpacked(agents, tmp_path, monkeypatch):
    agents["sac"].save(tmp_path / "policy.zip")
    content = members(tmp_path / "policy.zip")
    bomb = write(
        tmp_path / "bomb.zip", {**content, "data": bytes(LARGEST_BYTES)}, zipfile.ZIP_DEFLATED
    )
    monkeypatch.setattr(zipfile.ZipExtFile, "read", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(InputError, match="MiB when unpacked"):
        read_agent(bomb)


def test_tensors_that_are_packed_are_not_unpacked(agents, tmp_path):
    agents["sac"].save(tmp_path / "policy.zip")
    content = members(tmp_path / "policy.zip")
    (tmp_path / "inner").write_bytes(content["policy.pth"])
    inner = members(tmp_path / "inner") | {"archive/data/99": bytes(10**6)}
    packed = write(tmp_path / "inner", inner, zipfile.ZIP_DEFLATED).read_bytes()
    write(tmp_path / "policy.zip", {**content, "policy.pth": packed})
    with pytest.raises(InputError, match="compressed"):
        read_policy_zip(tmp_path / "policy.zip", "SAC")


def test_files_that_are_none_are_refused(tmp_path):
    """Damaged ones: ``tests/test_damaged_files.py``."""
    for none in (tmp_path, tmp_path / "missing.zip", Path("/dev/zero")):
        with pytest.raises(InputError, match="no file|expected a file"):
            read_agent(none)
