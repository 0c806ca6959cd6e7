"""How a package is built: files, lines, imports between its files, and how deep they stand.

python benchmarks/house.py [ROOT] [FOLDER...] [--way]

Code is what is neither blank, nor a docstring, nor an import. A floor is a step of the longest
chain of imports inside the folder; what imports nothing of it stands on the first. Imports inside
functions or for type checkers alone do not count.

With ``--way``, three walks through the code as one reads it: from ``verbs.identify``,
``diagnose_all`` and ``diagnose_swims`` through the functions and methods that are called, each
once, in the order in which they are written. A method is followed where its name belongs to one
class and to no built-in type; attributes of what other packages define, such as ``np.log``, are not
followed. A stop is a function in another file than the one before; a return is a stop in a file
where one has been.
"""

from __future__ import annotations

import argparse
import ast
from functools import cache
from pathlib import Path

import numpy as np

_ROOMS = ("diagnose", "effects", "inference", "identification", "servo")
DOORS = (
    ("sim2real.verbs", "identify"),
    ("sim2real.diagnose.diagnose", "diagnose_all"),
    ("sim.inference.diagnose_swims", "diagnose_swims"),
)
"""Where walks begin: module and function."""
_BUILT_IN = {name for kind in (dict, list, set, str, tuple, Path, np.ndarray) for name in dir(kind)}
FOLDERS = ("sim2real", *(f"sim2real/{room}" for room in _ROOMS))


def main() -> None:
    """Print a table, a row a folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("root", type=Path, nargs="?", default=Path("."))
    parser.add_argument("folders", nargs="*", default=list(FOLDERS))
    parser.add_argument("--way", action="store_true", help="three walks instead")
    options = parser.parse_args()
    if options.way:
        code = Code(options.root)
        for door in DOORS:
            walk = code.walk(*door)
            files = [file for file, _ in walk]
            stops = [file for k, file in enumerate(files) if k == 0 or files[k - 1] != file]
            rooms = len(set(stops))
            print(
                f"{'.'.join(door)}: {len(walk)} functions, {len(stops)} stops in {rooms} files,"
                f" {len(stops) - rooms} returns"
            )
        return
    print("| folder | files | lines | of them code | longest file | imports inside | floors |")
    print("|---|---|---|---|---|---|---|")
    for folder in options.folders:
        if (options.root / folder).is_dir():
            print(f"| `{folder}/` | " + " | ".join(map(str, row(options.root, folder))) + " |")


def row(root: Path, folder: str) -> tuple[int, int, int, int, int, int]:
    """Files, lines, code, lines of the longest file, imports between files, floors."""
    files = {module(root, path): path for path in sorted((root / folder).rglob("*.py"))}
    lines = [len(path.read_text().splitlines()) for path in files.values()]
    arrows = {name: imports(path, files) - {name} for name, path in files.items()}

    @cache
    def floor(name: str) -> int:
        return 1 + max((floor(other) for other in arrows[name]), default=0)

    return (
        len(files),
        sum(lines),
        sum(code(path) for path in files.values()),
        max(lines),
        sum(map(len, arrows.values())),
        max(floor(name) for name in files),
    )


def code(path: Path) -> int:
    """Lines that are neither blank, nor of a docstring, nor of an import at the top."""
    text = path.read_text()
    tree, rest = ast.parse(text), set[int]()
    strings = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    ]
    imported = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    for node in (*strings, *imported):
        rest |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(text.splitlines(), start=1)
    return sum(bool(line.strip()) and number not in rest for number, line in lines)


def module(root: Path, path: Path) -> str:
    """The name by which a file is imported."""
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path, files: dict[str, Path]) -> set[str]:
    """Which of the files one imports."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    deep = found & set(files)
    # A package that is named only on the way to one of its files is no import of its own.
    return {name for name in deep if not any(other.startswith(f"{name}.") for other in deep)}


class Code:
    """The functions and methods of ``sim2real`` and ``sim`` below a folder.

    Attributes:
        functions: Syntax trees by module and name; methods as ``Class.method``.
        modules: The modules.
        imported: Module and name behind a word, by module and word; no name where it is a module.
        owners: Where the methods of each name stand.
    """

    def __init__(self, root: Path) -> None:
        self.functions: dict[tuple[str, str], ast.FunctionDef] = {}
        self.modules: set[str] = set()
        self.imported: dict[tuple[str, str], tuple[str, str]] = {}
        self.owners: dict[str, list[tuple[str, str]]] = {}
        for path in sorted([*(root / "sim2real").rglob("*.py"), *(root / "sim").rglob("*.py")]):
            name, tree = module(root, path), ast.parse(path.read_text())
            self.modules.add(name)
            for node in ast.walk(tree):
                if isinstance(node, ast.Import):
                    for alias in node.names:
                        word = alias.asname or alias.name.partition(".")[0]
                        self.imported[name, word] = alias.name, ""
                elif isinstance(node, ast.ImportFrom) and node.module:
                    for alias in node.names:
                        self.imported[name, alias.asname or alias.name] = node.module, alias.name
            for statement in tree.body:
                if isinstance(statement, ast.FunctionDef):
                    self.functions[name, statement.name] = statement
                elif isinstance(statement, ast.ClassDef):
                    self._add_class(name, statement)

    def _add_class(self, name: str, statement: ast.ClassDef) -> None:
        for member in statement.body:
            if isinstance(member, ast.FunctionDef):
                place = name, f"{statement.name}.{member.name}"
                self.functions[place] = member
                self.owners.setdefault(member.name, []).append(place)

    def walk(self, name: str, function: str) -> list[tuple[str, str]]:
        """Modules and functions in the order in which one comes to them from a door."""
        visited: dict[tuple[str, str], None] = {}

        def visit(place: tuple[str, str]) -> None:
            if place in visited or place not in self.functions:
                return
            visited[place] = None
            nodes = ast.walk(self.functions[place])
            calls = [node.func for node in nodes if isinstance(node, ast.Call)]
            for called in sorted(calls, key=lambda node: (node.lineno, node.col_offset)):
                visit(self._meant(place, called))

        visit((name, function))
        return list(visited)

    def _meant(self, place: tuple[str, str], called: ast.expr) -> tuple[str, str]:
        """Where the function stands that is called."""
        name, function = place
        if isinstance(called, ast.Name):
            word = called.id
            while (name, word) not in self.functions and (name, word) in self.imported:
                name, word = self.imported[name, word]
            return name, word
        if not isinstance(called, ast.Attribute):
            return "", ""
        if isinstance(called.value, ast.Name):
            if called.value.id == "self":
                return name, f"{function.partition('.')[0]}.{called.attr}"
            behind = ".".join(self.imported.get((name, called.value.id), ("",))).removesuffix(".")
            if behind in self.modules:
                return behind, called.attr
        first = ast.unparse(called).partition(".")[0]
        package = self.imported.get((name, first), (name, ""))[0].partition(".")[0]
        if package not in ("sim2real", "sim"):
            return "", ""
        owners = self.owners.get(called.attr, [])
        return owners[0] if len(owners) == 1 and called.attr not in _BUILT_IN else ("", "")


if __name__ == "__main__":
    main()
