"""Agents that were trained beforehand: what is kept of them, and for which robot they are."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.demo_agents import FIRST, SEEDS, write_pretrained
from rl.commands.demo import PRETRAINED, QUICK
from rl.deploy.export import read_zip
from rl.experiments.ablation import LISTING, PAPER, policy_in, read_pretrained
from sim2real.errors import InputError

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"


@pytest.fixture
def kept(tmp_path):
    """Two agents of one arm, by its former name, kept as trained ones are; and the plan."""
    files = {"model.json": POOL / "calibrated.json", "ranges.json": POOL / "ranges.json"}
    plan = replace(QUICK, seeds=(0, 1))
    folders = []
    for seed, policy in enumerate(FIRST):
        folders.append(tmp_path / "run" / f"all-{seed}")
        folders[-1].mkdir(parents=True)
        shutil.copy(policy, folders[-1] / "policy.zip")
    made = {"command": "a test", "seed": None}
    write_pretrained(tmp_path / "kept", folders, plan, files, made)
    return tmp_path / "kept", plan


def test_kept_agents_act_as_those_that_were_trained(kept):
    folder, plan = kept
    agents, seeds = read_pretrained(folder, ["full"])
    assert seeds == plan.seeds
    assert json.loads((folder / LISTING).read_text())["plan"] == plan.content()
    for agent, trained in zip(agents, FIRST, strict=True):
        ours, theirs = policy_in(agent), read_zip(trained)
        assert all(map(np.array_equal, ours.weights, theirs.weights))
        assert all(map(np.array_equal, ours.biases, theirs.biases))
        assert ours.view == theirs.view


def test_agents_that_are_missing_or_changed_are_refused(kept):
    folder, _ = kept
    with pytest.raises(InputError, match="no such agent"):
        read_pretrained(folder, ["no-servo"])
    shutil.copy(folder / "all-0" / "policy.npz", folder / "all-1" / "policy.npz")
    with pytest.raises(InputError, match="another file"):
        read_pretrained(folder, ["full"])
    (folder / LISTING).write_text("{}")
    with pytest.raises(InputError, match="seeds"):
        read_pretrained(folder, ["full"])
    (folder / LISTING).unlink()
    with pytest.raises(InputError, match="no such file"):
        read_pretrained(folder, ["full"])


def test_the_shipped_agents_are_those_of_the_demos_plan():
    """Every arm and seed, small, and from the files and the plan that the demo has today."""
    folder = POOL / PRETRAINED
    read_pretrained(folder, PAPER)
    listing = json.loads((folder / LISTING).read_text())
    plan = replace(QUICK, seeds=tuple(range(SEEDS)))
    assert listing["plan"] == plan.content()
    names = {f"{arm}-{seed}/policy.npz" for arm in PAPER for seed in range(SEEDS)}
    assert names <= listing["files"].keys()
    assert sum(file.stat().st_size for file in folder.rglob("*.*")) < 2_000_000
    made = listing["provenance"]["inputs"]
    assert {Path(name).name for name in made} == {
        "robot.toml", "calibrated.json", "ranges.json", *(path.name for path in FIRST),
    }  # fmt: skip
