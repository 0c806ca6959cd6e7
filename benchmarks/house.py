"""How a package is built: files, lines, imports between its files, and how deep they stand.

python benchmarks/house.py [ROOT] [FOLDER...] [--way]

Code is what is neither blank, nor a docstring, nor an import. A floor is a step of the longest
chain of imports inside the folder; what imports nothing of it stands on the first. Imports inside
functions or for type checkers alone do not count.

With ``--way``, a recording's way to its diagnosis, as one reads it: from ``diagnose_all`` through
the functions that are called by name, each once, in the order in which they are written. A stop is
a function in another file than the one before; a return is a stop in a file where one has been.
"""

from __future__ import annotations

import argparse
import ast
from functools import cache
from pathlib import Path

_ROOMS = ("diagnose", "link", "effects", "inference", "residuals", "identification", "servo")
FOLDERS = ("sim2real", *(f"sim2real/{room}" for room in _ROOMS))


def main() -> None:
    """Print a table, a row a folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("root", type=Path, nargs="?", default=Path("."))
    parser.add_argument("folders", nargs="*", default=list(FOLDERS))
    parser.add_argument("--way", action="store_true", help="a recording's way instead")
    options = parser.parse_args()
    if options.way:
        for scope in ("sim2real/diagnose", "sim2real"):
            files = [file for file, _ in way(options.root, scope)]
            stops = [file for k, file in enumerate(files) if k == 0 or files[k - 1] != file]
            rooms = len(set(stops))
            print(f"{scope}/: {len(stops)} stops in {rooms} files, {len(stops) - rooms} returns")
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


def way(root: Path, scope: str) -> list[tuple[str, str]]:
    """Files and functions of a folder, in the order in which one comes to them."""
    paths = sorted((root / "sim2real").rglob("*.py"))
    bodies = {module(root, path): ast.parse(path.read_text()).body for path in paths}
    known = {
        (name, one.name): one
        for name, body in bodies.items()
        for one in body
        if isinstance(one, ast.FunctionDef)
    }
    taken = {
        (name, alias.asname or alias.name): (one.module, alias.name)
        for name, body in bodies.items()
        for one in body
        if isinstance(one, ast.ImportFrom) and one.module
        for alias in one.names
    }

    def meant(name: str, word: str) -> tuple[str, str]:
        """Where the function stands that a file calls by a word."""
        while (name, word) not in known and (name, word) in taken:
            name, word = taken[name, word]
        return name, word

    found: list[tuple[str, str]] = []

    def walk(place: tuple[str, str]) -> None:
        name, _ = place
        if place in found or place not in known or not f"{name}.".startswith(inside):
            return
        found.append(place)
        calls = [one.func for one in ast.walk(known[place]) if isinstance(one, ast.Call)]
        for called in sorted(calls, key=lambda one: (one.lineno, one.col_offset)):
            if isinstance(called, ast.Name):
                walk(meant(name, called.id))
            elif isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
                walk((".".join(taken.get((name, called.value.id), ("",))), called.attr))

    inside = scope.replace("/", ".") + "."
    walk(("sim2real.diagnose.diagnose", "diagnose_all"))
    return found


if __name__ == "__main__":
    main()
