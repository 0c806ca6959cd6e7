"""Without optional libraries, and without docstrings, commands work or say in one line why not."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from sim2real import cli, errors

ROOT = Path(__file__).parents[1]
DATA = ROOT / "datasets" / "servo_steps"
BARE = f"""
import sys

class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        optional = name.partition(".")[0] in {sorted(errors._LIBRARIES)}
        return None if optional else self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Without(finder) for finder in sys.meta_path]
"""
RUN = "from sim2real.cli import main\nsys.exit(main(sys.argv[1:]))"
EVERY_HELP = f"""
import sys
from sim2real.cli import main

for command in {list(cli.COMMANDS)}:
    try:
        main([command, "--help"])
    except SystemExit as stop:
        if stop.code != 0:
            raise
"""


def python(program: str, *arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, *arguments]
    search = {**os.environ, "PYTHONPATH": str(ROOT), **more}
    return subprocess.run(command, capture_output=True, text=True, env=search)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Seven seconds of one joint of a shipped recording, with its robot."""
    folder = tmp_path_factory.mktemp("bench")
    table = pd.read_csv(DATA / "steps.csv").iloc[:350]
    table[[c for c in table if c == "t_s" or c.startswith("j1.")]].to_csv(
        folder / "steps.csv", index=False
    )
    sidecar = json.loads((DATA / "steps.json").read_text())
    sidecar |= {"joints": ["j1"], "loads": {"j1": sidecar["loads"]["j1"]}}
    (folder / "steps.json").write_text(json.dumps(sidecar))
    shutil.copy(DATA / "robot.toml", folder)
    return folder


def call(command: str, bench: Path, out: str) -> list[str]:
    robot = ["--robot", str(bench / "robot.toml")]
    return [command, str(bench / "steps.csv"), *robot, "--out", str(bench / out)]


@pytest.mark.parametrize(("command", "what"), [("identify", "plots"), ("diagnose", "page")])
def test_the_result_is_printed_and_a_line_says_what_the_rest_needs(command, what, bench):
    done = python(BARE + RUN, *call(command, bench, f"{command}.json"))
    assert done.returncode == 0, done.stderr[-2000:]
    assert ("RMSE" if command == "identify" else "verdict") in done.stdout
    assert json.loads((bench / f"{command}.json").read_text())
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"no {what}: ")
    assert "pip install 'sim2real[report]'" in line, "of a wheel"
    assert "pip install -e '.[report]'" in line, "of a clone"


@pytest.mark.parametrize(
    ("arguments", "library"),
    [
        ("train --robot robot.toml --model model.json --out runs", "no PyTorch"),
        ("scan --port /dev/null", "no pyserial"),
        (
            "calibrate-camera a.png --pool 1,2 --board 7,5,0.04,0.03 "
            "--corners 0,0 1,0 1,1 0,1 --out c.toml",
            "no OpenCV",
        ),
        (f"density {DATA / 'robot.toml'} --plot density.png", "no Matplotlib"),
        ("completion bash", "no shtab"),
    ],
)
def test_what_a_command_cannot_do_without_is_one_line(arguments, library):
    done = python(BARE + RUN, *arguments.split())
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"found {library}, expected it installed: pip install 'sim2real[" in line


def test_every_optional_library_belongs_to_an_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = project["optional-dependencies"]
    for title, extra in errors._LIBRARIES.values():
        assert extra in named and f"{extra}," in named["all"][0].replace("]", ","), title


def test_help_of_every_command_without_optional_libraries_and_docstrings():
    done = python(BARE + EVERY_HELP, PYTHONOPTIMIZE="2", PYTHONDONTWRITEBYTECODE="1")
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    assert "all recordings of one joint are fitted together" in " ".join(done.stdout.split())
