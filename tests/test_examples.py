"""Every example runs, as a program and as a notebook, and writes what it says that it writes."""

import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from sim2real.cli import main
from sim2real.example import BENCH, POOL, copy_example

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES: dict[str, tuple[dict[str, Any], tuple[str, ...], str]] = {
    "identify_a_servo": ({}, ("model.json", "chirp.png"), "held out"),
    "find_what_is_missing": ({}, ("candidates.png",), "verdict: explained"),
    "posterior_and_ranges": ({"STEPS": 700}, ("ranges.json", "latency.png"), "j1.kp"),
    "calibrate_a_body": ({"SECONDS": 8}, ("calibrated.json", "calibration.png"), "twin.thrust"),
    "swim_your_own_robot": ({}, ("fish.toml", "way.png"), "path of the head"),
    "train_with_gymnasium": ({"STEPS": 150, "FILMED": 20}, ("policy.zip", "swim.gif"), "swim.gif"),
}
"""Parameters, files and a part of the output of each."""
_PARAMETERS = '# %% tags=["parameters"]\n'


def with_parameters(name: str, **parameters: object) -> str:
    """The program with other values in its cell of parameters."""
    program = (ROOT / "examples" / f"{name}.py").read_text()
    for key, value in parameters.items():
        program, found = re.subn(rf"^{key} = .*$", f"{key} = {value!r}", program, flags=re.M)
        assert found == 1, key
    return program


def test_all_are_here() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == set(EXAMPLES)
    listed = (ROOT / "examples" / "README.md").read_text()
    assert all(f"[{name}.py]({name}.py)" in listed for name in EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs(name, short, tmp_path, monkeypatch, capsys) -> None:
    """As a program does, in this process: importing the libraries anew takes longer than it."""
    for dataset, folder in (("servo_steps", "BENCH"), ("pool", "POOL")):
        monkeypatch.setattr(f"sim2real.example.{folder}", short / "datasets" / dataset)
    if name == "train_with_gymnasium":
        pytest.importorskip("torch", reason="the extra 'rl' is not installed")
    parameters, files, said = EXAMPLES[name]
    program = with_parameters(name, OUT=str(tmp_path / "out"), **parameters)
    assert program.count(_PARAMETERS) == 1
    monkeypatch.chdir(tmp_path)  # it needs nothing of the clone
    monkeypatch.setenv("MPLBACKEND", "agg")
    exec(compile(program, name, "exec"), {"__name__": "__main__"})
    assert said in capsys.readouterr().out
    for file in files:
        assert (tmp_path / "out" / file).stat().st_size > 100


def test_it_runs_as_a_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jupytext = pytest.importorskip("jupytext", reason="Jupytext is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *sys.path]))
    program = with_parameters("swim_your_own_robot", OUT=str(tmp_path))
    notebook = jupytext.reads(program, fmt="py:percent")
    assert notebook.cells[0].cell_type == "markdown"
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute(cwd=str(tmp_path))
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("path of the head" in output.get("text", "") for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs), "a figure is shown"


def test_the_example_recordings_are_those_of_the_datasets() -> None:
    for folder, dataset in ((BENCH, "servo_steps"), (POOL, "pool")):
        for path in folder.iterdir():
            assert path.read_bytes() == (ROOT / "datasets" / dataset / path.name).read_bytes(), path


def test_the_example_is_copied_and_nothing_is_overwritten(tmp_path, capsys) -> None:
    out = tmp_path / "new" / "example"
    assert main(["example", "--out", str(out)]) == 0
    assert "sim2real identify" in capsys.readouterr().out
    assert {path.name for path in (out / "bench").iterdir()} == {p.name for p in BENCH.iterdir()}
    copy_example(out)
    (out / "bench" / "robot.toml").write_text("mine")
    (out / "pool" / "p1.csv").unlink()
    assert main(["example", "--out", str(out)]) == 2
    assert "robot.toml: found a file with other content" in capsys.readouterr().err
    assert (out / "bench" / "robot.toml").read_text() == "mine"
    assert not (out / "pool" / "p1.csv").exists()
