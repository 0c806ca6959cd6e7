"""The policy that chooses gaits: trained, kept, read again, refused where it is another."""

from pathlib import Path

import numpy as np
import pytest

from rl.controllers.discrete_cpg import COLUMNS, TABLE, read_policy, train_run
from sim2real.errors import InputError

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
LIMITS = [(-0.8, 0.8)] * 3
SMALL = {
    "robot": str(POOL / "robot.toml"), "model": str(POOL / "calibrated.json"), "task": "near",
    "steps": 4_000, "envs": 8,
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("discrete")
    return folder, train_run(folder, **SMALL)


def test_a_run_leaves_a_policy_and_its_progress(run):
    folder, agents = run
    assert agents == [folder / "policy-0"]
    rows = (agents[0] / "progress.csv").read_text().splitlines()
    assert rows[0].split(",") == list(COLUMNS)
    assert float(rows[-1].split(",")[0]) >= SMALL["steps"]


def test_the_policy_knows_its_gaits_and_acts_within_the_limits(run, robot):
    limits = np.array([joint.limits_rad for joint in robot.joints])
    controller = read_policy(run[1][0] / "policy.zip", limits)
    assert controller.table.content() == TABLE.content()
    seen = np.random.default_rng(0).normal(0, 0.2, (5, 11)).astype(np.float32)
    angles = np.array([controller.act(seen) for _ in range(30)])
    assert (angles >= limits[:, 0] - 1e-6).all()
    assert (angles <= limits[:, 1] + 1e-6).all()
    assert np.ptp(angles, axis=0).max() > 0.05


def test_a_run_that_is_done_is_not_done_again_and_another_is_refused(run):
    folder, agents = run
    before = (agents[0] / "policy.zip").stat().st_mtime_ns
    train_run(folder, **SMALL)
    assert (agents[0] / "policy.zip").stat().st_mtime_ns == before
    with pytest.raises(InputError, match=r"run\.json"):
        train_run(folder, **{**SMALL, "steps": 8_000})


@pytest.mark.parametrize(
    ("name", "value"), [("offset_rad", [0.0]), ("hold", 0), ("hold", 1001), ("lag_rad", "x")]
)
def test_a_table_that_is_none_is_refused(run, tmp_path, name, value):
    agent = read_policy(run[1][0] / "policy.zip", LIMITS).model
    agent.gaits, agent.joints = {**TABLE.content(), name: value}, ["j1", "j2", "j3"]
    agent.save(tmp_path / "policy.zip")
    with pytest.raises(InputError, match=f"gaits.{name}"):
        read_policy(tmp_path / "policy.zip", LIMITS)
