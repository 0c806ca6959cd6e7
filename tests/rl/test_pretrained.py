"""Agents that were trained beforehand: what is kept of them, and for which robot they are."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rl.commands import demo_pool
from rl.commands.demo_pool import PRETRAINED, Pool, agents_in
from rl.deploy.export import read_zip
from rl.experiments.ablation import policy_in
from rl.experiments.arms import PAPER, arm_of
from rl.experiments.pretrained import LISTING, drift, read_pretrained, write_pretrained
from sim.inference.swims import by_twin
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.ranges.entry import read_ranges

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"


@pytest.fixture
def kept(tmp_path, robot):
    """Two agents of one arm, kept as trained ones are; the arm and the plan."""
    model, ranges = read_model(POOL / "calibrated.json"), read_ranges(POOL / "ranges.json")
    plan = replace(demo_pool.QUICK, seeds=(0, 1))
    folders = []
    for seed, policy in enumerate(agents_in(POOL)):
        folders.append(tmp_path / "run" / f"all-{seed}")
        folders[-1].mkdir(parents=True)
        shutil.copy(policy, folders[-1] / "policy.zip")
    made = {"command": "a test", "seed": None}
    write_pretrained(tmp_path / "kept", folders, plan, model, ranges, made)
    return tmp_path / "kept", [arm_of("all", model, robot, ranges)], plan


def test_kept_agents_act_as_those_that_were_trained(kept, robot, tmp_path):
    folder, arms, plan = kept
    found = read_pretrained(folder)
    assert found.seeds == (0, 1)
    assert found.plan == plan.content()
    agents = found.restore(tmp_path / "nowhere", robot, arms, plan)
    for agent, trained in zip(agents, agents_in(POOL), strict=True):
        ours, theirs = policy_in(agent), read_zip(trained)
        assert all(map(np.array_equal, ours.weights, theirs.weights))
        assert all(map(np.array_equal, ours.biases, theirs.biases))
        assert ours.view == theirs.view
    assert not (tmp_path / "nowhere").exists()


def test_agents_that_are_missing_or_changed_are_refused(kept, robot, tmp_path):
    folder, arms, plan = kept
    found = read_pretrained(folder)
    with pytest.raises(InputError, match="no such agent"):
        found.restore(tmp_path, robot, arms, replace(plan, seeds=(2,)))
    shutil.copy(folder / "all-0" / "policy.npz", folder / "all-1" / "policy.npz")
    with pytest.raises(InputError, match="another file"):
        found.restore(tmp_path, robot, arms, plan)
    (folder / LISTING).write_text("{}")
    with pytest.raises(InputError, match="SHA-256"):
        read_pretrained(folder)
    (folder / LISTING).unlink()
    with pytest.raises(InputError, match="no such file"):
        read_pretrained(folder)


def test_models_drift_apart_as_their_servos_do(robot):
    model = read_model(POOL / "calibrated.json")
    swim, twin = Pool.of(POOL).swim, by_twin(robot)
    error = np.array([0.02, 0.02, 0.2, 0.02, 0.02, 0.02])

    def late(seconds: float):
        joints = {
            name: replace(joint, latency_s=joint.latency_s + seconds)
            for name, joint in model.joints.items()
        }
        return replace(model, joints=joints)

    assert drift(model, model, swim, twin, error) == pytest.approx(0.0, abs=1e-9)
    little, much = (drift(late(s), model, swim, twin, error) for s in (0.002, 0.04))
    assert 0 < little < 1 < much
    assert drift(late(0.04), model, swim, twin, 2 * error) == pytest.approx(much / 2)


def test_the_shipped_agents_are_those_of_the_demos_plan():
    """Every arm and seed, small, and from the files and the plan that the demo has today."""
    folder = POOL / PRETRAINED
    found = read_pretrained(folder)
    assert found.plan == replace(demo_pool.QUICK, seeds=tuple(range(demo_pool.SEEDS))).content()
    listing = json.loads((folder / LISTING).read_text())
    names = {f"{arm}-{seed}/policy.npz" for arm in PAPER for seed in range(demo_pool.SEEDS)}
    assert names <= listing["files"].keys()
    assert sum(file.stat().st_size for file in folder.rglob("*.*")) < 2_000_000
    made = listing["provenance"]["inputs"]
    assert {Path(name).name for name in made} == {
        "robot.toml", "model.json", "p1.csv", *(path.name for path in agents_in(POOL)),
    }  # fmt: skip
