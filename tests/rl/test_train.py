"""Training: the same run whether it was interrupted or not, and one that is another is refused."""

import io
import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import rl.sac.train
from rl.deploy.export import policy_of, set_price
from rl.deploy.policy import PolicyController
from rl.experiments import testbeds
from rl.experiments.episodes import summary
from rl.experiments.named import controller_of, shown, with_price
from rl.experiments.testbeds import DrawnTrials
from rl.make import draw_models, noise_of
from rl.observer import PAPER
from rl.sac.checkpoint import COLUMNS, curves_figure, read_progress
from rl.sac.plan import RECIPES, Settings, plan_of
from rl.sac.sac import read_agent
from rl.sac.train import Arm, Plan, train, train_in_parts, train_run
from rl.task import TASKS
from rl.world import Draws, Noise
from sim2real.body import values
from sim2real.errors import InputError
from sim2real.ranges.entry import Ranges, normal, read_ranges, uniform
from sim2real.report.drawing import save_png

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
SETTINGS = Settings(hidden=(16, 16), memory=400, batch=16, warm_up=320, updates_per_step=0.1)
SHORT = {"steps": 1920, "envs": 8, "segment": 640, "seeds": (0, 1), "fidelity": "twin"}
PLAN = Plan(replace(TASKS["near"], steps=40), **SHORT, settings=SETTINGS)


def arms(model):
    return [Arm("a", Draws((model,))), Arm("b", Draws((model,), Noise(0.01, 0.01, (0.01,))))]


def parameters(folders):
    loaded = [read_agent(folder / "policy.zip") for folder in folders]
    return [torch.cat([v.ravel() for v in one.policy.state_dict().values()]) for one in loaded]


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(robot, model, tmp_path, monkeypatch):
    whole = train(tmp_path / "whole", robot, arms(model), PLAN)
    saved = rl.sac.train.save
    calls = []

    def killed(*given):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        saved(*given)

    with monkeypatch.context() as patch:
        patch.setattr(rl.sac.train, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / "cut", robot, arms(model), PLAN)
    cut = train(tmp_path / "cut", robot, arms(model), PLAN)
    assert [folder.name for folder in cut] == ["a-0", "a-1", "b-0", "b-1"]
    for a, b in zip(whole, cut, strict=True):
        assert (a / "progress.csv").read_text() == (b / "progress.csv").read_text()
    for x, y in zip(parameters(whole), parameters(cut), strict=True):
        assert torch.equal(x, y)
    one, other = parameters(whole)[:2]
    assert not torch.equal(one, other), "seeds differ"


def test_learning_beside_the_swim_gives_what_learning_after_it_does(
    robot, model, tmp_path, monkeypatch
):
    plan = replace(PLAN, steps=640)
    beside = train(tmp_path / "beside", robot, arms(model), plan)
    monkeypatch.setattr(rl.sac.train, "ThreadPoolExecutor", lambda threads: nullcontext())
    after = train(tmp_path / "after", robot, arms(model), plan)
    for x, y in zip(parameters(beside), parameters(after), strict=True):
        assert torch.equal(x, y)


def test_seeds_are_dealt_out_to_processes(robot, model, tmp_path, monkeypatch):
    """Here one after the other; the demo's test has processes."""

    class Pool(nullcontext):
        def __init__(self, *given):
            super().__init__(self)

        def submit(self, training):
            result = training()
            return SimpleNamespace(result=lambda: result)

    monkeypatch.setattr(rl.sac.train, "ProcessPoolExecutor", Pool)
    plan = replace(PLAN, steps=640, seeds=(4, 5, 6))
    folders = train_in_parts(tmp_path / "parts", robot, arms(model), plan)
    names = [f"{arm}-{seed}" for arm in "ab" for seed in plan.seeds]
    assert [folder.name for folder in folders] == names
    assert [folder.parent.name[-1] for folder in folders] == [*"010010"]
    alone = train(tmp_path / "alone", robot, arms(model), replace(plan, seeds=(5,)))
    assert all(map(torch.equal, parameters(folders[1::3]), parameters(alone)))


def test_a_folder_of_another_run_is_refused(robot, model, tmp_path):
    short = replace(PLAN, steps=320)
    train(tmp_path, robot, arms(model)[:1], short)
    with pytest.raises(InputError, match="another run"):
        train(tmp_path, robot, arms(model)[:1], replace(short, envs=4))


def test_more_steps_continue_a_run(robot, model, tmp_path):
    """What was learned stays, the memory grows; fewer steps are another run."""
    seen = []
    short = replace(PLAN, steps=640)
    one = arms(model)[:1]
    (folder, _) = train(tmp_path, robot, one, short, {"note": 1})
    before = (folder / "progress.csv").read_text()
    train(tmp_path, robot, one, replace(short, steps=1280), report=lambda *told: seen.append(told))
    assert (folder / "progress.csv").read_text().startswith(before)
    assert [(name, row["steps"]) for name, row in seen] == [("a-0", 1280), ("a-1", 1280)]
    kept = json.loads((tmp_path / "run.json").read_text())
    assert kept["plan"]["steps"] == 1280 and kept["provenance"] == {"note": 1}
    with np.load(tmp_path / "checkpoint.npz") as stored:
        assert stored["counts"].tolist() == [1280, 0, 320]
        assert (stored["memory"] != 0).any(axis=2).all()
    with pytest.raises(InputError, match="another run"):
        train(tmp_path, robot, one, short)


def test_the_paper_is_a_recipe_and_each_departure_an_option():
    """Table I and the text of Lin, Liu and Wang, and what turns the default into it."""
    paper, default = RECIPES["paper"], RECIPES["default"]
    s = paper.settings
    table = (s.gamma, s.memory, s.batch, s.rate, s.tau, s.updates_per_step)
    assert table == (0.99, 1_000_000, 256, 3e-4, 0.005, 1.0)
    assert [3 * one for one in s.entropy_target] == [-3.0, -3.0] and s.rate_end == 1.0
    assert (s.hidden, paper.view, paper.steps, paper.envs) == ((256, 256), PAPER, 1_000_000, 1)
    assert not (s.mirror or s.norm or s.noise_s or s.average) and s.prices == 1
    assert paper.task == TASKS["point"] and paper.price(0.0) == 0.001
    assert (paper.task.steps, paper.task.approach, paper.task.bonus) == (1000, 10.0, 10.0)
    options = {
        "task": "point", "view": "paper", "energy_weight": 0.001, "energy_start": 1.0,
        "steps": 1_000_000, "envs": 1, "segment": 50_000, "updates_per_step": 1.0, "batch": 256,
        "learning_rate": 3e-4, "rate_end": 1.0, "hidden": [256, 256], "warm_up": 100,
        "entropy_start": 1.0, "entropy_target": [-1.0, -1.0], "noise_s": 0.0, "prices": 1.0,
        "average": 0.0, "no_mirror": True, "no_norm": True,
    }  # fmt: skip
    assert plan_of(options).content() == paper.content() != default.content()
    text = (POOL.parents[1] / "docs/explanation/learning.md").read_text()
    for option in options:
        assert f"--{option.replace('_', '-')}`" in text or f"--{option.replace('_', '-')} " in text


def test_the_paper_trains_with_its_table_of_ranges(tmp_path):
    table = POOL.parent / "ranges" / "table2.json"
    noise = noise_of(read_ranges(table), ["j1", "j2", "j3"])
    sd = (noise.position_m, noise.yaw_rad, *noise.joint_rad)
    assert sd == pytest.approx((0.05, *np.deg2rad([3, 2, 2, 2])), abs=1e-5)
    with pytest.raises(InputError, match="j1.position_noise_rad"):
        noise_of(read_ranges(table), ["a"])
    files = {"robot": str(POOL / "robot.toml"), "model": str(POOL / "calibrated.json")}
    (folder,) = train_run(
        tmp_path, **files, ranges=str(table), recipe="paper", steps=1150, segment=1100,
        hidden=[16, 16], batch=16,
    )  # fmt: skip
    assert read_progress(folder)["steps"].tolist() == [1000, 1100, 1150]
    low, high = read_agent(folder / "policy.zip").trained_over["j1.latency_s"]
    assert 0.048 <= low < 0.053 < 0.083 < high <= 0.088


def test_progress_says_what_happened(robot, model, tmp_path):
    (folder, _) = train(tmp_path, robot, arms(model)[:1], PLAN)
    seen = read_progress(folder)
    assert tuple(seen) == COLUMNS
    assert seen["steps"][-1] == PLAN.steps
    assert seen["episodes"].sum() == 48
    save_png(curves_figure({"a": [folder]}), tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000
    assert json.loads((tmp_path / "run.json").read_text())["plan"]["steps"] == PLAN.steps


def test_ranges_become_robots(robot, model):
    ranges = Ranges(
        (
            uniform("command_latency_s", 0.05, 0.09, "s", ""),
            normal("j2.latency_offset_s", 0.01, 0.0, "s", ""),
            uniform("j1.kp_Nm_per_rad", 1.0, 2.0, "N m/rad", ""),
            uniform("j3.coulomb_friction.torque_Nm", 0.1, 0.2, "N m", ""),
            uniform("j1.motor.stall_torque_Nm", 1.3, 1.7, "N m", ""),
            normal("body.normalised_density.head", 1.2, 0.05, "", ""),
            uniform("body.form_drag.coefficient", 0.1, 0.3, "", ""),
            uniform("packet_loss.probability", 0.01, 0.05, "", ""),
            normal("body.position_noise_m", 0.0, 0.05, "m", "", "step"),
            normal("j2.position_noise_rad", 0.0, 0.03, "rad", "", "step"),
        )
    )
    drawn = draw_models(model, ranges, robot, 400, np.random.default_rng(0))
    late = np.array([[m.joints[j].latency_s for j in ("j1", "j2", "j3")] for m in drawn])
    assert 0.05 <= late[:, 0].min() < late[:, 0].max() <= 0.09
    assert np.allclose(late[:, 1] - late[:, 0], 0.01)
    kp = np.array([m.joints["j1"].kp_Nm_per_rad for m in drawn])
    assert abs(kp.mean() - 1.5) < 0.05
    assert {m.joints["j2"].kp_Nm_per_rad for m in drawn} == {model.joints["j2"].kp_Nm_per_rad}
    stall = [m.joints["j1"].motor["stall_torque_Nm"] for m in drawn]
    assert 1.3 <= min(stall) < max(stall) <= 1.7 and drawn[0].joints["j1"].law == "motor"
    friction = {e.effect: e.parameters for e in drawn[0].joints["j3"].effects}
    assert 0.1 <= friction["coulomb_friction"]["torque_Nm"] <= 0.2
    assert 0.01 <= friction["packet_loss"]["probability"] <= 0.05
    density = np.array([m.body["normalised_density"] for m in drawn])
    assert abs(density[:, 0].std() - 0.05) < 0.01
    assert np.allclose(density[:, 1:], density[0, 1:])
    assert 0.1 <= values(drawn[0])["form_drag.coefficient"] <= 0.3
    assert noise_of(ranges, ["j1", "j2"]) == Noise(0.05, 0.0, (0.0, 0.03))


def test_a_world_adopts_other_robots_at_resets(robot, model, world_of):
    """A robot drawn at a reset swims as one that was made so."""
    ranges = Ranges((uniform("j1.kp_Nm_per_rad", 0.6, 0.7, "", ""),))
    other = draw_models(model, ranges, robot, 1, np.random.default_rng(1))[0]
    task = replace(TASKS["turn"], steps=5)
    mixed = world_of(1, task, Draws((model,)), seed=3)
    mixed._draws = [Draws((other,))]
    mixed.seed(3)
    mixed.reset()
    made = world_of(1, task, Draws((other,)), seed=3)
    made.seed(3)
    made.reset()
    for _ in range(5):
        a, b = mixed.step(torch.full((1, 3), 0.5)), made.step(torch.full((1, 3), 0.5))
        assert torch.allclose(a.final, b.final, atol=1e-6)


def test_the_energy_weight_grows_once_an_agent_succeeds():
    plan = replace(PLAN, steps=1000, energy_start=0.1, ramp=(0.3, 0.4), gate=0.7)
    assert plan.grown(0.0, 200, 100, 1.0) == 0.0, "too early"
    assert plan.grown(0.2, 600, 100, 0.5) == 0.2, "an agent that fails is not starved"
    assert plan.grown(0.2, 600, 100, 0.9) == pytest.approx(0.45)
    assert plan.grown(0.9, 600, 100, 0.9) == 1.0
    prices = [plan.price(grown) for grown in (0.0, 0.5, 1.0)]
    assert prices == pytest.approx([1e-4, 5.5e-4, 1e-3])


def test_prices_grow_as_planned(robot, model, tmp_path, monkeypatch):
    seen = []
    saved = rl.sac.train.save

    def watched(folder, agents, progress, names):
        seen.append(agents.price[:, 0].tolist())
        saved(folder, agents, progress, names)

    monkeypatch.setattr(rl.sac.train, "save", watched)
    plan = replace(PLAN, ramp=(0.0, 0.3), gate=0.0, energy_start=0.5)
    train(tmp_path, robot, arms(model), plan)
    assert seen[0] == pytest.approx([1e-3] * 4, rel=0.5)
    assert seen[-1] == pytest.approx([1e-3] * 4)


@pytest.mark.parametrize(
    ("change", "option"),
    [
        ({"energy_start": 1.5}, "--energy-start"),
        ({"steps": 0}, "--steps"),
        ({"settings": Settings(gamma=1.0)}, "--discount"),
        ({"settings": Settings(rate=0.0)}, "--learning-rate"),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(change, option):
    with pytest.raises(InputError, match=option):
        replace(PLAN, **change)


def test_a_training_goes_on_from_policies(robot, model, tmp_path):
    first = [f / "policy.zip" for f in train(tmp_path / "a", robot, arms(model)[:1], PLAN)]
    still = replace(PLAN, settings=replace(PLAN.settings, warm_up=10**9), segment=1920)
    swum = train(tmp_path / "b", robot, arms(model)[:1], still, first=first)
    for path, folder in zip(first, swum, strict=True):
        one, other = (read_agent(p) for p in (path, folder / "policy.zip"))
        for x, y in zip(one.policy.parameters(), other.policy.parameters(), strict=True):
            assert torch.equal(x, y)
    assert (swum[0] / "progress.csv").read_text() != (first[0].parent / "progress.csv").read_text()
    both = train(tmp_path / "f", robot, arms(model), still, first=first[:1])
    kept = [read_agent(one / "policy.zip").actor.mu.weight for one in both]
    assert all(torch.equal(one, kept[0]) for one in kept), "of both arms and seeds"
    with pytest.raises(InputError, match="one a seed"):
        train(tmp_path / "c", robot, arms(model), PLAN, first=[*first, *first])
    with pytest.raises(InputError, match="another run"):
        train(tmp_path / "b", robot, arms(model)[:1], still, first=first[::-1])
    with pytest.raises(InputError, match="view"):
        train(tmp_path / "d", robot, arms(model)[:1], replace(PLAN, view=PAPER), first=first)
    wide = replace(PLAN, settings=replace(PLAN.settings, hidden=(8, 8)))
    with pytest.raises(InputError, match="networks"):
        train(tmp_path / "e", robot, arms(model)[:1], wide, first=first)


def damaged_checkpoints(file):
    """By what is wrong, contents of a checkpoint that cannot be resumed from."""
    whole = file.read_bytes()
    with np.load(file) as stored:
        arrays = dict(stored)

    def other(**changes):
        stream = io.BytesIO()
        np.savez(stream, **{k: v for k, v in {**arrays, **changes}.items() if v is not None})
        return stream.getvalue()

    text = np.frombuffer(b"[[[1]], [0], [0]]", np.uint8)
    return {
        "empty": b"",
        "cut": whole[: len(whole) // 2],
        "text": b"a fish",
        "one missing": other(actor=None),
        "another shape": other(actor=arrays["actor"][:-1]),
        "not finite": other(critic=arrays["critic"] * np.nan),
        "objects": other(actor=np.array({"a": 1}, dtype=object)),
        "counts": other(counts=np.array([-1, 0, 0])),
        "larger memory": other(counts=np.array([640, 10**9, 10**9])),
        "progress": other(progress=text),
        "no progress": other(progress=text[:5]),
    }


def test_a_damaged_checkpoint_is_told_in_a_line(robot, model, tmp_path):
    once = replace(PLAN, segment=PLAN.steps, seeds=(0,))
    train(tmp_path, robot, arms(model)[:1], once)
    file = tmp_path / "checkpoint.npz"
    for name, content in damaged_checkpoints(file).items():
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"checkpoint\.npz.*starts anew") as told:
            train(tmp_path, robot, arms(model)[:1], once)
        assert "\n" not in str(told.value), name
    file.unlink()
    for content in (b"", b"[]", b"{", b"\xff"):
        (tmp_path / "run.json").write_bytes(content)
        with pytest.raises(InputError, match=r"run\.json"):
            train(tmp_path, robot, arms(model)[:1], once)


def test_agents_are_chosen_by_held_out_trials(robot, model, tmp_path, monkeypatch):
    """The one that does better in the same trials, at one weight, whatever training said."""
    folders = train(tmp_path, robot, arms(model)[:1], PLAN)
    monkeypatch.setitem(testbeds.TASKS, "turn", replace(TASKS["turn"], steps=60))
    monkeypatch.setitem(testbeds.TASKS, "mixed", replace(TASKS["mixed"], steps=60))
    trials = DrawnTrials(robot, model, episodes=3)
    found = testbeds.held_out(trials, folders, 1e-3)
    scores = {name: rows["score"] for name, rows in found["agents"].items()}
    assert found["best"] == max(scores, key=scores.__getitem__)
    assert set(scores) == {"a-0", "a-1"}
    assert scores["a-0"] != scores["a-1"]
    again = testbeds.held_out(trials, folders, 1e-3)
    assert again == found
    dear = testbeds.held_out(trials, folders, 1.0)
    assert dear["agents"]["a-0"]["score"] < scores["a-0"]


def test_each_agent_swims_at_the_price_that_does_best(robot, model, tmp_path, monkeypatch):
    (folder,) = train(tmp_path, robot, arms(model)[:1], replace(PLAN, seeds=(0,)))
    agent = read_agent(folder / "policy.zip")
    column = np.linspace(-3, 3, len(agent.by_price["column"]))  # prices that decide how it beats
    agent.by_price["column"] = column.astype(np.float32)
    agent.save(folder / "policy.zip")
    prices = [2.0**one for one in testbeds.EXPONENTS]
    policies = {}
    for price in prices:
        set_price(agent, price)
        policies[price] = policy_of(agent)
    monkeypatch.setattr(testbeds, "PRICED", ("turn",))
    monkeypatch.setitem(testbeds.TASKS, "turn", replace(TASKS["turn"], steps=60))
    monkeypatch.setattr(testbeds, "controller_of", lambda *_: PolicyController(policies[1.0]))

    trials = DrawnTrials(robot, model, episodes=2)
    chosen = testbeds.choose_prices(trials, [folder])
    (price,) = chosen.values()
    assert read_agent(folder / "policy.zip").by_price["share"] == pytest.approx(np.log2(price))
    controllers = {str(one): PolicyController(policy) for one, policy in policies.items()}
    swum = trials.run(TASKS["turn"], controllers, testbeds.PRICE_SEED)
    spent = {one: summary(swum[str(one)], TASKS["turn"])["energy"] for one in prices}
    assert max(spent.values()) > 1.2 * spent[1.0]
    assert spent[price] <= 1.001 * spent[1.0], "nobody arrives, so that energy decides"
    assert testbeds.choose_prices(trials, [folder]) == chosen


def test_a_policy_is_called_with_a_price(tmp_path):
    assert with_price("runs/a/policy.zip@0.5") == ("runs/a/policy.zip", 0.5)
    assert with_price("me@home/policy.zip") == ("me@home/policy.zip", None)
    assert with_price("policy.npz@2") == ("policy.npz@2", None)
    assert shown("runs/a/policy.zip@0.5") == "a at 0.5"
    assert shown("runs/a/policy.zip") == "a"
    for name in ("policy.zip@", "policy.zip@fast"):
        with pytest.raises(InputError, match="expected a number"):
            with_price(name)


def test_trials_are_the_same_for_all(robot, model):
    ranges = Ranges((uniform("command_latency_s", 0.03, 0.09, "s", ""),))
    trials = DrawnTrials(robot, model, ranges, episodes=4)
    controllers = {name: controller_of("pnl", robot) for name in ("one", "other")}
    swims = trials.run(replace(TASKS["turn"], steps=80), controllers)
    one, other = swims["one"], swims["other"]
    assert np.allclose(one.pose, other.pose, atol=1e-6)
    assert np.ptp(one.rate[60].sum(axis=1)) > 1e-3, "robots differ from trial to trial"
