import pytest


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """A standard excitation of six seconds, as refits take most of the time of these tests."""
    monkeypatch.setattr("sim2real.exporters.refit.SECONDS", 6.0)


@pytest.fixture
def modules(monkeypatch):
    """Runs an exported text with stand-ins for the modules that it imports; what it defines."""
    import sys
    from types import ModuleType

    def run(text, **contents):
        for name, content in contents.items():
            path = name.replace("__", ".")
            parents = [path[:k] for k, letter in enumerate(path) if letter == "."]
            for parent in parents:
                if parent not in sys.modules:
                    monkeypatch.setitem(sys.modules, parent, ModuleType(parent))
            module = ModuleType(path)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, path, module)
            if parents:
                vars(sys.modules[parents[-1]])[path.rpartition(".")[2]] = module
        space = {}
        exec(compile(text, "exported.py", "exec"), space)
        return space

    return run
