"""How a package is built: files, lines, imports between its files, and how deep they stand.

python benchmarks/house.py [ROOT] [FOLDER...]

Code is what is neither blank, nor a docstring, nor an import. A floor is a step of the longest
chain of imports inside the folder; what imports nothing of it stands on the first. Imports inside
functions or for type checkers alone do not count.
"""

from __future__ import annotations

import argparse
import ast
from functools import cache
from pathlib import Path

_ROOMS = ("diagnose", "link", "effects", "inference", "servo")
FOLDERS = ("sim2real", *(f"sim2real/{room}" for room in _ROOMS))


def main() -> None:
    """Print a table, a row a folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("root", type=Path, nargs="?", default=Path("."))
    parser.add_argument("folders", nargs="*", default=list(FOLDERS))
    options = parser.parse_args()
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


if __name__ == "__main__":
    main()
