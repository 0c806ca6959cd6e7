"""The ablation: its arms, its bookkeeping, its resumption, its report."""

import json
import re
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest

import rl.experiments.testbeds
from rl.commands.ablate import make_testbeds
from rl.deploy.export import read_zip
from rl.experiments.ablation import ARMS, STIFF, ablate, arm_of, model_of, one_density
from rl.experiments.ablation_report import (
    default_values,
    markdown,
    order_text,
    tables,
    write_report,
)
from rl.experiments.episodes import Episodes
from rl.experiments.reality import read_reality
from rl.experiments.statistics import bootstrap, differences, paired, seeds_needed
from rl.sac.plan import Settings
from rl.sac.train import Plan, train
from rl.task import TASKS
from sim2real.ranges.entry import Ranges, normal, uniform
from sim2real.robot import normalised_density
from tests.rl.test_reality import GLIDER

RANGES = Ranges(
    (
        uniform("command_latency_s", 0.05, 0.09, "s", ""),
        uniform("j1.kp_Nm_per_rad", 1.9, 2.3, "N m/rad", ""),
        normal("body.normalised_density.head", 1.2, 0.05, "", ""),
        normal("body.position_noise_m", 0.0, 0.002, "m", "", "step"),
        normal("j1.position_noise_rad", 0.0, 0.002, "rad", "", "step"),
    )
)
SETTINGS = Settings(hidden=(8, 8), memory=200, batch=8, warm_up=40, updates_per_step=0.1)
SHORT = {"steps": 160, "envs": 4, "segment": 80, "fidelity": "twin", "seeds": (0, 1)}
PLAN = Plan(replace(TASKS["near"], steps=10), **SHORT, settings=SETTINGS)

NAMES = ("full", "no-servo")


def test_an_arm_differs_from_all_techniques_in_its_own_technique_alone(robot, model):
    every = model_of(ARMS["full"], model, robot)
    assert np.allclose(every.body["normalised_density"], normalised_density(robot).value)
    stiff = model_of(ARMS["no-servo"], model, robot)
    assert all(joint == STIFF for joint in stiff.joints.values())
    assert stiff.body == every.body
    even = model_of(ARMS["no-density"], model, robot)
    assert even.joints == every.joints
    assert not np.allclose(even.body["normalised_density"], every.body["normalised_density"])
    length = np.array([link.length_m for link in robot.links])
    assert np.isclose(np.array(one_density(robot)) @ length, length.sum()), "the same total"
    (none,) = arm_of("none", model, robot, RANGES).draws.models
    assert (none.joints, none.body) == (stiff.joints, even.body)


def test_a_range_does_not_bring_back_what_an_arm_leaves_out(robot, model):
    late = {m.joints["j1"].latency_s for m in arm_of("no-servo", model, robot, RANGES).draws.models}
    assert late == {0.0}
    heavy = arm_of("no-density", model, robot, RANGES).draws.models
    assert len({m.body["normalised_density"][0] for m in heavy}) == 1
    assert len({m.joints["j1"].kp_Nm_per_rad for m in heavy}) > 100
    alone = arm_of("no-randomization", model, robot, RANGES).draws
    assert len(alone.models) == 1
    assert alone.noise.position_m == 0.0
    assert arm_of("full", model, robot, RANGES).draws.noise.position_m == 0.002
    real = replace(model, joints={k: replace(v, latency_s=0.2) for k, v in model.joints.items()})
    ceiling = arm_of("ceiling", model, robot, RANGES, reality=real).draws
    assert {j.latency_s for m in ceiling.models for j in m.joints.values()} == {0.2}
    assert ceiling.noise.position_m == 0.002


@pytest.fixture(scope="module")
def ablated(robot, model):
    def call(folder, reality=None):
        arms = [arm_of(name, model, robot, RANGES) for name in NAMES]
        places = make_testbeds(robot, arms, PLAN, RANGES, reality or model)
        agents = train(folder / "train", robot, arms, PLAN)
        return ablate(folder, robot, NAMES, agents, PLAN, places, repeats=3)

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASKS, "turn", replace(TASKS["turn"], steps=100))
        yield call


@pytest.fixture(scope="module")
def trained(ablated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "run"
    ablated(folder)
    return folder


@pytest.fixture
def run(ablated, trained, tmp_path):
    """Does an ablation again whose agents are trained."""
    shutil.copytree(trained, tmp_path / "run")
    return lambda reality=None: ablated(tmp_path / "run", reality)


def test_an_agent_knows_what_it_was_trained_over(trained):
    every, stiff = (
        read_zip(next(trained.rglob(f"{name}-0")) / "policy.zip").provenance["trained_over"]
        for name in ("full", "no-servo")
    )
    low, high = every["j1.kp_Nm_per_rad"]
    assert 1.9 < low < 1.95 and 2.25 < high < 2.3
    assert stiff["j1.kp_Nm_per_rad"] == [STIFF.kp_Nm_per_rad] * 2


def test_it_resumes_and_is_not_done_twice(run, tmp_path, monkeypatch, model):
    found = run()
    assert [(a["arm"], a["seed"]) for a in found["agents"]] == [
        ("full", 0), ("full", 1), ("no-servo", 0), ("no-servo", 1),
    ]  # fmt: skip
    (tmp_path / "run" / "reality.json").unlink()
    assert run() == found
    with monkeypatch.context() as patch:
        patch.setattr(rl.experiments.testbeds, "run_episodes", None)  # nothing is left to swim
        assert run() == found
        joints = {k: replace(v, latency_s=0.2) for k, v in model.joints.items()}
        with pytest.raises(TypeError):
            run(reality=replace(model, joints=joints))


def test_a_reality_of_ones_own_is_tried_anew_where_its_file_has_changed(run, tmp_path, monkeypatch):
    path = tmp_path / "glider.py"
    path.write_text(GLIDER.format(speed=0.05, at_once=None))
    found = run(read_reality(path))
    assert "glider.py" in found["said"]["reality"]
    agent = found["agents"][0]["reality"]
    assert len(agent["reward"]) == 3
    assert not any(agent["success"])
    with monkeypatch.context() as patch:
        patch.setattr(rl.experiments.testbeds, "run_episodes", None)  # nothing is left to swim
        assert run(read_reality(path)) == found
        path.write_text(GLIDER.format(speed=0.06, at_once=None))
        with pytest.raises(TypeError):
            run(read_reality(path))


def test_the_report_has_the_same_rows_on_page_markdown_and_json(run, tmp_path, robot, model):
    found, folder = run(), tmp_path / "run"
    note = {"command": "ablate --quick", "seed": 3, "inputs": {"a.csv": "0a1b"}, "versions": {}}
    write_report(found, PLAN, folder, note, default_values(model, robot))
    page, written = (folder / "index.html").read_text(), (folder / "ablation.md").read_text()
    footer = ("ablate --quick", "3 (turns), 0, 1 (agents)", "torch", "a.csv")
    for words in ("no servo calibration", "No arm reached the target", *footer):
        assert words in page
    assert markdown(found) in written
    content, loss = json.loads((folder / "ablation.json").read_text()), differences(found)
    assert [row["arm"] for row in content["table"]] == ["full", "no-servo"]
    assert content["losses"] == {"no-servo": pytest.approx(asdict(loss["no-servo"]))}
    assert f"{loss['no-servo'].mean:+.2f}" in page
    agent = found["agents"][0]["reality"]
    assert agent["paper"] == pytest.approx(
        np.array(agent["reward"]) - (0.001 - PLAN.task.energy) * np.array(agent["energy"])
    )
    values = {row[0]: row[1:] for row in default_values(model, robot).rows}
    assert values["servo torque limit (N m)"] == ("none", "2")
    assert values["servo kp (N m/rad)"][1] == "10"


def test_a_loss_has_one_sign_in_every_table():
    """Whatever is drawn: all techniques minus the arm, the lower end first, the mean between."""
    rng, number = np.random.default_rng(), r"([+-]\d+\.\d+)"
    for _ in range(50):
        shift, spread = rng.normal(0, 3), rng.uniform(0.1, 5)
        outcomes = {"full": rng.normal(10, 1, 6), "no-servo": rng.normal(10 - shift, spread, 6)}
        agents = [
            {"arm": arm, "seed": seed, "folder": f"{arm}-{seed}"}
            | {testbed: {**TURN, "return": [float(x)]} for testbed in ("simulation", "reality")}
            for arm, returns in outcomes.items()
            for seed, x in enumerate(returns)
        ]
        found = {"agents": agents, "testbeds": ["simulation", "reality"]}
        loss = differences(found)["no-servo"]
        mean = float(np.mean(outcomes["full"] - outcomes["no-servo"]))
        expected = tuple(f"{x:+.2f}" for x in (mean, loss.low, loss.high))
        assert loss.low <= mean <= loss.high
        cells = re.findall(rf"{number}; {number} to {number}", markdown(found))
        assert cells == [expected, ("+0.0", "+0.0", "+0.0")]  # the paper's reward is the same
        (row,) = tables(found)["losses"].rows
        assert row[2] == ("yes" if loss.significant else "no")


TURN = {"paper": [1.0], "success": [True], "time_s": [1.0], "energy": [1.0]}


def test_measures_that_order_arms_differently_are_explained_by_the_energy():
    def row(arm, value, paper, energy, time):
        real = {"return": [value], "paper": [paper], "energy": energy, "time_s": time}
        return {"arm": arm, "reality": real}

    between = [row(arm, 8.5, 10.5, 13_500.0, 7.0) for arm in ("no-density", "no-randomization")]
    rows = [row("full", 9.0, 11.0, 13_000.0, 6.0), *between]
    text = order_text([*rows, row("no-servo", 8.0, 16.5, 8_000.0, 9.5)])
    assert "By the paper's reward: no servo calibration (16.5), all techniques (11.0)" in text
    assert "is found by return." in text
    assert "+5.5 of the paper's reward, +5.0 of it by its energy (8000 instead of 13000)" in text
    assert "3.5 s longer" in text
    text = order_text([*rows, row("no-servo", 8.0, 10.0, 13_000.0, 9.5)])
    assert "by return and by the paper's reward" in text and "disagree" not in text
    assert "by neither" in order_text([*rows, row("no-servo", 9.5, 16.0, 8_000.0, 9.5)])


def test_a_return_is_what_agents_learn_to_earn():
    value = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [np.nan, 4.0]])
    none = np.zeros((4, 2, 3))
    one = Episodes(none, none, value, np.ones(2), np.ones(2), np.zeros((2, 1, 2)))
    assert one.reward.tolist() == [2.0, 6.0]
    assert one.discounted(0.5).tolist() == [1.5, 2.0]


def test_pairs_take_out_what_seeds_have_in_common():
    rng = np.random.default_rng(0)
    seeds = rng.normal(0, 5, 8)
    one = paired(20 + seeds + rng.normal(0, 0.1, 8), 17 + seeds + rng.normal(0, 0.1, 8))
    assert one.significant
    assert abs(one.mean - 3) < 0.2
    assert one.high - one.low < 0.5
    assert not paired(np.array([1.0]), np.array([0.0])).significant


def test_its_intervals_hold_the_truth_nine_times_in_ten():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(600):
        one = paired(rng.normal(1.0, 1.0, 6), np.zeros(6))
        inside += one.low < 1.0 < one.high
    assert inside / 600 == pytest.approx(0.9, abs=0.04)


def test_the_seeds_needed_are_those_that_make_intervals_narrow():
    rng = np.random.default_rng(2)
    first = rng.normal(0, 1, 400)
    told = {"a": paired(first[:20] + 3, np.zeros(20)), "b": paired(first[20:40], np.zeros(20))}
    count = seeds_needed(told)["a"]
    assert count is not None
    widths = [
        2 * (one.high - one.mean)
        for k in range(0, 400 - count, count)
        for one in [paired(first[k : k + count], np.zeros(count))]
    ]
    assert np.mean(widths) == pytest.approx(told["a"].mean / 3, rel=0.35)


def test_the_bootstrap_knows_agents_from_repeats():
    """Repeats that agree say nothing new of agents that differ."""
    rng = np.random.default_rng(0)
    mean, low, high = bootstrap([[0.0] * 50, [1.0] * 50, [2.0] * 50], rng)
    assert mean == 1.0
    assert low < 0.4
    assert high > 1.6
