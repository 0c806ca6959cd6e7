"""What an installed package brings along."""

import tomllib
from pathlib import Path

import pytest

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
        if path.is_file() and path.suffix in (".json", ".toml", ".html", ".css", ".typed")
    }
    assert there <= shipped, sorted(str(path.relative_to(ROOT)) for path in there - shipped)
