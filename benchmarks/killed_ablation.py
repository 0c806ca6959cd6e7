"""Kill ``sim2real ablate`` at random moments, run it again until it is done, and compare.

python benchmarks/killed_ablation.py --kills 10
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

POOL = Path(__file__).parents[1] / "datasets" / "pool"


def main() -> int:
    """Compare the table of a run that was killed again and again with one that was not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, help="of the moments; new ones in every run by default")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        begun = time.perf_counter()
        if started(whole).wait():
            raise SystemExit("the uninterrupted run failed")
        lasts = time.perf_counter() - begun
        print(f"uninterrupted: {lasts:.1f} s", flush=True)
        kills = 0
        while kills < options.kills:
            process = started(killed)
            moment = float(rng.uniform(0.3, 0.95) * lasts)
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                kills += 1
                print(f"killed after {moment:.1f} s: {left(killed)}", flush=True)
            else:  # done before its time: the next one begins anew
                compare(whole, killed)
                shutil.rmtree(killed)
        if started(killed).wait():
            raise SystemExit("the killed run failed")
        compare(whole, killed)
    print(f"{kills} kills: the same tables, to the last digit")
    return 0


def started(folder: Path) -> subprocess.Popen[bytes]:
    """A small ablation: two arms, two seeds; reality is a model, as a pool is slow on a CPU."""
    files = {name: str(POOL / f"{name}.json") for name in ("model", "ranges", "reality")}
    return subprocess.Popen(
        [
            sys.executable, "-m", "sim2real", "ablate", "--robot", str(POOL / "robot.toml"),
            *(word for name, file in files.items() for word in (f"--{name}", file)),
            "--arms", "all", "no-servo", "--seeds", "2", "--repeats", "2", "--task", "near",
            "--envs", "8", "--steps", "24000", "--segment", "4000", "--updates-per-step", "0.05",
            "--out", str(folder),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


def left(folder: Path) -> str:
    """What a killed run has in its folder."""
    files = [path.name for path in folder.rglob("*.*") if not path.name.startswith(".")]
    return ", ".join(sorted(set(files))) or "nothing"


def compare(whole: Path, killed: Path) -> None:
    """Stop where the tables differ."""
    one, other = (
        json.loads((folder / "ablation.json").read_text())["agents"] for folder in (whole, killed)
    )
    if one != other:
        raise SystemExit("the tables differ")


if __name__ == "__main__":
    sys.exit(main())
