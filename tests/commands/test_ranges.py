"""``sim2real ranges``: what it writes, what it refuses, and that it goes on where it was."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated
from good_input import refused

from sim2real.cli import main
from sim2real.model import read_model, write_model
from sim2real.posterior.chain import chain_file, read_chain
from sim2real.posterior.posteriors import read_sample
from sim2real.progress import MANY, shared
from sim2real.ranges.entry import read_ranges
from sim2real.recording import write_recording

ROOT = Path(__file__).parents[2]
DATA = ROOT / "datasets" / "servo_steps"
MODEL = ROOT / "reports" / "servo_steps" / "model.json"
STEPS = 250


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """The command line for eight seconds of linear servos, like those of the shipped model."""
    file = tmp_path_factory.mktemp("bench") / "steps.csv"
    recording, linear = simulated.linear_bench(read_model(MODEL))
    model = file.with_name("model.json")
    write_model(linear, model)
    write_recording(recording, file)

    def words(out, *more, steps=STEPS):
        robot = ["--robot", str(DATA / "robot.toml"), "--model", str(model)]
        size = ["--steps", str(steps), "--walkers", "16"]
        return ["ranges", str(file), *robot, "--out", str(out), *size, *more]

    return words


@pytest.fixture(scope="module")
def written(command, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ranges")
    assert main(command(folder / "ranges.json")) == 0
    return folder


def test_files(written):
    ranges = read_ranges(written / "ranges.json")
    content = json.loads((written / "ranges.json").read_text())
    assert {entry["period"] for entry in content["ranges"]} == {"episode", "step"}
    assert ranges.posterior == "posterior.npz"
    assert len(ranges.provenance["inputs"]) == 3
    sample = read_sample(written / ranges.posterior)
    assert sample.values.shape[1] == 9 and len(sample.names) == 9
    kp = ranges.named("j2.kp_Nm_per_rad")
    column = sample.values[:, sample.names.index("j2.kp_Nm_per_rad")]
    assert 0.85 < np.mean((column > kp.first) & (column < kp.second)) < 0.95
    latency = ranges.named("command_latency_s")
    assert latency.first < latency.second < 0.08


def test_page_shows_every_number_and_its_source(written):
    page = (written / "ranges.html").read_text().replace("<wbr>", "").replace("\u00a0", " ")
    for entry in read_ranges(written / "ranges.json").entries:
        assert entry.parameter in page and entry.source in page
    assert "Posterior of j3" in page and "Predictive check" in page
    assert page.count("<svg") >= 8


def test_it_goes_on_where_it_was(command, written, tmp_path):
    """A chain cut back to half its steps, as a kill leaves it, ends as the uninterrupted one."""
    short = tmp_path / "short.json"
    assert main(command(short, "--no-page", steps=120)) == 2  # too short to publish, but kept
    assert not short.exists()
    assert main(command(short, "--no-page")) == 0
    for joint in ("j1", "j2", "j3"):
        a = read_chain(chain_file(short, joint))
        b = read_chain(chain_file(written / "ranges.json", joint))
        assert np.array_equal(a.coordinates, b.coordinates)
        assert np.array_equal(a.log_density, b.log_density)


def test_an_interrupt_is_one_line(command, tmp_path):
    """In the likelihood, where emcee prints a traceback of every exception."""
    out = tmp_path / "ranges.json"
    call = [sys.executable, "-m", "sim2real.cli", *command(out, "--no-page", steps=100_000)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    search = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(call, env=search, start_new_session=True, **pipes)
    while not list(tmp_path.glob("ranges.chain.*.npz")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    printed, said = process.communicate()
    assert (process.returncode, printed) == (1, "")
    assert said == "sim2real ranges: interrupted; the same call resumes\n"
    assert read_chain(next(tmp_path.glob("*.npz"))).steps >= 100


def test_processes_leave_interrupts_to_the_first():
    """Which ends them: each would print a traceback of its own."""
    before = signal.getsignal(signal.SIGINT)
    assert set(shared(signal.getsignal, [signal.SIGINT] * MANY)) == {signal.SIG_IGN}
    assert signal.getsignal(signal.SIGINT) == before


def test_names_with_slashes_and_markup(tmp_path, monkeypatch):
    """In every name of a file and on every page."""
    monkeypatch.chdir(tmp_path)
    name = "left/<b>pan"
    steps, _ = simulated.linear_bench(read_model(MODEL))
    one = replace(steps, joints=(name,), command=steps.command[:, :1], columns={},
                  position=steps.position[:, :1], loads={name: steps.loads["j1"]})  # fmt: skip
    write_recording(one, tmp_path / "steps.csv")
    robot = (DATA / "robot.toml").read_text().replace('"j1"', f'"{name}"')
    (tmp_path / "robot.toml").write_text(robot)
    known = ["steps.csv", "--robot", "robot.toml"]
    assert main(["identify", *known, "--law", "pd", "--out", "m.json"]) == 0
    fit = ["--model", "m.json", "--steps", str(STEPS), "--walkers", "16"]
    assert main(["ranges", *known, *fit, "--out", "r.json"]) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert {"m.left%2F<b>pan.png", "r.chain.left%2F<b>pan.npz", "r.html"} <= written
    assert not any(path.is_dir() for path in tmp_path.iterdir())
    page = (tmp_path / "r.html").read_text()
    assert "&lt;b&gt;pan" in page and "<b>pan" not in page


@pytest.mark.parametrize(
    "damage",
    [
        lambda a: a.pop("random_keys"),
        lambda a: a.update(coordinates=a["coordinates"] * np.nan),
        lambda a: a.update(random_keys=a["random_keys"][:5]),
    ],
)
def test_a_damaged_chain_is_one_line(damage, command, written, tmp_path, capsys):
    out = tmp_path / "ranges.json"
    file = chain_file(out, "j1")
    with np.load(chain_file(written / "ranges.json", "j1")) as content:
        arrays = dict(content)
    damage(arrays)
    np.savez(file, **arrays)
    refused(capsys, main(command(out, "--no-page")), "ranges.chain.j1.npz")
    assert not out.exists()
