"""Damaged files are read or refused in one line: by their readers, and by every command.

``python tests/test_damaged_files.py --seed S --cases N`` runs the cases of N seeds from S on,
each of which damages one file and runs one command on it in this process, and prints every case
that failed: an exception that escaped, a traceback, a refusal of more than a line, a result that
does not parse, more than 60 s or more than 4 GB.
"""

import argparse
import ast
import contextlib
import io
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
import traceback
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

sys.path[:0] = [str(Path(__file__).resolve().parents[k]) for k in (1, 0)]

from good_input import MODEL, ROBOT, csv_file  # noqa: E402
from mutations import mutate  # noqa: E402

from sim2real.cli import main  # noqa: E402
from sim2real.errors import InputError  # noqa: E402
from sim2real.model import read_model  # noqa: E402
from sim2real.recording import read_commands, read_recording  # noqa: E402
from sim2real.robot import read_robot  # noqa: E402

LONGEST_S, LARGEST_BYTES = 60, 4 * 2**30

BENCH, FISH, ARM = "--robot robot.toml", "--robot fish.toml", "--robot leg.toml"
SWIM = "--task near --episodes 1 --robot fish.toml --model calibrated.json"
ENTRY = "--as me --type x --source x --licence MIT --date 2026-01-31 --supply 7.4 --firmware-gain 1"
SHORT = "--steps 12 --walkers 12 --no-page"
OPEN = "--diagnosis diagnosis.json --contexts contexts.toml"
EXPORTS = ("mujoco", "mjlab", "isaaclab", "newton", "genesis", "urdf", "casadi", "json")
RANDOM = ("isaaclab", "mjlab", "newton", "mujoco-playground")
TABLE = "--columns t=time pan.command=goal pan.position=angle --units deg --time-unit ms"
COMMANDS: dict[str, float] = {
    "check a.csv b.csv " + BENCH: 4,
    "check swim.csv " + FISH: 2,
    "check a.csv --json": 1,
    f"identify a.csv b.csv {BENCH} --no-plots --out out.json": 2,
    f"identify a.csv {BENCH} --law pd --out out.json --json": 1,
    f"identify a.csv {BENCH} --effects backlash --no-plots --out out.json": 0.5,
    f"identify arm.csv {ARM} --no-plots --out out.json": 0.5,
    "predict model.json a.csv --out out.csv": 5,
    "predict calibrated.json swim.csv --out out.csv": 2,
    "predict gears.json a.csv --out out.csv": 2,
    f"ranges a.csv {BENCH} --model model.json {SHORT} --out out.json": 3,
    f"ranges c.csv {BENCH} --model gears.json {SHORT} --out out.json": 1,
    f"ranges swim.csv {FISH} --model calibrated.json {SHORT} --out out.json": 1,
    "latency a.csv --model model.json --out out.json": 0.5,
    f"design {BENCH} --model model.json --seconds 4 --no-page --out out.csv": 0.5,
    f"design {BENCH} {OPEN} --seconds 4 --no-page --out out.csv": 0.5,
    "density fish.toml --model calibrated.json --out out.json": 2,
    "robot from-urdf leg.urdf --out out.toml": 2,
    **{f"export-servo model.json --to {to} --out out.txt {BENCH}": 0.3 for to in EXPORTS},
    **{
        f"export-servo gears.json --to {to} --out out.txt --recordings a.csv": 0.1 for to in EXPORTS
    },
    **{f"export-ranges ranges.json --to {to} --out out.py": 1 for to in RANDOM},
    "import bam.json --out out.csv": 3,
    f"import table.csv {TABLE} --out out.csv": 3,
    f"simulate calibrated.json swim.csv {FISH} --fidelity twin --out out.csv": 4,
    f"simulate calibrated.json few.csv {FISH} --cell-m 0.04 --out out.csv": 0.5,
    f"calibrate swim.csv {FISH} --model calibrated.json --no-plots --out out.json": 1,
    f"diagnose a.csv {BENCH} --no-page --effort 0.1 --out out.json": 0.5,
    f"diagnose a.csv --references b.csv {BENCH} --no-page --effort 0.1 --out out.json": 0.5,
    "export sac.zip --out out.npz": 2,
    "export old.zip --out out.npz --format npz c": 2,
    f"evaluate sac.zip {SWIM} --ranges ranges.json": 1,
    f"evaluate policy.npz {SWIM}": 1,
    f"evaluate dqn.zip {SWIM} --out out.json": 0.5,
    f"evaluate pnl --gains gains.toml {SWIM}": 0.5,
    f"swim policy.npz --virtual --target 1,0 --seconds 1 {FISH} --model calibrated.json": 1,
    f"servos add gears.json {ENTRY} --out out.json": 2,
}


@pytest.mark.parametrize("seed", range(4))
def test_damaged_inputs_of_every_reader(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    good = csv_file(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "model.json").write_text(json.dumps(MODEL))
    readers = {"bench.csv": (read_recording, read_commands)}
    readers |= {"robot.toml": (read_robot,), "model.json": (read_model,)}
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for _ in range(150):
        for name, content in kept.items():
            (tmp_path / name).write_bytes(content)
        damaged = tmp_path / rng.choice(list(kept))
        how = mutate(damaged, rng)
        if rng.random() < 0.1:
            damaged.write_bytes(rng.randbytes(rng.randrange(100)))
        read = damaged if damaged.name != "bench.json" else good
        for reader in readers[read.name]:
            try:
                reader(read)
            except InputError as error:
                assert "\n" not in str(error), how


def test_damaged_inputs_of_commands() -> None:
    """Of new seeds in each run; whatever fails names its seed."""
    pytest.importorskip("stable_baselines3", reason="the extra 'rl' is not installed")
    call = [sys.executable, __file__, "--cases", "40"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, f"{done.stdout}\nthe last case:\n{done.stderr[-2000:]}"


class TooLong(BaseException):
    """A case takes too long."""


def _too_long(*_: object) -> None:
    raise TooLong(f"more than {LONGEST_S} s")


def run(arguments: list[str]) -> int:
    """Exit status of a command, if it ends as it should."""
    out, err = io.StringIO(), io.StringIO()
    signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(arguments)
        except SystemExit as stop:
            status = int(stop.code or 0)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
    printed = err.getvalue().splitlines()
    lines = [line for line in printed if ": warning: " not in line]
    assert "Traceback" not in out.getvalue() + err.getvalue(), err.getvalue()
    if status == 1 and "the flow became supersonic" in out.getvalue():
        return status
    if status == 1 and len(lines) == 1 and "no pose or joint angles for" in lines[0]:
        return status  # the virtual robot keeps real time, a busy machine may not
    assert status in (0, 2), f"status {status}: {printed}"
    found = status == 0 or (arguments[0] == "check" and out.getvalue())
    if "--json" in arguments and found:
        json.loads(out.getvalue(), parse_constant=_refuse)
    else:
        assert len(lines) == (0 if found else 1), f"status {status}: {printed}"
    return status


def parse(path: Path, command: str) -> None:
    """Read a result as strictly as its format allows."""
    readers: dict[str, Callable[[], object]] = {
        ".json": lambda: json.loads(path.read_text(), parse_constant=_refuse),
        ".csv": lambda: _table(path, simulated=command[:7] in ("predict", "simulat")),
        ".toml": lambda: tomllib.loads(path.read_text()),
        ".py": lambda: ast.parse(path.read_text()),
        ".xml": lambda: ET.parse(path),
        ".npz": lambda: dict(np.load(path, allow_pickle=False)),
    }
    readers.get(path.suffix, path.read_bytes)()


def _table(path: Path, *, simulated: bool) -> None:
    """Read a table; simulated angles are all there, measured ones may be missing."""
    table = pd.read_csv(path)
    assert not (simulated and table.filter(like="position_rad").isna().any().any()), "NaN"


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} in JSON")


def case(seed: int, good: Path, *, strict: bool) -> str:
    """Run one case in the current folder; say why it failed, if it did."""
    rng = random.Random(seed)
    command = rng.choices(list(COMMANDS), list(COMMANDS.values()))[0]
    words = command.split()
    read = [good / word for word in words if (good / word).exists() and "out" not in word]
    read += [path.with_suffix(".json") for path in read if path.suffix == ".csv"]
    damaged = rng.choice(sorted({path.name for path in read if path.exists()}))
    shutil.copytree(good, ".", dirs_exist_ok=True)
    about = f"--seed {seed}: {mutate(Path(damaged), rng)} of {damaged}; sim2real {command}"
    print(about, file=sys.stderr, flush=True)  # that of a case that never ends is the last
    try:
        with warnings.catch_warnings():
            if strict:
                warnings.simplefilter("error", RuntimeWarning)
            run(words)
        for path in Path().iterdir():
            if not (good / path.name).exists():
                parse(path, command)
        if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 > LARGEST_BYTES:
            return f"FAILED {about}\nmore than 4 GB"
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return f"FAILED {about}\n{''.join(traceback.format_exception(error))}"
    return ""


def run_cases(first: int, count: int, *, strict: bool = False) -> int:
    """Run the cases of these seeds; the number of those that failed, which are printed."""
    from good_files import write_good_files

    failed = 0
    with tempfile.TemporaryDirectory() as root:
        good = Path(root, "good")
        good.mkdir()
        write_good_files(good)
        resource.setrlimit(resource.RLIMIT_DATA, (LARGEST_BYTES, resource.RLIM_INFINITY))
        for seed in range(first, first + count):
            folder = Path(root, str(seed))
            folder.mkdir()
            with contextlib.chdir(folder):
                problem = case(seed, good, strict=strict)
            shutil.rmtree(folder)
            failed += bool(problem)
            print(problem, end="", flush=True)
    print(f"{count} cases from seed {first}: {failed} failed")
    return failed


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seed", type=int, default=random.SystemRandom().randrange(2**48))
    options.add_argument("--cases", type=int, default=1)
    options.add_argument("--strict", action="store_true", help="RuntimeWarnings are failures")
    given = options.parse_args()
    sys.exit(run_cases(given.seed, given.cases, strict=given.strict) > 0)
