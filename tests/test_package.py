"""What an installed package brings along."""

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


def test_a_copied_folder_without_metadata_has_a_version_too(tmp_path, monkeypatch):
    def lacking(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("sim2real.version.version", lacking)
    assert read_version(tmp_path) == UNKNOWN


def test_the_version_is_read_only_when_it_is_asked_for():
    program = (
        "import sys, sim2real\nfrom sim2real.cli import parser\nparser(only=[])\n"
        "assert 'importlib.metadata' not in sys.modules and 'tomllib' not in sys.modules\n"
        "print(sim2real.__version__)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert run.stdout == f"{VERSION}\n", run.stderr
