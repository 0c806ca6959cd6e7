"""The examples run, as programs and as notebooks; what the verbs find prints and draws."""

import math
import os
import re
import subprocess
import sys
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simulated

import sim2real as s2r
from sim2real import example
from sim2real.cli import main
from sim2real.diagnose.result import Diagnosis, Mismatch
from sim2real.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES: dict[str, tuple[dict[str, Any], tuple[str, ...], str]] = {
    "identify_a_servo": ({}, ("model.json", "chirp.png"), "held out"),
    "find_what_is_missing": ({}, ("candidates.png",), "verdict: explained"),
    "posterior_and_ranges": ({"STEPS": 700}, ("ranges.json", "latency.png"), "j1.kp"),
    "calibrate_a_body": ({"SECONDS": 8}, ("calibrated.json", "calibration.png"), "twin.thrust"),
    "swim_your_own_robot": ({}, ("fish.toml", "way.png"), "path of the head"),
    "control_a_servo": ({"SECONDS": 0.1}, ("servo.casadi", "servo.c"), "servo: "),
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
    for folder, dataset in ((example.BENCH, "servo_steps"), (example.POOL, "pool")):
        for path in folder.iterdir():
            assert path.read_bytes() == (ROOT / "datasets" / dataset / path.name).read_bytes(), path


def test_the_example_is_copied_and_nothing_is_overwritten(tmp_path, capsys) -> None:
    out = tmp_path / "new" / "example"
    assert main(["example", "--out", str(out)]) == 0
    assert "sim2real identify" in capsys.readouterr().out
    assert {path.name for path in (out / "bench").iterdir()} == {
        path.name for path in example.BENCH.iterdir()
    }
    example.copy_example(out)
    (out / "bench" / "robot.toml").write_text("mine")
    (out / "pool" / "p1.csv").unlink()
    assert main(["example", "--out", str(out)]) == 2
    assert "robot.toml: found a file with other content" in capsys.readouterr().err
    assert (out / "bench" / "robot.toml").read_text() == "mine"
    assert not (out / "pool" / "p1.csv").exists()


BENCH, POOL = ROOT / "datasets" / "servo_steps", ROOT / "datasets" / "pool"
VERBS = (
    "identify", "diagnose", "calibrate", "density", "posterior", "ranges", "predict", "design",
    "simulate", "forecast", "check", "latency",
)  # fmt: skip


def prints_and_draws(result: object, *words: str) -> None:
    """It is frozen, its text is a table with these words, and its figure has something in it."""
    assert is_dataclass(result)
    with pytest.raises(AttributeError):
        result.anything = 1  # type: ignore[attr-defined]
    for word in words:
        assert word in str(result)
    figure = result.plot()  # type: ignore[attr-defined]
    assert any(axes.has_data() for axes in figure.axes)


@pytest.fixture(scope="module")
def steps() -> s2r.Recording:
    """Eight seconds of the first joint's steps."""
    return s2r.read_recording(BENCH / "steps.csv").between(0, 400)


@pytest.fixture(scope="module")
def model(steps) -> s2r.Model:
    return s2r.identify(steps, BENCH / "robot.toml")


def test_the_names_are_verbs_which_no_folder_hides() -> None:
    program = (
        "import sim2real as s\nassert set(dir(s)) >= set(s.__all__)\n"
        "import sim2real.ranges.entry, sim2real.posterior.posteriors, sim2real.diagnose.result\n"
        "import sim2real.robot, sim2real.check\n"
        f"print(*[type(getattr(s, name)).__name__ for name in {VERBS}])"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert run.stdout.split() == ["function"] * len(VERBS), run.stderr


def test_identify_and_predict(steps, model) -> None:
    prints_and_draws(model, "kp", "latency", "held out")
    found = s2r.predict(steps, BENCH / "robot.toml", model)
    prints_and_draws(found, "steps", "j1", "mrad")
    assert found.angles[0].shape == steps.position.shape
    assert max(found.rmse.values()) < 0.005
    unmeasured = replace(steps, position=np.full_like(steps.position, np.nan))
    blind = s2r.predict(unmeasured, BENCH / "robot.toml", model)
    np.testing.assert_array_equal(blind.angles[0], found.angles[0])
    assert all(math.isnan(error) for error in blind.rmse.values())


def test_density() -> None:
    found = s2r.density(BENCH / "robot.toml")
    prints_and_draws(found, "head", "density")
    assert np.average(found.value, weights=found.length_m) == pytest.approx(1.0)


def test_posterior_and_ranges(model) -> None:
    steps, model = simulated.linear_bench(model)
    chain = {"steps": 250, "walkers": 16, "seed": 3}
    found = s2r.posterior(steps, BENCH / "robot.toml", model, **chain)
    prints_and_draws(found, "kp", "N m/rad", "90 %")
    low, high = found.joints["j1"].quantiles(0.001, 0.999)[:, 0]
    assert low < model.joints["j1"].kp_Nm_per_rad < high
    assert found.sample().names[0] == "j1.kp_Nm_per_rad"
    same = s2r.ranges(steps, BENCH / "robot.toml", model, **chain)
    prints_and_draws(same, "command_latency_s", "uniform")
    np.testing.assert_array_equal(same.posteriors["j1"].values, found.joints["j1"].values)
    with pytest.raises(InputError, match="j1"):
        found.plot("tail")
    arviz = pytest.importorskip("arviz")
    data = found.to_arviz()
    assert set(data.posterior.data_vars) == set(found.sample().names)
    assert data.posterior["j2.latency_s"].attrs["units"] == "s"
    assert np.isfinite(arviz.summary(data)["mean"]).all()


def test_calibrate_and_simulate_in_the_twin() -> None:
    swim = s2r.read_recording(POOL / "p1.csv").between(0, 500)
    found = s2r.calibrate(swim, POOL / "robot.toml", POOL / "model.json")
    prints_and_draws(found, "twin.thrust", "held-out error", "surge")
    before, after = found.twin.train[:, 0]
    assert after < before
    swum = s2r.simulate(swim, POOL / "robot.toml", found.model, fidelity="twin")
    prints_and_draws(swum, "p1", "path of the head")
    one = swum.swims[0]
    assert one.kind == "pool"
    assert one.columns["body.x_m"][0] == pytest.approx(swim.columns["body.x_m"][0], abs=1e-6)
    away = np.hypot(*(one.columns[n][-1] - swim.columns[n][-1] for n in ("body.x_m", "body.y_m")))
    assert away < 0.5 * np.hypot(*(np.ptp(swim.columns[n]) for n in ("body.x_m", "body.y_m")))


def test_a_diagnosis_prints_each_signal_in_its_unit() -> None:
    joint = Mismatch("j1.position_rad", "j1", 0.005, 0.001, 0.9, {}, "always")
    speed = Mismatch("body.surge", "body", 0.012, 0.003, 0.9, {}, "")
    assert str(joint) == "j1: RMSE 5.00 mrad, noise 1.00 mrad; always"
    assert str(speed) == "surge: RMSE 0.0120 m/s, noise 0.0030 m/s"
    none = {key: {} for key in ("unknown", "baseline_fit", "enriched_fit")}
    found = Diagnosis(
        verdict="unexplained", mismatch=(joint, speed), effects=(), rivals=(), **none,
        detection_limits=(), next_experiment=None, gate=(),
        model=s2r.Model(joints={}),
    )  # fmt: skip
    prints_and_draws(found, "verdict: unexplained", str(joint), str(speed))
