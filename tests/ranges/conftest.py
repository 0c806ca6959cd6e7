import importlib
from pathlib import Path

import pytest


@pytest.fixture
def paper(monkeypatch):
    """The generator of recordings from the paper's table."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2]))
    return importlib.import_module("benchmarks.paper_table")
