"""``sim2real design``, with and without a diagnosis: what it writes, and what it refuses."""

import json

import numpy as np
import pandas as pd
import pytest
from good_files import CONTEXTS_TOML
from good_input import ROBOT, message, refused
from rival_pair import RIVALS

from sim2real.cli import main
from sim2real.design.limits import AS_IT_IS, read_contexts
from sim2real.diagnose.result import DESIGN, to_design
from sim2real.model import JointModel, Model, write_model
from sim2real.recording import Load, read_commands, read_recording

TRUTH = {"kp_Nm_per_rad": 2.2, "kd_Nms_per_rad": 0.06, "latency_s": 0.05}
INERTIA = 0.002


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_robot(tmp_path)
    return tmp_path


def write_robot(folder, limits="[-0.8, 0.8]", speed="5.24"):
    text = ROBOT.replace("[-0.8, 0.8]", limits).replace("5.24", speed)
    (folder / "robot.toml").write_text(text)


def design(*more):
    return main(["design", "--robot", "robot.toml", "--out", "next.csv", *more])


def test_what_is_written_is_played_and_predicted(folder, capsys):
    assert design("--inertia", f"j1={INERTIA}", "--seconds", "4") == 0
    said = capsys.readouterr()
    assert "latency" in said.out and said.err == ""
    assert list(pd.read_csv("next.csv")) == ["t_s", "j1.command_rad"]
    commands = read_commands("next.csv")
    assert commands.duration_s == pytest.approx(4 - 0.02)
    assert commands.loads["j1"].inertia_kgm2 == INERTIA
    promised = json.loads((folder / "next.json").read_text())["design"]["j1"]
    assert promised["belief"] == "data sheet"
    assert 0 < promised["expected"]["kp_Nm_per_rad"]["relative_half_width"] < 0.1
    assert "next.csv" in said.out and "<svg" in (folder / "next.html").read_text()

    assert main(["record", "next.csv", "--robot", "robot.toml", "--dry-run"]) == 0
    assert "changed by its limits" not in capsys.readouterr().out
    model = Model({"j1": JointModel(*TRUTH.values(), INERTIA)})
    write_model(model, "model.json")
    assert main(["predict", "model.json", "next.csv", "--out", "predicted.csv"]) == 0
    assert np.ptp(read_recording("predicted.csv").position) > 0.3


@pytest.mark.parametrize(
    ("limits", "speed", "more", "parts"),
    [
        ("[-0.8, 0.8]", "5.24", ["--seconds", "2"], ["--seconds: found 2 s, expected 3.3 s"]),
        ("[0.0, 0.004]", "5.24", [], ["limits_rad", "less than two steps"]),
        ("[-0.8, 0.8]", "0.1", [], ["no_load_speed_rad_s", "expected at least 0.209 rad/s"]),
        ("[-0.8, 0.8]", "5.24", ["--inertia", "j2=0.1"], ["--inertia", "j1"]),
        ("[-0.8, 0.8]", "5.24", ["--model", "none.json"], ["none.json", "no such file"]),
        ("[-0.8, 0.8]", "5.24", ["--model", "other.json"], ["tail"]),
        ("[-0.8, 0.8]", "5.24", ["--out", "next.txt"], ["next.txt", ".csv"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(folder, capsys, limits, speed, more, parts):
    write_robot(folder, limits, speed)
    write_model(Model({"tail": JointModel(*TRUTH.values(), INERTIA)}), "other.json")
    refused(capsys, design(*more), *parts)
    assert not list(folder.glob("next*"))


def tell_apart(folder, rivals, *more):
    content = {"schema": "sim2real.diagnosis/1", "rival_sets": rivals}
    (folder / "diagnosis.json").write_text(json.dumps(content))
    return design("--diagnosis", "diagnosis.json", "--seconds", "3.5", "--no-page", *more)


def noise(**changes):
    return {"noise": RIVALS.content()["noise"] | changes}


def test_a_group_of_several_members_asks_for_a_design():
    plan = to_design([("j1", ("backlash",)), ("j2", ("command_filter", "sensor_filter"))])
    assert (plan.component, plan.separates) == ("j2", ("command_filter", "sensor_filter"))
    assert plan.command == DESIGN and plan.statement.endswith(DESIGN)
    assert to_design([("j1", ("backlash",))]) is None


def test_commands_context_and_what_they_are_to_tell_are_written(folder, capsys):
    (folder / "contexts.toml").write_text(
        '[[contexts]]\nname = "softer"\ngain_ratio = 0.2\nsupply_ratio = 0.9\n'
    )
    assert tell_apart(folder, [RIVALS.content()], "--contexts", "contexts.toml") == 0
    assert "separate Coulomb friction from" in capsys.readouterr().out
    assert read_commands("next.csv").t.size == 175
    stated = json.loads((folder / "next.json").read_text())
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
def test_a_diagnosis_that_does_not_fit_is_one_line(folder, capsys, change, parts):
    refused(capsys, tell_apart(folder, change(RIVALS.content())), *parts)
    assert not list(folder.glob("next*"))


def test_options_that_exclude_each_other_are_one_line(folder, capsys):
    status = tell_apart(folder, [RIVALS.content()], "--inertia", "j1=0.002")
    refused(capsys, status, "--inertia", "--diagnosis")
    refused(capsys, design("--again"), "--again", "--diagnosis")
    assert not list(folder.glob("next*"))


def contexts(folder, text):
    path = folder / "contexts.toml"
    path.write_text(text)
    return read_contexts(path)


def test_loads_and_ratios_are_those_of_the_file(tmp_path):
    (arm,) = contexts(tmp_path, CONTEXTS_TOML)
    assert arm.name == "second arm"
    assert arm.load(RIVALS) == Load(0.004, 0.05, 0.1)
    assert AS_IT_IS.load(RIVALS) == RIVALS.load
    text = '[[contexts]]\nname = "low"\nsupply_ratio = 0.5\ngain_ratio = 2.0\n'
    (low,) = contexts(tmp_path, text)
    assert (low.supply, low.gain) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "contexts"),
        ('[[contexts]]\nname = "same"\n', "a context that changes nothing"),
        ('[[contexts]]\nname = "x"\ngains = 2.0\n', "contexts[0].gains"),
        ('[[contexts]]\nname = "x"\nsupply_ratio = 0.0\n', "contexts[0].supply_ratio"),
        ('[[contexts]]\nname = "x"\ngain_ratio = 1e5\n', "a ratio from 0.001 to 1000"),
        (CONTEXTS_TOML + CONTEXTS_TOML, "two contexts named 'second arm'"),
        (CONTEXTS_TOML.replace("0.004", "-1"), "contexts[0].loads.j1.inertia_kgm2"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, expected):
    message(lambda: contexts(tmp_path, text), expected)
