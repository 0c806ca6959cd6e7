import sys
from types import ModuleType

import pytest


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """A standard excitation of six seconds, as refits take most of the time of these tests."""
    monkeypatch.setattr("sim2real.exporters.nearest.SECONDS", 6.0)


@pytest.fixture
def modules(monkeypatch):
    """Runs an exported text with stand-ins for the modules that it imports; what it defines."""

    def run(text, **contents):
        for name, content in contents.items():
            parent = None
            for part in name.split("__"):
                path = f"{parent.__name__}.{part}" if parent else part
                module = sys.modules.get(path) or ModuleType(path)
                monkeypatch.setitem(sys.modules, path, module)
                if parent:
                    setattr(parent, part, module)
                parent = module
            vars(module).update(content)
        space = {}
        exec(compile(text, "exported.py", "exec"), space)
        return space

    return run
