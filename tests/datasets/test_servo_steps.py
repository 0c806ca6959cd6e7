"""The recordings that ship: made by their program, true to their truth, unknown to the library."""

import ast
import sys
from pathlib import Path

from datasets.servo_steps import make

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "datasets" / "servo_steps"
NAMES = ("steps", "sine", "square", "chirp")


def test_the_program_makes_the_committed_files_again(tmp_path):
    make.main(["--out", str(tmp_path)])
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(made) == {f"{n}.{e}" for n in NAMES for e in ("csv", "json")} | {"truth.json"}
    assert made == {name: (FOLDER / name).read_bytes() for name in made}


def test_no_library_code_knows_the_truth():
    files = [
        path
        for package in ("sim2real", "sim", "rl")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    assert files
    assert [str(path) for path in files if b"truth.json" in path.read_bytes()] == []


def test_the_program_imports_nothing_from_the_library():
    imported = set()
    for node in ast.walk(ast.parse((FOLDER / "make.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module.split(".")[0])
    assert imported <= set(sys.stdlib_module_names) | {"numpy"}
