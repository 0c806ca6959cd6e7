import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "paper_table.py"


@pytest.fixture(scope="session")
def paper():
    """The generator of recordings from the paper's table."""
    spec = importlib.util.spec_from_file_location("paper_table", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]
