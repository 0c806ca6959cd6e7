"""The forecast: its statistics on known answers, its draws, its resumption, bad input."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rl.experiments.testbeds
from rl.experiments.named import named_controllers
from rl.experiments.statistics import best, effective, expected, interval
from rl.experiments.testbeds import SimulationSettings
from rl.forecast.forecast import limit_of
from rl.forecast.realities import (
    DEVIATIONS,
    TWIN_ERROR,
    Diagnosed,
    Possible,
    draw_realities,
    unexplained,
)
from rl.forecast.swims import Forecaster, Inexact, blocks, disturbances
from rl.forecast.trials import (
    Trials,
    first_order,
    narrowed_by_trials,
    ranked,
    read_trials,
    training_ranges,
    update,
)
from rl.make import draw_models, spread_of
from rl.task import CONTROL_S, TASKS
from sim.twin.law import FITTED
from sim.twin.twin import Twin
from sim2real.body import values
from sim2real.cli import main
from sim2real.diagnose.rival_sets import JointRivals, RivalSet
from sim2real.errors import InputError
from sim2real.model import read_model, write_model
from sim2real.posterior.posteriors import JointSample, write_sample
from sim2real.ranges.entry import Ranges, normal, uniform, write_ranges
from sim2real.recording import Load
from sim2real.servo.parameters import COLUMNS

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
POLICY = POOL / "agents" / "ablation" / "full-0" / "policy.npz"
BOTH = (POLICY, "pnl")
RANGES = Ranges(
    (
        uniform("command_latency_s", 0.06, 0.072, "s", ""),
        uniform("j1.kp_Nm_per_rad", 1.9, 2.3, "N m/rad", ""),
        uniform("j2.kp_Nm_per_rad", 1.9, 2.1, "N m/rad", ""),
        normal("body.position_noise_m", 0.0, 0.002, "m", "", "step"),
    ),
    posterior="posterior.npz",
)
GAINS = ("j1.kp_Nm_per_rad", "j2.kp_Nm_per_rad")


def sample(rng) -> JointSample:
    """Gains of two joints that are known together only: their sum hardly varies."""
    first = rng.normal(2.1, 0.1, 500)
    return JointSample(GAINS, ("N m/rad",) * 2, np.stack([first, 4.1 - first], axis=1))


def plant(rng, N, T, between, within, centre=10.0):
    """A figure whose distribution is known, and the true means of the realities."""
    mean = centre + between * rng.standard_normal(N)
    return mean[:, None] + within * rng.standard_normal((N, T)), mean


def even(N):
    return np.full(N, 1 / N)


def test_the_interval_of_the_mean_has_no_chance_of_single_trials_in_it():
    values, _ = plant(np.random.default_rng(1), 4000, 2, 1.0, 2.0)
    for trials, variance in ((np.inf, 1.0), (1, 5.0), (4, 2.0)):
        mean, low, high = interval(values, even(4000), trials)
        assert abs(mean - 10) < 0.1
        assert abs(high - low - 2 * 1.645 * np.sqrt(variance)) < 0.08 * 2 * np.sqrt(variance)


def test_rare_failures_do_not_narrow_the_interval_of_the_mean():
    rng = np.random.default_rng(14)
    values, mean = plant(rng, 400, 2, 1.0, 0.5)
    values[rng.random(values.shape) < 0.01] += 20.0
    _, low, high = interval(values, even(400))
    assert 0.85 < np.mean((low <= mean + 0.2) & (mean + 0.2 <= high)) < 0.95


def test_rare_failures_leave_the_share_that_arrives_uncertain():
    values = np.ones((200, 2))
    values[3, 1] = 0
    mean, low, high = interval(values, even(200))
    assert 0.9 < low < mean <= high <= 1
    for failed in ([], [(3, 0), (3, 1)], [(3, 0), (5, 0)]):  # none, with and without a common cause
        values = np.ones((200, 2))
        for at in failed:
            values[at] = 0
        weights = np.random.default_rng(1).dirichlet(np.full(200, 0.3))
        for known in (even(200), weights):
            mean, low, high = interval(values, known)
            assert low <= mean <= high <= 1 and mean < 1
            assert interval(values, known, 1)[1] <= low, "a trial is no better known than the mean"
    assert interval(np.ones((200, 2)), even(200))[1] == pytest.approx(0.9952, abs=1e-4), "Jeffreys"
    chance = expected((np.random.default_rng(0).random((3000, 2)) < 0.5).astype(float))
    assert abs(chance.mean() - 0.5) < 0.02 and chance.std() < 0.2


@pytest.mark.parametrize("failures", [0.0, 0.01])
def test_trials_sharpen_the_forecast_and_its_interval_holds(failures):
    rng, held, narrower = np.random.default_rng(2), [], []
    for _ in range(60):
        values, _ = plant(rng, 400, 2, 1.0, 0.7)
        values[rng.random(values.shape) < failures] += 20
        truth = 10 + rng.standard_normal()
        seen = Trials(0, ("time_s",), truth + 0.7 * rng.standard_normal((3, 1)))
        found = update([seen], {"time_s": values[None]})
        _, low, high = interval(values, found.weights)
        held.append(low <= truth + 20 * failures <= high)
        _, least, most = interval(values, even(400))
        narrower.append((high - low) / (most - least))
    assert 0.8 <= np.mean(held) <= 0.98
    exact = np.sqrt(1 / (1 + 3 / 0.49))
    assert abs(np.median(narrower) - exact) < 0.1


def test_trials_far_from_the_forecast_contradict_it():
    values, _ = plant(np.random.default_rng(3), 300, 2, 1.0, 1.0)
    figures = {"time_s": values[None], "energy": 3 * values[None] ** 2}
    near, far = (Trials(0, ("time_s",), np.full((3, 1), t)) for t in (10.5, 16.0))
    assert not update([near], figures).contradicted
    assert update([far], figures).contradicted
    assert update([far], figures).effective >= 19.9
    both = Trials(0, ("time_s", "energy"), np.array([[10.0, 300.0]]))
    fresh = update([both], figures)
    assert np.isclose(effective(fresh.weights), fresh.effective)


def test_the_cause_of_the_spread_is_ranked_first():
    rng = np.random.default_rng(4)
    parameters = rng.standard_normal((300, 5))
    mean = 3 * parameters[:, 1] + parameters[:, 4] ** 2
    shares = first_order(parameters, mean, ["a", "b", "a", "a", "c"])
    assert abs(shares["b"] - 9 / 11) < 0.08 and abs(shares["c"] - 2 / 11) < 0.08
    assert shares["a"] < 0.03
    noise = first_order(parameters, rng.standard_normal(300), ["a", "b", "a", "a", "c"])
    assert sum(noise.values()) < 0.1
    names = ["j1.kp_Nm_per_rad", "twin.along", "j1.latency_s", "twin.across", "law error.surge"]
    figures = {"time_s": mean[:, None] + 2 * rng.standard_normal((300, 2))}
    found = ranked(names, parameters, figures, even(300), ("j1",))
    water = next(x for x in found if x.what != "3 trials")
    assert water.what == "water" and water.shrinks["time_s"] > 0.45
    assert {x.what for x in found} >= {"servo j1", "latency", "law of the twin", "3 trials"}


def test_three_trials_narrow_as_far_as_the_update_by_them_does():
    rng, N = np.random.default_rng(11), 300
    values, _ = plant(rng, N, 2, 1.0, 0.7)
    exact, _ = plant(rng, N, 2, 1.0, 0.0)
    found = narrowed_by_trials({"time_s": values}, even(N), 3)["time_s"]
    assert abs(found - (1 - np.sqrt(1 / (1 + 3 / 0.49)))) < 0.1
    assert 0.8 < narrowed_by_trials({"time_s": exact}, even(N), 3)["time_s"] < 0.99
    same = {"success": np.eye(20).repeat(15, axis=0)[:, :2]}
    assert narrowed_by_trials(same, even(N), 3) == {"success": 0.0}, "no figure is observed"


def test_the_next_training_draws_what_matters_from_the_realities(robot, model):
    rng = np.random.default_rng(12)
    low, width = np.array([0.0, 1.0, 5.0, 2.0, 0.0]), np.array([1.0, 2.0, 1.0, 1.0, 1.0])
    parameters = low + width * rng.random((300, 5))
    names = ["j1.kp_Nm_per_rad", "twin.along", "j1.latency_s", "j2.kp_Nm_per_rad", DEVIATIONS[0]]
    z = (parameters - parameters.mean(axis=0)) / width
    values = (z @ [3.0, 2.0, 1.5, 0.0, 3.0])[:, None] + 0.1 * rng.standard_normal((300, 2))
    trained = {names[0]: [0.4, 0.6], names[1]: [0.0, 6.0], names[2]: [5.6, 6.6]}
    found = training_ranges(names, parameters, values, even(300), trained)
    assert [(x.parameter, x.advice) for x in found] == [
        (names[0], "widen"), ("body.twin.along", "narrow"), (names[2], "move"),
    ]  # fmt: skip
    assert np.allclose(found[1].drawn, [1.1, 2.9], atol=0.1)
    assert abs(found[0].share - 9 / (9 + 4 + 2.25 + 9)) < 0.08
    trained = {**trained, names[0]: [0.05, 0.95]}
    assert training_ranges(names, parameters, values, even(300), trained)[0].advice == "keep"
    unknown = training_ranges(names, parameters, values, even(300), None)
    assert {x.advice for x in unknown} == {"draw"} and unknown[0].trained is None
    entry = uniform("body.twin.along", 1.0, 3.0, "", "")
    drawn = draw_models(model, Ranges((entry,)), robot, 50, rng)
    low, high = spread_of(drawn)["twin.along"]
    assert 1.0 <= low < 1.4 and 2.6 < high <= 3.0, "what is advised can be drawn in training"


def test_an_effect_that_a_swim_showed_in_all_servos_is_drawn_for_each(model):
    sizes = {"j1.torque_Nm": 0.02, "j2.torque_Nm": 0.05}
    one = Possible("coulomb_friction", "servos", 1.0, sizes, dict.fromkeys(sizes, 0.0))
    drawn = Diagnosed((), (one,), {}).drawn(model, np.random.default_rng(0))
    found = {name: joint.effects for name, joint in drawn.joints.items() if joint.effects}
    assert {n: dict(e[0].parameters) for n, e in found.items()} == {
        "j1": {"torque_Nm": 0.02}, "j2": {"torque_Nm": 0.05}
    }  # fmt: skip


def test_the_best_policy_is_that_of_the_same_realities():
    values, _ = plant(np.random.default_rng(5), 500, 2, 5.0, 1.0)
    scores = np.stack([values, values + 0.3, values - 5])
    assert np.allclose(best(scores, even(500)), [0, 1, 0])


def test_a_limit_is_that_of_a_trial_or_of_a_share_of_all():
    limit, share = limit_of("time<=6"), limit_of("success >= 1@0.9")
    assert (limit.figure, limit.value, limit.share) == ("time_s", 6.0, None)
    assert str(share) == "success>=1@0.9"
    assert limit.kept(np.array([[5.0, 7.0]])).tolist() == [[1, 0]]
    for text in ("time<6", "speed<=2", "time_s<=6@1.5", "time_s<=+-"):
        with pytest.raises(InputError):
            limit_of(text)


def test_draws_are_joint_and_have_the_error_of_the_law(robot, model):
    rng = np.random.default_rng(6)
    drawn = draw_realities(robot, model, RANGES, sample(rng), 200, rng)
    gains = np.array([[m.joints[j].kp_Nm_per_rad for j in ("j1", "j2")] for m in drawn.models])
    assert np.allclose(gains.sum(axis=1), 4.1) and gains[:, 0].std() > 0.05
    assert not drawn.law.any(), "the law itself is drawn where no body was calibrated"
    across = drawn.values[:, drawn.names.index("twin.across")]
    assert across.std() > 0.5 and across.min() >= 0
    posterior = {"names": ["twin.along", "twin.linear"], "mean": [0.3, 0.2]}
    posterior["covariance"] = [[1e-4, -0.9e-4], [-0.9e-4, 1e-4]]
    body = {"twin": {"along": 0.3, "linear": 0.2, "slender": 3.6}, "posterior": posterior}
    known = (robot, replace(model, body=body), RANGES, sample(rng), 400, rng)
    made = draw_realities(*known)
    pair = made.values[:, [made.names.index(n) for n in posterior["names"]]]
    assert abs(np.corrcoef(pair.T)[0, 1] + 0.9) < 0.05
    assert abs(pair[:, 0].mean() - 0.3) < 0.005
    assert 0.03 < made.law[:, 0].std() < 0.1
    energy = json.loads(TWIN_ERROR.read_text())["energy"]
    assert abs(np.log1p(made.law[:, 3]).mean() - energy["mean"]) < energy["sd"] / 4
    slender = {one.body["twin"]["slender"] for one in made.models}
    assert slender == {3.6}, "a coefficient that was not fitted keeps its value in the calibration"


def test_effects_are_drawn_with_their_probabilities(model):
    friction = Possible("coulomb_friction", "j1", 0.7, {"torque_Nm": 0.05}, {"torque_Nm": 0.01})
    skin = {"stiffness_Nm_per_rad": 0.4}
    elastic = Possible("skin_elasticity", "body", 0.3, skin, {"stiffness_Nm_per_rad": 0.0})
    rough = Possible("surface_friction", "rubber", 1.0, {"coefficient": 0.02}, {"coefficient": 0.0})
    diagnosed, rng = Diagnosed((), (friction, elastic, rough), {}), np.random.default_rng(7)
    models = [diagnosed.drawn(model, rng) for _ in range(400)]
    rubbing = [m.joints["j1"].effects for m in models]
    assert abs(np.mean([bool(effects) for effects in rubbing]) - 0.7) < 0.08
    named = [values(m) for m in models]
    assert abs(np.mean(["skin_elasticity.stiffness_Nm_per_rad" in x for x in named]) - 0.3) < 0.08
    assert all(x["surface_friction.rubber.coefficient"] == 0.02 for x in named)
    calibrated = replace(model, body={"twin": vars(FITTED)})
    assert not values(diagnosed.drawn(calibrated, rng)), "the law has made up for what it lacks"
    torque = [effects[0].parameters["torque_Nm"] for effects in rubbing if effects]
    assert abs(np.mean(torque) - 0.05) < 0.003 and np.std(torque) > 0.005


def test_a_set_of_effects_is_drawn_with_its_gains(model):
    kp, torque = COLUMNS.index("kp_Nm_per_rad"), COLUMNS.index("coulomb_friction.torque_Nm")
    plain, rubbing = np.zeros(len(COLUMNS)), np.zeros(len(COLUMNS))
    plain[:4] = rubbing[:4] = 2.0, 0.07, 0.1, 0.002
    rubbing[[kp, torque]] = 2.2, 0.05
    columns = np.array([kp, torque], dtype=np.int32)
    precision = np.diag([0.02**-2, 0.005**-2])
    none = RivalSet((), 0.25, 0.0, plain, columns[:1], precision[:1, :1])
    some = RivalSet(("coulomb_friction",), 0.75, 9.0, rubbing, columns, precision)
    joint = JointRivals(
        component="j1", load=Load(0.002), period_s=0.02, noise_rad=0.001,
        autoregression=np.zeros(1), sets=(some, none),
    )  # fmt: skip
    diagnosed, rng = Diagnosed((joint,), (), {}), np.random.default_rng(10)
    drawn = [diagnosed.drawn(model, rng).joints["j1"] for _ in range(400)]
    with_it = np.array([bool(one.effects) for one in drawn])
    assert abs(with_it.mean() - 0.75) < 0.07
    gain = np.array([one.kp_Nm_per_rad for one in drawn])
    assert abs(gain[with_it].mean() - 2.2) < 0.01 and abs(gain[~with_it].mean() - 2.0) < 0.01
    assert abs(gain[with_it].std() - 0.02) < 0.004
    assert all(one.latency_s == model.joints["j1"].latency_s for one in drawn)


def test_what_is_unexplained_has_no_noise_in_it():
    fit = {"j1.position_rad": {"train": 1.0, "heldout": 5.0, "noise": 4.0}, "body.surge": {}}
    assert np.allclose(unexplained(fit, ("j1", "j2")), [0, 0, 0, 3, 0])
    rng = np.random.default_rng(8)
    signals = disturbances(np.array([2.0, 0.0]), 400, 50, rng)
    assert abs(signals[:, :, 0].std() - 2) < 0.2 and not signals[:, :, 1].any()
    steps = np.arange(300.0)[:, None] * np.array([1.0, -1.0])
    drawn = blocks([steps], 250, 3, rng)
    assert np.allclose(drawn[:, :, 0], -drawn[:, :, 1]), "signals of a block stay together"
    assert (np.diff(drawn[:100, :, 0], axis=0) == 1).all()


def test_an_inexact_simulator_changes_the_path_alone(robot, model):
    wave = 0.4 * np.sin(2 * np.pi * CONTROL_S * np.arange(100))[:, None] * [1.0, 1.0, 1.0]

    def path(law, disturbance):
        twin = Twin(robot, model, n_envs=2, threads=1)
        inexact = Inexact(twin, law, disturbance)
        inexact.reset(pose=np.array([[0.3, -0.2, 2.0]] * 2))
        live, poses = inexact.live(), []
        for row in wave:
            live.command.numpy()[:] = row
            inexact.advance()
            poses.append(live.q.numpy().copy())
        return np.array(poses), twin

    still = np.zeros((5, 2, 6), dtype=np.float32)
    same, twin = path(np.zeros((2, 3)), still)
    assert np.allclose(same[-1], twin.motion.q.numpy(), atol=1e-6)
    longer, _ = path(np.array([[0.0, 0.0, 0.0], [0.2, 0.2, 0.0]]), still)
    assert np.allclose(longer[:, 0], same[:, 0])
    way = np.linalg.norm(np.diff(longer[..., :2], axis=0), axis=2).sum(axis=0)
    assert abs(way[1] / way[0] - 1.2) < 0.01
    pushed = still.copy()
    pushed[:, :, 2] = 0.5
    turned = path(np.zeros((2, 3)), pushed)[0][:, :, 2] - same[:, :, 2]
    assert np.allclose(turned, 0.5 * CONTROL_S * np.arange(1, 101)[:, None])


def test_an_interrupted_forecast_resumes_with_the_same_results(robot, model, tmp_path, monkeypatch):
    rng, task = np.random.default_rng(9), replace(TASKS["near"], steps=15)
    drawn = draw_realities(robot, model, RANGES, sample(rng), 6, rng)
    policies = named_controllers([str(POLICY), "pnl"], robot)
    forecaster = Forecaster(robot, task, drawn, 2, 1, SimulationSettings(), at_once=3)
    runs = []
    episodes = rl.experiments.testbeds.run_episodes
    monkeypatch.setattr(
        rl.experiments.testbeds, "run_episodes", lambda *a, **k: runs.append(1) or episodes(*a, **k)
    )

    def go(file, progress=lambda share: None):
        return forecaster.swim(policies, file=file, progress=progress)

    def stop(share):
        if share > 0.4:
            raise KeyboardInterrupt

    whole, file = go(None), tmp_path / "kept.npz"
    with pytest.raises(KeyboardInterrupt):
        go(file, stop)
    runs.clear()
    resumed = go(file)
    assert len(runs) == 2
    for name, found in whole.items():
        assert np.array_equal(found, resumed[name], equal_nan=True)
    assert not np.allclose(whole["energy"][0], whole["energy"][1])


@pytest.fixture
def files(tmp_path, model):
    """The files of a robot; the policy is one of the pool's."""
    write_ranges(RANGES, tmp_path / "ranges.json")
    write_sample(sample(np.random.default_rng(0)), tmp_path / "posterior.npz")
    write_model(model, tmp_path / "model.json")

    def call(*more, policy=POLICY, **changed):
        options = {
            "robot": POOL / "robot.toml", "model": tmp_path / "model.json",
            "ranges": tmp_path / "ranges.json", "out": tmp_path / "forecast.json",
            "realities": 20, "seconds": 0.4, "threads": 1, **changed,
        }  # fmt: skip
        listed = [str(x) for key, value in options.items() for x in (f"--{key}", value)]
        policies = [policy] if isinstance(policy, Path) else policy
        return main(["forecast", *map(str, policies), *listed, *map(str, more)])

    return SimpleNamespace(call=call, folder=tmp_path)


def test_the_command_writes_forecast_and_page_and_trials_update_it(files, capsys):
    assert files.call("--limit", "time<=6@0.9", policy=BOTH, realities=80) == 0
    content = json.loads((files.folder / "forecast.json").read_text())
    time = content["policies"]["full-0"]["time_s"]
    assert np.allclose([time["mean"], *time["next_trial_90"]], 0.4), "none arrives so soon"
    energy = content["policies"]["pnl"]["energy"]
    assert energy["mean_90"][0] < energy["mean"] < energy["mean_90"][1]
    assert content["policies"]["pnl"]["limits"] == {"time_s<=6@0.9": pytest.approx(1, abs=0.2)}
    assert np.isclose(sum(x["best"] for x in content["ranking"]), 1)
    assert str(files.folder / "posterior.npz") in content["provenance"]["inputs"]
    page = (files.folder / "forecast.html").read_text()
    assert "intervals have been worth" in page
    assert "What to measure next" in page and "Which policy" in page
    likely = [x["best"] for x in content["ranking"]]
    assert likely == sorted(likely, reverse=True) and len(likely) == 2
    learned = content["ranking"][0]["policy"] == "full-0"  # a controller is not trained
    assert bool(content["train_next"]) == ("What to randomize next" in page) == learned
    energy = energy["mean"]
    trials = files.folder / "trials.csv"
    trials.write_text(f"policy,success,energy\npnl,0,{energy}\npnl,0,{1.01 * energy}\n")
    assert files.call("--trials", trials, "--no-page", policy=BOTH) == 0
    content = json.loads((files.folder / "forecast.json").read_text())
    assert content["update"]["trials"] == 2 and not content["update"]["contradicted"]
    assert "agree with the forecast" in capsys.readouterr().out
    assert files.call("--no-page", "--rank-by", "energy", realities=80) == 0
    (first, *_) = json.loads((files.folder / "forecast.json").read_text())["train_next"]
    low, high = first["trained"]
    assert low <= high, "the shipped policy states its ranges"


def test_bad_input_is_one_line(files, capsys):
    def refused(words, *more, **changed):
        assert files.call(*more, **changed) == 2
        error = capsys.readouterr().err.strip()
        assert "\n" not in error.split("sim2real forecast: ")[-1]
        assert words in error, error

    text = (POOL / "robot.toml").read_text()
    other = files.folder / "other.toml"
    other.write_text(text.replace('"j1"', '"k1"'))
    refused("k1", robot=other)
    refused("found no file", policy=files.folder / "none.zip")
    without = files.folder / "without.json"
    write_ranges(replace(RANGES, posterior=""), without)
    refused("posterior", ranges=without)
    write_ranges(replace(RANGES, posterior="lost.npz"), without)
    refused("lost.npz", ranges=without)
    entries = (uniform("j1.kp_Nm_per_rad", 5.0, 5.2, "N m/rad", ""),)
    write_ranges(replace(RANGES, entries=entries), without)
    refused("the model's 2.1 within", ranges=without)
    refused("FIGURE<=VALUE", "--limit", "soon")
    refused("at least 20", realities=3)
    trials = files.folder / "trials.csv"
    for table, words in (
        ("policy,time_s\nfull-0,3\n", "a column success"),
        ("policy,success\nfull-0,1\n", "one of time_s"),
        ("policy,success,time_s\nbest,1,3\n", "row 2"),
        ("policy,success,time_s\nfull-0,perhaps,3\n", "0 or 1"),
        ("policy,success,time_s\nfull-0,1,\n", "a number"),
    ):
        trials.write_text(table)
        refused(words, "--trials", trials)
    with pytest.raises(InputError):
        read_trials(trials, ["full-0"], 20.0)
    assert read_model(files.folder / "model.json").joints
