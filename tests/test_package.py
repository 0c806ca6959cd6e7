"""What an installed package brings along, and what it does without extras and docstrings."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pandas as pd
import pytest

import sim2real
from sim2real import cli, errors
from sim2real.cli import main
from sim2real.version import UNKNOWN, read_version

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("package", ["sim2real", "sim", "rl"])
def test_a_wheel_has_every_file_that_the_code_reads(package):
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    shipped = {
        path
        for pattern in settings["package-data"][package]
        for path in (ROOT / package).glob(pattern)
    }
    there = {
        path
        for path in (ROOT / package).rglob("*")
        if path.is_file()
        and path.suffix in (".json", ".toml", ".html", ".css", ".js", ".csv", ".typed")
    }
    assert there <= shipped, sorted(str(path.relative_to(ROOT)) for path in there - shipped)


VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_the_version_of_a_checkout_is_that_of_its_project_file(capsys):
    assert sim2real.__version__ == VERSION
    assert set(dir(sim2real)) == {*sim2real.__all__, "__version__"}
    assert {"check", "export", "import_log"} < set(dir(sim2real))
    assert all(callable(getattr(sim2real, name)) for name in sim2real.__all__)
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"sim2real {VERSION}\n"


def test_the_version_of_an_installed_package_is_that_of_its_metadata(tmp_path, monkeypatch):
    monkeypatch.setattr("sim2real.version.version", lambda name: f"{name} 9.8")
    assert read_version(tmp_path) == "sim2real 9.8"
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'other'\nversion = '1'\n")
    assert read_version(tmp_path) == "sim2real 9.8"
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'sim2real'\nversion = '7.1'\n")
    assert read_version(tmp_path) == "7.1"

    def lacking(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("sim2real.version.version", lacking)
    assert read_version(tmp_path / "copied") == UNKNOWN


def test_the_citation_has_the_version():
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_conda_recipe_needs_what_the_wheel_needs():
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    recipe = yaml.safe_load((ROOT / ".github" / "conda" / "recipe.yaml").read_text())
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = content["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["report"]]
    wanted.append(f"python{project['requires-python']}")
    found = {line.replace(" ", "") for line in recipe["requirements"]["run"]}
    assert {line.replace("matplotlib>", "matplotlib-base>") for line in wanted} == found
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {home}" for name, home in project["scripts"].items()
    ]
    host = {line.replace(" ", "") for line in recipe["requirements"]["host"]}
    assert set(content["build-system"]["requires"]) <= host
    assert recipe["about"]["license_file"] == project["license-files"]


def test_a_release_has_a_section_of_the_changelog_as_its_text():
    """The program of the workflow, on the newest section that has a number."""
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())
    steps = workflow["jobs"]["release"]["steps"]
    (line,) = (
        line
        for step in steps
        for line in step.get("run", "").splitlines()
        if line.startswith("awk ")
    )
    changelog = (ROOT / "CHANGELOG.md").read_text()
    number = re.findall(r"^## \[(\d[^\]]*)\]", changelog, re.M)[0]
    program = f"version={number}; {line.rpartition(' > ')[0]}"
    run = subprocess.run(["sh", "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0 and run.stdout.strip()
    section = changelog.partition(f"## [{number}]")[2].partition("\n")[2].partition("\n## [")[0]
    assert run.stdout.strip() == section.strip()


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
