"""Commands and verbs: the same arguments, the same defaults, the same result to the last digit."""

import argparse
import inspect
import json
from pathlib import Path

import pytest

import sim.verbs
import sim2real as s2r
import sim2real.verbs
from sim2real.cli import main, parser
from sim2real.commands.command import described_arguments

ROOT = Path(__file__).resolve().parents[2]
VERBS = {
    name: getattr(module, name)
    for module, names in (
        (sim2real.verbs, ("identify", "density", "posterior", "ranges", "predict")),
        (sim.verbs, ("diagnose", "design", "calibrate", "simulate")),
    )
    for name in names
}
SET_BY_THE_COMMAND = {"ranges": {"chains"}}


def options_of(command: str) -> dict[str, argparse.Action]:
    (several,) = (a for a in parser()._actions if a.dest == "command")
    return {action.dest: action for action in several.choices[command]._actions}


@pytest.mark.parametrize("name", VERBS)
def test_every_argument_of_a_verb_is_described(name):
    arguments = list(inspect.signature(VERBS[name]).parameters)
    assert list(described_arguments(VERBS[name])) == arguments


@pytest.mark.parametrize("name", [name for name in VERBS if name not in ("posterior", "predict")])
def test_a_command_takes_what_its_verb_takes(name):
    options = options_of(name)
    for argument, parameter in inspect.signature(VERBS[name]).parameters.items():
        if argument in SET_BY_THE_COMMAND.get(name, ()):
            continue
        assert argument in options, f"{name}: {argument}"
        if parameter.default is not inspect.Parameter.empty:
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
