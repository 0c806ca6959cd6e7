"""What tests of the pool share."""

import importlib
import sys
from pathlib import Path

import pytest

POOL = Path(__file__).parents[2] / "datasets" / "pool"
NAMES = (
    "truth", "servos", "surfaces", "waters", "camera", "world", "make", "drawn", "knower",
    "sealed", "sealed_grade",
)  # fmt: skip


@pytest.fixture(scope="module")
def code():
    """The pool's modules by name; they import one another as scripts do."""
    sys.path.insert(0, str(POOL))
    try:
        yield {name: importlib.import_module(name) for name in NAMES}
    finally:
        sys.path.remove(str(POOL))
        for name in NAMES:
            sys.modules.pop(name, None)
