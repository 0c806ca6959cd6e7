"""Imports go down only (rl, then sim, then sim2real), and the heavy ones happen late."""

import ast
import importlib.util
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLOORS = ("sim2real", "sim", "rl")  # from the ground up
REACHES_UP = {
    "sim2real/cli.py": "a command may live on any floor, and is loaded when it runs",
    "sim2real/__init__.py": "verbs of the floors above are offered here, and loaded when used",
}
LIGHT = (
    *REACHES_UP,
    "sim2real/commands/options.py",
    "sim2real/exchange.py",
    "sim2real/verbs.py",
    "sim/commands/options.py",
    "sim/verbs.py",
)
HEAVY = {"torch", "warp", "cv2", "serial", "matplotlib", "scipy", "pandas", "numpy"}
ONLY_IN = {
    "warp": ("sim2real/servo/", "sim2real/effects/", "sim/"),
    "emcee": ("sim2real/",),
    "serial": ("sim2real/hardware/",),
    "cv2": ("sim2real/hardware/",),
    "torch": ("rl/",),
    "stable_baselines3": ("rl/",),
    "gymnasium": ("rl/",),
    "ray": ("sim2real/executor/",),
    "mujoco": ("sim2real/exporters/mujoco_bench.py",),
    "pinocchio": ("sim2real/arm/description.py",),
    "pyarrow": ("sim2real/importers/lerobot.py",),
    "rerun": ("sim2real/viewers/",),
    "mcap": ("sim2real/viewers/",),
    "datasets": (),
    "benchmarks": (),
    "tests": (),
}


@dataclass(frozen=True)
class Import:
    """A module imported at ``line`` of ``file``; late where a function does it."""

    file: str
    line: int
    module: str
    late: bool

    @property
    def package(self) -> str:
        return self.module.split(".")[0]


@cache
def repository_imports() -> tuple[Import, ...]:
    """Every import in this repository's packages."""
    return tuple(walk_imports(ROOT))


def walk_imports(root: Path) -> Iterator[Import]:
    """Every import in the packages under ``root``; those for type checkers alone don't count."""
    for floor in FLOORS:
        for path in sorted((root / floor).rglob("*.py")):
            file = path.relative_to(root)
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for node, late in statements(tree, late=False):
                for module in imported(node, file):
                    yield Import(file.as_posix(), node.lineno, module, late)


def statements(node: ast.AST, *, late: bool) -> Iterator[tuple[ast.stmt, bool]]:
    """Statements below ``node``, and whether they stand in a function."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        if isinstance(child, ast.stmt):
            yield child, late
        function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield from statements(child, late=late or function)


def imported(node: ast.stmt, file: Path) -> list[str]:
    """Full names of the modules that ``node`` imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        above = file.parts[: len(file.parts) - node.level] if node.level else ()
        return [".".join([*above, *([node.module] if node.module else [])])]
    called = node.value if isinstance(node, ast.Expr | ast.Assign | ast.Return) else None
    function = called.func if isinstance(called, ast.Call) else None
    name = getattr(function, "attr", getattr(function, "id", ""))  # of a.name() or of name()
    if isinstance(called, ast.Call) and name == "import_module":
        return [str(a.value) for a in called.args[:1] if isinstance(a, ast.Constant)]
    return []


def offences(imports: Iterable[Import]) -> list[str]:
    """Every one of the imports that the architecture forbids, one line each."""
    return [f"{i.file}:{i.line} {why}" for i in imports if (why := offence(i))]


def offence(found: Import) -> str | None:
    """Why ``found`` is forbidden, or None."""
    floor = FLOORS.index(found.file.split("/")[0])
    if found.package in FLOORS[floor + 1 :] and not (found.file in REACHES_UP and found.late):
        return f"imports {found.module} from the floor above"
    if found.package in HEAVY and found.file in LIGHT and not found.late:
        return f"imports {found.package} before it is needed"
    allowed = ONLY_IN.get(found.package)
    if allowed is not None and not found.file.startswith(allowed):
        return f"imports {found.package}, allowed in {', '.join(allowed) or 'no package'} only"
    return None


def test_imports_of_the_packages() -> None:
    assert offences(repository_imports()) == []


def test_the_inference_knows_neither_servo_nor_swim() -> None:
    own = [i for i in repository_imports() if i.file.startswith("sim2real/inference/")]
    assert own
    names = "arrays", "inference", "errors", "progress", "units"
    known = tuple(f"sim2real.{name}" for name in names)
    above = [i for i in own if i.package in FLOORS and not i.module.startswith(known)]
    assert above == []


@pytest.mark.parametrize("folder", ["benchmarks", "datasets", "examples"])
def test_names_that_scripts_import_from_the_packages_exist(folder: str) -> None:
    missing = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node, _ in statements(ast.parse(path.read_text(encoding="utf-8")), late=False):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in FLOORS:
                missing += [f"{path.name}: {node.module}.{name}" for name in lacking(node)]
    assert missing == []


def lacking(node: ast.ImportFrom) -> list[str]:
    """Names that a module does not have, neither itself nor as a submodule."""
    module = importlib.import_module(str(node.module))
    names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
    inside = hasattr(module, "__path__")
    return [n for n in names if not (inside and importlib.util.find_spec(f"{node.module}.{n}"))]


LIGHT_MODULES = ", ".join(
    file.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for file in LIGHT
)
HELP = "import contextlib\nwith contextlib.suppress(SystemExit):\n    main(['identify', '--help'])"


@pytest.mark.parametrize(
    ("program", "late"),
    [
        (f"import {LIGHT_MODULES}", HEAVY),  # not even through another module
        (f"from sim2real.cli import main\n{HELP}", {"sim", "rl", "numpy"}),
        (
            "from sim2real.cli import parser\nparser(only=[])",
            {"importlib.metadata", "tomllib"},  # by which the version is read
        ),
        ("import sim2real.report.notebook", {"matplotlib", "jinja2"}),
    ],
)
def test_what_is_heavy_is_not_loaded(program: str, late: set[str]) -> None:
    """So that ``sim2real --help`` answers at once."""
    call = [sys.executable, "-c", f"{program}\nimport sys\nprint(*sys.modules)"]
    run = subprocess.run(call, capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = run.stdout.splitlines()[-1].split()
    assert "sim2real" in loaded and late.isdisjoint(loaded)


@pytest.mark.parametrize(
    ("file", "source", "why"),
    [
        ("sim2real/fit.py", "import sim", "sim2real/fit.py:1 imports sim from the floor above"),
        ("sim2real/a/b.py", "from ...rl import env", "imports rl from the floor above"),
        ("sim/water.py", "import importlib\nimportlib.import_module('rl.env')", "imports rl.env"),
        ("sim2real/cli.py", "import sim.fluid", "imports sim.fluid from the floor above"),
        ("sim2real/cli.py", "class A:\n    import rl", "imports rl from the floor above"),
        ("sim2real/cli.py", "try:\n    import numpy as np\nfinally:\n    pass", "before it is"),
        ("sim/water.py", "import emcee", "imports emcee, allowed in sim2real/ only"),
        ("sim2real/fit.py", "import datasets.make", "imports datasets, allowed in no package"),
    ],
)
def test_an_offence_is_found(tmp_path: Path, file: str, source: str, why: str) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(source)
    found = offences(walk_imports(tmp_path))
    assert len(found) == 1
    assert why in found[0]
