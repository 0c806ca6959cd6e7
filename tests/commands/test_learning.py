"""``train``, ``evaluate`` and ``ablate`` from the command line: a small run, and bad input."""

import argparse
import json
import pickle
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from good_input import refused

from sim2real.cli import main
from sim2real.errors import InputError

pytest.importorskip("torch", reason="the extra 'rl' is not installed")

from rl.commands.options import COMMANDS
from rl.commands.reproduce import RESULTS
from rl.experiments.ablation import ARMS
from rl.sac.checkpoint import COLUMNS
from rl.sac.plan import RECIPES
from rl.task import TASKS

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
FILES = ["--robot", str(POOL / "robot.toml"), "--model", str(POOL / "model.json")]
SMALL = ["--task", "near", "--envs", "2", "--steps", "2000", "--segment", "1000"]


def test_a_policy_is_trained_and_evaluated(tmp_path, capsys, monkeypatch):
    few = ["--updates-per-step", "0.01", "--ranges", str(POOL / "ranges.json"), "--trials", "2"]
    with monkeypatch.context() as patch:
        for name, task in TASKS.items():  # the trials that choose the price and the best agent
            patch.setitem(TASKS, name, replace(task, steps=50))
        assert main(["train", *FILES, *SMALL, *few, "--out", str(tmp_path / "run")]) == 1
    policy = tmp_path / "run" / "policy-0" / "policy.zip"
    said = capsys.readouterr().out
    assert str(policy) in said
    assert said.splitlines()[-1].startswith("did not learn: policy-0 reaches 0 %")
    assert json.loads((tmp_path / "run" / "trials.json").read_text())["best"] == "policy-0"
    assert (tmp_path / "run" / "curve.png").exists()
    out, plot = tmp_path / "turn.json", tmp_path / "turn.png"
    call = ["evaluate", str(policy), "pnl", *FILES, "--episodes", "3"]
    assert main([*call, "--out", str(out), "--plot", str(plot)]) == 0
    results = json.loads(out.read_text())["results"]
    assert results["pnl"]["success"] == 1.0, "proportional navigation makes the turn in the twin"
    assert results[str(policy)]["episodes"] == 3
    assert plot.stat().st_size > 5000


def test_what_the_paper_shows_is_one_command(tmp_path, capsys, monkeypatch):
    """Each result has its figure and its numbers; kept policies are stages before the last."""
    agent, out = tmp_path / "run" / "policy-0", tmp_path / "out"
    agent.mkdir(parents=True)
    for stage, source in (("policy-900.npz", "no-servo-0"), ("policy.npz", "full-0")):
        shutil.copy(POOL / "agents" / "ablation" / source / "policy.npz", agent / stage)
    rows = [f"{k},70,{k / 100},0.5,90,0,0,0,0" for k in range(100, 1800, 100)]
    (agent / "progress.csv").write_text("\n".join([",".join(COLUMNS), *rows]) + "\n")
    for name, task in TASKS.items():
        monkeypatch.setitem(TASKS, name, replace(task, steps=60))
    monkeypatch.chdir(POOL.parents[1])
    call = ["reproduce", *RESULTS, "--run", str(agent.parent), "--out", str(out), "--episodes", "2"]
    assert main(call) == 0
    results = json.loads((out / "results.json").read_text())
    assert list(results["stages"]) == ["A", "B"]
    assert results["stages"]["A"] != results["stages"]["B"]
    assert list(results["pentagram"]) == ["policy-0", "pnl", "adrc", "discrete-cpg"]
    assert 0 < results["turn"]["apart_m"] < 0.2, "of the same policy from the same start"
    assert results["calibration"]["sine"]["joint 1 (rad)"] < 0.05
    for name in (*RESULTS, "pentagram-bars"):
        assert (out / f"{name}.png").stat().st_size > 5000
    assert (out / "turn.mp4").exists()
    page = (out / "index.html").read_text()
    assert "SHA-256" in page and "discrete-cpg/policy.zip" in page
    assert re.search(r"0 of 2</td>\s*<td[^>]*>1\.20 ± 0\.00</td>", page)
    capsys.readouterr()
    assert main([*call[:-4], "--out", str(out), "--run", str(tmp_path / "none")]) == 2
    assert "no progress.csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--steps", "0"], "--steps: found 0"),
        (["--segment", "10"], "--segment: found 10"),
        (["--device", "cuda:0"], "--device: found cuda:0"),
    ],
)
def test_bad_options_are_refused_in_one_line(more, said, tmp_path, capsys):
    import torch

    if "cuda:0" in more and torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    status = main(["train", *FILES, *SMALL, *more, "--out", str(tmp_path / "run")])
    refused(capsys, status, said)


def test_a_reality_that_is_none_is_refused_before_any_training(tmp_path, capsys):
    bad, out = tmp_path / "bad.py", tmp_path / "run"
    bad.write_text("def make(robot, n, seed, device): ...")
    files = [*FILES, "--ranges", str(POOL / "ranges.json"), "--reality", str(bad)]
    status = main(["ablate", *files, "--reality-cell-m", "0.02", "--out", str(out)])
    refused(capsys, status, f"{bad}: make: found")
    assert not out.exists()


def test_the_fifth_arm_needs_an_enriched_model(tmp_path, capsys):
    files = [*FILES, "--ranges", str(POOL / "ranges.json"), "--reality", str(POOL / "reality.json")]
    call = ["ablate", *files, "--arms", "all-and-effects", "--out", str(tmp_path)]
    refused(capsys, main(call), "--enriched")


@pytest.mark.parametrize("name", ["train", "evaluate", "ablate", "forecast"])
def test_the_options_offer_every_name_that_there_is(name):
    """They repeat the names, as what defines them imports PyTorch."""
    known = {"task": TASKS, "arms": ARMS, "recipe": RECIPES}
    parser = argparse.ArgumentParser()
    COMMANDS[name].add(parser)
    offered = {one.dest: one.choices for one in parser._actions if one.dest in known}
    assert offered, "a command of these has names to offer"
    for option, choices in offered.items():
        assert set(choices) == set(known[option])


def test_an_input_error_keeps_its_parts_on_the_way_from_another_process():
    error = InputError("a.csv", "row 1", "x", "y")
    again = pickle.loads(pickle.dumps(error))
    assert (again.file, again.where, again.found, again.expected) == ("a.csv", "row 1", "x", "y")
    assert str(again) == str(error)
