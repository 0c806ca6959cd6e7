"""``sim2real design --diagnosis``: files written, and the lines that refuse bad input."""

import json
import shlex

import pytest
from good_input import ROBOT
from rival_pair import RIVALS

from sim2real.cli import main
from sim2real.diagnose.result import DESIGN, to_design
from sim2real.recording import read_commands

SHORT = ["--seconds", "3.5", "--no-page"]


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder with a robot and a diagnosis."""
    (tmp_path / "robot.toml").write_text(ROBOT)
    write(tmp_path, [RIVALS.content()])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder, rivals):
    content = {"schema": "sim2real.diagnosis/1", "rival_sets": rivals}
    (folder / "diagnosis.json").write_text(json.dumps(content))


def noise(**changes):
    return {"noise": RIVALS.content()["noise"] | changes}


def design(*more):
    return main([*shlex.split(DESIGN)[1:], *SHORT, *more])


def refused(capsys, *parts):
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    for part in parts:
        assert part in lines[0]


def test_a_group_of_several_members_asks_for_a_design():
    plan = to_design([("j1", ("backlash",)), ("j2", ("command_filter", "sensor_filter"))])
    assert (plan.component, plan.separates) == ("j2", ("command_filter", "sensor_filter"))
    assert plan.command == DESIGN and plan.statement.endswith(DESIGN)
    assert to_design([("j1", ("backlash",))]) is None


def test_commands_context_and_what_they_are_to_tell_are_written(files, capsys):
    (files / "contexts.toml").write_text(
        '[[contexts]]\nname = "softer"\ngain_ratio = 0.2\nsupply_ratio = 0.9\n'
    )
    assert design("--contexts", "contexts.toml") == 0
    assert "separate Coulomb friction from" in capsys.readouterr().out
    assert read_commands(files / "next.csv").t.size == 175
    stated = json.loads((files / "next.json").read_text())
    (joint,) = stated["rivals"]
    assert joint["component"] == "j1"
    assert 0 < joint["entropy_after_nats"] < joint["entropy_before_nats"]
    chosen = stated["context"]
    assert chosen["name"] in ("softer", "as it is")
    assert chosen["gain_ratio"] == (0.2 if chosen["name"] == "softer" else 1.0)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda rivals: [rivals | {"component": "k9"}], ("diagnosis.json", "'k9'", "j1")),
        (lambda rivals: [], ("diagnosis.json", "rival_sets", "leaves some open")),
        (lambda rivals: [rivals | {"noise": {}}], ("diagnosis.json", "rival_sets[0].noise")),
        (lambda rivals: [rivals | noise(period_s=0)], ("noise.period_s", "above 0")),
        (lambda rivals: [rivals | noise(innovation_sd_rad=-1)], ("innovation_sd_rad", "above 0")),
        (lambda rivals: [rivals | noise(autoregression=[1e300])], ("autoregression", "1e75")),
    ],
)
def test_a_diagnosis_that_does_not_fit_is_one_line(files, capsys, change, parts):
    write(files, change(RIVALS.content()))
    assert design() == 2
    refused(capsys, *parts)
    assert not (files / "next.csv").exists()


def test_options_that_exclude_each_other_are_one_line(files, capsys):
    assert design("--inertia", "j1=0.002") == 2
    refused(capsys, "--inertia", "--diagnosis")
    given = ["--robot", "robot.toml", "--out", "next.csv", "--again"]
    assert main(["design", *given]) == 2
    refused(capsys, "--again", "--diagnosis")
