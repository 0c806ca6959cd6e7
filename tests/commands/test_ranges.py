"""``sim2real ranges``: what it writes, what it refuses, and that it goes on where it was."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim2real.cli import main
from sim2real.posterior.chain import chain_file, read_chain, write_chain
from sim2real.posterior.posteriors import read_sample
from sim2real.ranges.entry import read_ranges
from sim2real.recording import read_recording, write_recording

ROOT = Path(__file__).parents[2]
DATA = ROOT / "datasets" / "servo_steps"
MODEL = ROOT / "reports" / "servo_steps" / "model.json"
STEPS = 250


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """The command line for the first eight seconds of a shipped recording."""
    file = tmp_path_factory.mktemp("bench") / "steps.csv"
    write_recording(read_recording(DATA / "steps.csv").between(0, 400), file)

    def words(out, *more, steps=STEPS):
        robot = ["--robot", str(DATA / "robot.toml"), "--model", str(MODEL)]
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


def test_a_finished_chain_is_not_run_again(command, written, tmp_path):
    for joint in ("j1", "j2", "j3"):
        name = chain_file(written / "ranges.json", joint).name
        (tmp_path / name).write_bytes((written / name).read_bytes())
    assert main(command(tmp_path / "ranges.json", "--no-page")) == 0
    again, first = (read_ranges(f / "ranges.json") for f in (tmp_path, written))
    assert again.entries == first.entries
    assert np.array_equal(
        read_sample(tmp_path / "posterior.npz").values,
        read_sample(written / "posterior.npz").values,
    )


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


def test_too_short_says_what_to_do(command, tmp_path, capsys):
    assert main(command(tmp_path / "ranges.json", "--no-page", steps=30)) == 2
    message = capsys.readouterr().err
    assert "run again with --steps" in message and message.count("\n") == 1
    assert not (tmp_path / "ranges.json").exists()


def test_a_chain_of_something_else_is_refused(command, written, tmp_path, capsys):
    chain = read_chain(chain_file(written / "ranges.json", "j1"))
    out = tmp_path / "ranges.json"
    write_chain(chain, chain_file(out, "j1"))
    assert main(command(out, "--no-page", "--seed", "5")) == 2
    assert "remove the file" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--steps", "--walkers"])
def test_numbers_that_mean_nothing(command, tmp_path, capsys, option):
    assert main(command(tmp_path / "ranges.json", option, "0")) == 2
    assert option.strip("-") in capsys.readouterr().err


@pytest.mark.parametrize("name", ["ranges", "density"])
def test_help_has_an_example(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    assert f"sim2real {name} " in capsys.readouterr().out.split("example:")[1]


def test_content_is_plain_json(written):
    content = json.loads((written / "ranges.json").read_text())
    assert {e["period"] for e in content["ranges"]} == {"episode", "step"}
