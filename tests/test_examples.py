"""Every example runs, and leaves what it says that it leaves."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = {
    "identify_a_servo": ([], ("model.json", "chirp.png"), "held out"),
    "find_what_is_missing": ([], ("candidates.png",), "verdict: explained"),
    "posterior_and_ranges": (["--steps", "240"], ("ranges.json", "latency.png"), "j1.kp"),
    "calibrate_a_body": (["--seconds", "8"], ("calibrated.json", "calibration.png"), "twin.thrust"),
    "swim_your_own_robot": ([], ("fish.toml", "way.png"), "path of the head"),
    "train_with_gymnasium": (
        ["--steps", "150", "--filmed", "20"], ("policy.zip", "swim.gif"), "swim.gif",
    ),
}  # fmt: skip


def test_all_are_here() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == set(EXAMPLES)
    listed = (ROOT / "examples" / "README.md").read_text()
    assert all(f"[{name}.py]({name}.py)" in listed for name in EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs(
    name: str,
    short: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As a program does, in this process: importing the libraries anew takes longer than it."""
    if name == "train_with_gymnasium":
        pytest.importorskip("torch", reason="the extra 'rl' is not installed")
    more, files, said = EXAMPLES[name]
    program = str(ROOT / "examples" / f"{name}.py")
    monkeypatch.chdir(short)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr(sys, "argv", [program, "--out", str(tmp_path), *more])
    runpy.run_path(program, run_name="__main__")
    assert said in capsys.readouterr().out
    for file in files:
        assert (tmp_path / file).stat().st_size > 100
