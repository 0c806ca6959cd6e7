"""The version of this package: that of the source checkout it runs from, or as installed."""

import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

DISTRIBUTION = "sim2real"
UNKNOWN = "0+unknown"
"""Version of a copy of the folder that has neither metadata nor a ``pyproject.toml``."""


def read_version(folder: Path = Path(__file__).parents[1]) -> str:
    """The version of the package in a folder, a checkout before the installed metadata."""
    project = folder / "pyproject.toml"
    if project.is_file():
        content = tomllib.loads(project.read_text(encoding="utf-8")).get("project", {})
        if content.get("name") == DISTRIBUTION:
            return str(content["version"])
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return UNKNOWN


__version__ = read_version()
