"""What tests of the data sets' generators share."""

import importlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import ModuleType

import pytest

os.environ.setdefault("NUMBA_OPT", "1")  # read by Numba when it is imported; compiles faster

DATASETS = Path(__file__).parents[2] / "datasets"
POOL = (
    "truth", "servos", "surfaces", "waters", "camera", "world", "make", "drawn", "knower",
    "sealed",
)  # fmt: skip

_loaded: dict[tuple[Path, str], ModuleType] = {}
"""Modules of scripts by folder and name: Numba compiles the functions of each only once."""


@contextmanager
def _modules(*folders: Path, names: tuple[str, ...] = ()) -> Iterator[dict[str, ModuleType]]:
    """Modules of folders by name, which import one another as scripts do.

    While the context lasts they are importable; their names are free again after it, as folders
    use the same ones.
    """
    files = [path for folder in reversed(folders) for path in folder.glob("*.py")]
    homes = {path.stem: path.parent for path in files}
    before = list(sys.path)
    sys.path[:0] = map(str, folders)
    for name, folder in homes.items():
        sys.modules.pop(name, None)
        if (folder, name) in _loaded:
            sys.modules[name] = _loaded[folder, name]
    try:
        yield {name: importlib.import_module(name) for name in names or homes}
    finally:
        sys.path[:] = before
        for name, folder in homes.items():
            if name in sys.modules:
                _loaded[folder, name] = sys.modules.pop(name)


@pytest.fixture(scope="session")
def scripts() -> Callable[..., AbstractContextManager[dict[str, ModuleType]]]:
    """Loads the modules of folders, see ``_modules``."""
    return _modules


@pytest.fixture(scope="module")
def code(scripts):
    """The pool's modules by name."""
    with scripts(DATASETS / "pool", names=POOL) as modules:
        yield modules
