"""Damaged files: every command ends with a result or with one line, in 60 s and 4 GB."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3", reason="the extra 'rl' is not installed")

PROGRAM = Path(__file__).with_name("mutated.py")


def run(cases: int, processes: int, timeout_s: float) -> None:
    """Run cases of new seeds in each of some processes; whatever fails names its seed."""
    first = random.SystemRandom().randrange(2**40)
    calls = [
        [sys.executable, str(PROGRAM), "--seed", str(first + k * cases), "--cases", str(cases)]
        for k in range(processes)
    ]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    started = [subprocess.Popen(call, **pipes) for call in calls]
    failed = []
    for process in started:
        try:
            out, err = process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
        if process.returncode:
            failed.append(f"{out}\nstatus {process.returncode}, the last case:\n{err[-2000:]}")
    assert not failed, "\n".join(failed)


def test_damaged_files():
    run(40, processes=1, timeout_s=240)


@pytest.mark.slow
def test_a_thousand_damaged_files():
    run(500, processes=2, timeout_s=3600)
