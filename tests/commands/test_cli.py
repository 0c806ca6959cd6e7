"""The command line: what it writes, what it says, and how it leaves."""

import argparse
import importlib
import inspect
import json
import pickle
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from good_input import refused

import sim.verbs
import sim2real as s2r
import sim2real.exchange
import sim2real.verbs
from sim2real import cli
from sim2real.cli import main, parser
from sim2real.commands.command import described_arguments
from sim2real.model import read_model
from sim2real.recording import read_recording

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "datasets" / "servo_steps"
MODEL = ROOT / "reports" / "servo_steps" / "model.json"
COMMANDS = list(cli.COMMANDS)


@pytest.fixture
def bench(tmp_path):
    """Ten seconds of one shipped recording, with its robot."""
    table = pd.read_csv(DATA / "steps.csv").iloc[:500]
    table.to_csv(tmp_path / "steps.csv", index=False)
    shutil.copy(DATA / "steps.json", tmp_path)
    shutil.copy(DATA / "robot.toml", tmp_path)
    return tmp_path


def identify(folder, *more, out="model.json"):
    robot = ("--robot", str(folder / "robot.toml"))
    return main(["identify", str(folder / "steps.csv"), *robot, "--out", str(folder / out), *more])


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert f"sim2real {command} " in text.split("example:")[1]
    assert "--seed" in text


def test_every_command_of_a_file_of_options_is_listed():
    listed = {home for home, _ in cli.COMMANDS.values()}
    found = {name: home for home in listed for name in importlib.import_module(home).COMMANDS}
    assert found == {name: home for name, (home, _) in cli.COMMANDS.items()}


def test_json_is_all_of_standard_output(bench, capsys):
    assert identify(bench, "--no-plots", "--json") == 0
    output = capsys.readouterr()
    written = json.loads((bench / "model.json").read_text())
    assert json.loads(output.out) == written
    assert "RMSE" in output.err
    assert main(["check", str(bench / "steps.csv"), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["recording"] == "steps"
    assert found["joints"][0]["moves"] > 3
    table = pd.read_csv(bench / "steps.csv")
    for joint in ("j1", "j2", "j3"):
        table[f"{joint}.position_rad"] += 2 * np.pi * (table["t_s"] > 5)
    table.to_csv(bench / "turned.csv", index=False)
    shutil.copy(bench / "steps.json", bench / "turned.json")
    assert main(["check", str(bench / "turned.csv"), "--json"]) == 2
    (found,) = json.loads(capsys.readouterr().out)  # the errors, too
    assert "error" in json.dumps(found)
    assert main(["density", str(bench / "robot.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["links"][0] == "head"
    run = ["predict", str(bench / "model.json"), str(bench / "steps.csv"), "--json", "--out"]
    assert main([*run, str(bench / "p.csv")]) == 0
    assert json.loads(capsys.readouterr().out) == {"out": str(bench / "p.csv")}


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_completes_commands_and_options(shell, capsys):
    pytest.importorskip("shtab")
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("identify", "calibrate-camera", "--held-out", "--fidelity"):
        assert word in script


def test_no_command_is_bad_input():
    with pytest.raises(SystemExit) as stop:
        main([])
    assert stop.value.code == 2


def test_identify_then_predict(bench, capsys):
    assert identify(bench) == 0
    output = capsys.readouterr()
    assert output.err == "", "silent in a pipe but for the table"
    assert "kp" in output.out
    assert "RMSE" in output.out
    model = read_model(bench / "model.json")
    assert model.joints["j1"].kp_Nm_per_rad == pytest.approx(1.38, rel=0.03)
    assert len(model.provenance["inputs"]) == 2
    for joint in model.joints:
        assert (bench / f"model.{joint}.png").read_bytes().startswith(b"\x89PNG")

    commands = pd.read_csv(bench / "steps.csv")
    columns = [c for c in commands if not c.endswith("position_rad")]
    commands[columns].to_csv(bench / "commands.csv", index=False)
    out = bench / "predicted.csv"
    assert main(["predict", str(bench / "model.json"), str(bench / "commands.csv"),
                 "--out", str(out)]) == 0  # fmt: skip
    predicted, measured = read_recording(out), read_recording(bench / "steps.csv")
    np.testing.assert_array_equal(predicted.t, measured.t)
    np.testing.assert_allclose(predicted.command, measured.command)
    assert np.nanstd(predicted.position - measured.position) < 0.0025
    assert not measured.is_simulated


def test_a_fit_of_a_prediction_says_so(bench, capsys):
    sidecar = json.loads((bench / "steps.json").read_text())
    context = {"gain_ratio": 0.8}
    sidecar |= {"context": context, "started": "2025-01-01T00:00:00+00:00"}
    (bench / "steps.json").write_text(json.dumps(sidecar))
    out = bench / "predicted.csv"
    assert main(["predict", str(MODEL), str(bench / "steps.csv"), "--out", str(out)]) == 0
    written = read_recording(out)
    assert written.metadata == {"context": context, "simulated": True}
    assert capsys.readouterr().err == ""
    run = ["identify", str(out), "--robot", str(bench / "robot.toml"), "--no-plots"]
    assert main([*run, "--out", str(bench / "again.json")]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"sim2real identify: warning: {out}: simulated, not measured")


def test_check_prints_and_writes_nothing(bench, capsys):
    before = sorted(bench.iterdir())
    assert main(["check", str(bench / "steps.csv"), "--robot", str(bench / "robot.toml")]) == 0
    text = capsys.readouterr().out
    assert "Hz, jitter" in text
    assert "can identify: kp" in text
    assert sorted(bench.iterdir()) == before


def test_bad_input_is_one_line_and_nothing_is_written(bench, capsys):
    (bench / "steps.json").write_text("{")
    before = sorted(bench.iterdir())
    refused(capsys, identify(bench), "steps.json", "JSON")
    assert sorted(bench.iterdir()) == before


def test_an_output_that_cannot_be_written_is_refused_before_any_work(bench, capsys, monkeypatch):
    def never(*_, **__):
        raise AssertionError("worked first")

    monkeypatch.setattr("sim2real.identification.identify.identify", never)
    refused(capsys, identify(bench, out="steps.csv/model.json"), "can't be written")
    refused(capsys, identify(bench, out="."), "a folder")


def test_predict_refuses_what_it_cannot_run(bench, capsys):
    content = json.loads(MODEL.read_text())
    del content["joints"]["j1"]
    (bench / "model.json").write_text(json.dumps(content))
    run = ["predict", str(bench / "model.json"), str(bench / "steps.csv"), "--out"]
    refused(capsys, main([*run, str(bench / "p.csv")]), "joint j1")
    assert not (bench / "p.csv").exists()


class InThisProcess(nullcontext):
    """An executor whose work is done where it is submitted, and pickled as by another process."""

    def __init__(self, *_):
        super().__init__(self)

    def submit(self, work, *given):
        value = pickle.dumps(work(*given))
        return SimpleNamespace(result=lambda: pickle.loads(value))

    def shutdown(self, **_):
        pass


def test_demo_ends_in_a_page(short, tmp_path, capsys, monkeypatch):
    """With ten seconds of each recording, and the shipped agents in short trials."""
    demo = pytest.importorskip("rl.commands.demo", reason="no extra 'rl'")
    from rl.task import TASKS
    from sim.inference.coordinates import candidates

    out, data = tmp_path / "demo", short / "datasets"
    # in this process, where the trials are short
    monkeypatch.setattr(demo, "ProcessPoolExecutor", InThisProcess)
    monkeypatch.setitem(TASKS, "turn", replace(TASKS["turn"], steps=40))
    monkeypatch.setattr(demo, "_DIAGNOSED", ("steps",))
    listed = candidates(demo.read_robot(data / "pool" / "robot.toml"))
    few = {one: free for one, free in listed.items() if one[0].startswith("skin")}
    monkeypatch.setattr("sim.inference.coordinates.candidates", lambda robot: few)
    monkeypatch.setattr(demo, "REPEATS", 2)
    monkeypatch.setattr(demo, "LONGEST", 15)
    folders = ["--data", str(data / "servo_steps"), "--pool", str(data / "pool")]
    assert main(["demo", *folders, "--out", str(out)]) == 0
    page = (out / "index.html").read_text()
    assert "Diagnosis of the swim" in page and "Identification" in page
    said = page.split("<body>")[1].partition("</header>")[0]
    assert "3 servos were identified from recordings" in said and "fish" not in said
    assert page.index("Results</h2>") < page.index("data:image/gif") < page.index("Recordings</h2>")
    assert page.count("<script>") == 1 and page.count('class="panels"') >= 4
    assert "The agents were trained beforehand" in page
    assert "data:image/gif;base64," in page, "it shows a swim to watch"
    assert (out / "swim.gif").read_bytes()[:6] == b"GIF89a"
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == f"report: {out / 'index.html'}"
    stages = [line.split()[0] for line in lines if line.endswith(" s)")]
    assert stages == [
        "read", "check", "identify", "diagnose", "replay", "diagnose", "calibrate", "ranges",
        "ablate", "swim", "report",
    ]  # fmt: skip
    agents = json.loads(next(out.glob("*/ablation.json")).read_text())["agents"]
    assert len(agents) == 4 * 5
    assert len(agents[0]["reality"]["return"]) == 2


@pytest.mark.slow
def test_demo_as_it_ships_finds_the_servos_calibration_significant(tmp_path, capsys):
    pytest.importorskip("rl.commands.demo", reason="no extra 'rl'")
    from rl.experiments.statistics import differences

    data, out = ROOT / "datasets", tmp_path / "demo"
    folders = ["--data", str(data / "servo_steps"), "--pool", str(data / "pool")]
    assert main(["demo", *folders, "--out", str(out)]) == 0
    apart = differences(json.loads((out / "ablation" / "ablation.json").read_text()))
    assert apart["no-servo"].low > 0
    assert all(apart["no-servo"].mean > one.mean for arm, one in apart.items() if arm != "no-servo")
    assert apart["no-density"].low < 0


VERBS = {
    name: getattr(module, name)
    for module, names in (
        (sim2real.exchange, ("export", "import_log")),
        (sim2real.verbs, ("check", "identify", "density", "posterior", "ranges", "predict")),
        (sim.verbs, ("diagnose", "design", "calibrate", "fit_twin", "simulate")),
    )
    for name in names
}
SET_BY_THE_COMMAND = {"ranges": {"chains"}, "export": {"source", "recordings"}}
COMMAND_OF = {"import_log": "import", "export": "export-servo"}


def options_of(command: str) -> dict[str, argparse.Action]:
    (several,) = (a for a in parser()._actions if a.dest == "command")
    return {action.dest: action for action in several.choices[command]._actions}


@pytest.mark.parametrize("name", VERBS)
def test_every_argument_of_a_verb_is_described(name):
    arguments = list(inspect.signature(VERBS[name]).parameters)
    assert list(described_arguments(VERBS[name])) == arguments


@pytest.mark.parametrize("name", [name for name in VERBS if name not in ("posterior", "predict")])
def test_a_command_takes_what_its_verb_takes(name):
    options = options_of(COMMAND_OF.get(name, name.replace("_", "-")))
    for argument, parameter in inspect.signature(VERBS[name]).parameters.items():
        if argument in SET_BY_THE_COMMAND.get(name, ()):
            continue
        assert argument in options, f"{name}: {argument}"
        if parameter.default is not inspect.Parameter.empty and not options[argument].required:
            assert options[argument].default == parameter.default, f"{name}: {argument}"


def test_identify_gives_the_same_digits_both_ways(short, tmp_path):
    folder = short / "datasets" / "servo_steps"
    files = [str(folder / f"{name}.csv") for name in ("steps", "chirp")]
    robot, out = str(folder / "robot.toml"), tmp_path / "model.json"
    assert main(["identify", *files, "--robot", robot, "--out", str(out), "--no-plots"]) == 0
    s2r.write_model(s2r.identify(files, robot), tmp_path / "same.json")
    written, same = (json.loads((tmp_path / n).read_text()) for n in ("model.json", "same.json"))
    for content in (written, same):
        content.pop("provenance")
    assert written == same
    assert main(["predict", str(out), files[0], "--out", str(tmp_path / "p.csv")]) == 0
    predicted = s2r.read_recording(tmp_path / "p.csv").position
    (angles,) = s2r.predict(files[0], robot, s2r.read_model(out)).angles
    assert abs(predicted - angles).max() < 1e-9
