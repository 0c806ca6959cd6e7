"""What an installed package brings along."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import sim2real
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
    assert "__version__" in dir(sim2real)
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


def test_the_version_is_read_only_when_it_is_asked_for():
    program = (
        "import sys, sim2real\nfrom sim2real.cli import parser\nparser(only=[])\n"
        "assert 'importlib.metadata' not in sys.modules and 'tomllib' not in sys.modules\n"
        "print(sim2real.__version__)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert run.stdout == f"{VERSION}\n", run.stderr


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


def test_a_copied_folder_without_metadata_has_a_version_too(tmp_path, monkeypatch):
    def lacking(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("sim2real.version.version", lacking)
    assert read_version(tmp_path) == UNKNOWN
