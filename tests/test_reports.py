"""``make reports``: its commands exist with their options, are in order, and go on after a stop."""

import ast
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from sim2real.cli import COMMANDS, parser

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")


def make(folder, *words, **environment):
    call = ["make", *words, "BIN=bin", "DEVICE=cuda:0"]
    clean = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    return subprocess.run(
        call, cwd=folder, env=clean | environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    done = make(ROOT, "-n", "reports", f"BUILD={tmp_path_factory.mktemp('reports')}")
    assert done.returncode == 0, done.stderr
    return done.stdout.replace("\\\n", " ")


def test_every_command_and_option_exists(printed):
    calls = re.findall(r"\bbin/(python|sim2real) ([^;|&>\n]+)", printed)
    assert len(calls) > 30
    for tool, line in calls:
        words = shlex.split(line)
        if tool == "sim2real":
            assert words[0] in COMMANDS, line
            parser(only=words[:1]).parse_args(words)
            continue
        module = words[0] == "-m"
        path = ROOT / (words[1].replace(".", "/") + ".py" if module else words[0])
        assert path.exists(), line
        source = path.read_text()
        declared = {
            "--" + keyword.arg.replace("_", "-")
            for call in ast.walk(ast.parse(source))
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "command_line"
            for keyword in call.keywords
            if keyword.arg
        }
        for option in (word for word in words[1 + module :] if word.startswith("--")):
            # f"--{kind}" is made of names that the script lists
            composed = 'f"--{' in source and f'"{option[2:]}"' in source
            known = f'"{option}"' in source or option in declared
            assert known or composed, f"{path.name}: {option}"


@pytest.mark.parametrize(
    "steps",
    [
        ("twin_fit --fluid", "twin_fit\n", "pool/sealed.py"),
        ("twin_fit\n", "sim2real calibrate", "--arms none", "--quick --first"),
        ("pool/make.py", "sim2real calibrate"),
        ("sealed_water.py", "pool_law_error", "sealed_answer.py"),
        ("sealed_answer.py", "--in-water", "sim2real diagnose"),
        ("calibrated.json --no-plots", "tune_controllers search"),
        ("ranges.json --no-page", "tune_controllers trials", "sim2real train", "sim2real evaluate"),
        ("demo_agents", "forecast_realities swim"),
        ("forecast_realities forecast", "forecast_realities energy"),
    ],
)
def test_what_is_made_first_is_used_after_it(printed, steps):
    places = [printed.index(step) for step in steps]
    assert places == sorted(places)


TOOL = """#!/bin/sh
echo "$(basename "$0") $*" >> calls
for word; do case $word in *.part) touch "$word";; esac; done
test "$(wc -l < calls)" -ne "${STOP:-0}"
"""


@pytest.fixture
def clone(tmp_path):
    """A clone's two makefiles, whose commands write down that they were called."""
    for name in ("bin", "reports/calibration", ".venv"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("Makefile", "reports/Makefile"):
        shutil.copy(ROOT / name, tmp_path / name)
    for name in ("pyproject.toml", "constraints.txt", ".venv/demo", ".venv/installed"):
        (tmp_path / name).touch()
    for name in ("python", "sim2real", "cp"):
        (tmp_path / "bin" / name).write_text(TOOL)
        (tmp_path / "bin" / name).chmod(0o755)
    (tmp_path / "bin" / "mv").write_text("#!/bin/sh\n/bin/mv -f $*; true\n")
    (tmp_path / "bin" / "mv").chmod(0o755)

    def called(*words, stop=0):
        path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
        done = make(tmp_path, *words, PATH=path, STOP=str(stop))
        calls = tmp_path / "calls"
        lines = calls.read_text().splitlines() if calls.exists() else []
        calls.unlink(missing_ok=True)
        return done.returncode, lines

    return called, tmp_path / "build" / "reports"


def test_a_call_that_was_stopped_goes_on_and_one_that_was_not_does_nothing(clone):
    called, build = clone
    code, stopped = called("reports", stop=25)
    assert code != 0
    code, rest = called("reports")
    assert code == 0
    assert called("reports") == (0, [])
    shutil.rmtree(build)
    _, whole = called("reports")
    again = [line for line in rest if line in stopped]
    assert stopped[-1] in again, "the step that was stopped is called again"
    assert len(again) < 12
    assert set(stopped) | set(rest) == set(whole)


def test_one_report_is_made_with_what_it_is_made_from(clone):
    called, build = clone
    _, lines = called("report-calibration")
    assert not any("ablate" in line or "sealed" in line for line in lines)
    assert {"twin", "swims", "calibration"} == {path.name for path in build.iterdir()}
    os.utime(build / "calibration" / "done", (0, 0))
    _, anew = called("report-calibration")
    assert anew == [line for line in lines if line in anew], "only what is older than its inputs"
    assert "twin_fit" not in " ".join(anew)
    assert anew
