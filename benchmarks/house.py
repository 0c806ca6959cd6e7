"""How many functions and files one passes who reads what a verb does, with ``--way`` or without.

Methods count where their name is of one class. A stop is a function in another file than before.
"""

import ast
from pathlib import Path

import numpy as np

DOORS = {
    "sim2real.verbs": "identify",
    "sim2real.diagnose.diagnose": "diagnose",
    "sim.inference.diagnose_swims": "diagnose_recorded_swims",
}
_BUILT_IN = {name for kind in (dict, list, set, str, tuple, Path, np.ndarray) for name in dir(kind)}

Place = tuple[str, str]
functions: dict[Place, ast.FunctionDef] = {}  # by module and name; methods as ``Class.method``
imported: dict[Place, Place] = {}  # by module and word, module and name; no name of a module
owners: dict[str, list[Place]] = {}  # places of the methods of a name


def read(root: Path) -> None:
    """Read all functions and imports of the packages."""
    for path in sorted([*(root / "sim2real").rglob("*.py"), *(root / "sim").rglob("*.py")]):
        module = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
                home = alias.name, ""
                if isinstance(node, ast.ImportFrom):
                    home = node.module or "", alias.name
                imported[module, alias.asname or alias.name.split(".")[0]] = home
        functions.update(((module, x.name), x) for x in tree.body if isinstance(x, ast.FunctionDef))
        for kind in (x for x in tree.body if isinstance(x, ast.ClassDef)):
            for method in (x for x in kind.body if isinstance(x, ast.FunctionDef)):
                functions[module, f"{kind.name}.{method.name}"] = method
                owners.setdefault(method.name, []).append((module, f"{kind.name}.{method.name}"))


def meant(place: Place, called: ast.expr) -> Place:
    """Where the function stands that is called; empty where that is not known."""
    module, function = place
    if isinstance(called, ast.Name):
        word = called.id
        while (module, word) not in functions and (module, word) in imported:
            module, word = imported[module, word]
        return module, word
    if not isinstance(called, ast.Attribute):
        return "", ""
    if isinstance(called.value, ast.Name):
        if called.value.id == "self":
            return module, f"{function.partition('.')[0]}.{called.attr}"
        behind = ".".join(imported.get((module, called.value.id), ("", ""))).removesuffix(".")
        if (behind, called.attr) in functions:
            return behind, called.attr
    home, _ = imported.get((module, ast.unparse(called).split(".")[0]), (module, ""))
    known = owners.get(called.attr, []) if home.split(".")[0] in ("sim2real", "sim") else []
    return known[0] if len(known) == 1 and called.attr not in _BUILT_IN else ("", "")


def walk(place: Place, visited: dict[Place, None]) -> None:
    """Visit a function and, in the order of their lines, those that it calls."""
    if place in visited or place not in functions:
        return
    visited[place] = None
    calls = [node.func for node in ast.walk(functions[place]) if isinstance(node, ast.Call)]
    for called in sorted(calls, key=lambda node: (node.lineno, node.col_offset)):
        walk(meant(place, called), visited)


if __name__ == "__main__":
    read(Path("."))
    for door in DOORS.items():
        visited: dict[Place, None] = {}
        walk(door, visited)
        files = [file for file, _ in visited]
        stops = [file for k, file in enumerate(files) if k == 0 or files[k - 1] != file]
        print(f"{'.'.join(door)}: {len(stops)} stops, {len(stops) - len(set(files))} returns")
