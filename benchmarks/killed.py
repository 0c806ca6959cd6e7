"""Kill ``sim2real ranges`` at random moments, run it again until it is done, and compare bits.

python benchmarks/killed.py --kills 10
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sim2real.commands.ranges import POSTERIOR
from sim2real.posterior.chain import Chain, chain_file, read_chain

ROOT = Path(__file__).parents[1]
DATA = ROOT / "datasets" / "servo_steps"
MODEL = ROOT / "reports" / "servo_steps" / "model.json"
JOINTS = ("j1", "j2", "j3")
STEPS = 2000


def main() -> int:
    """Compare a run that was killed again and again with one that was not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, help="of the moments; new ones in every run by default")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole.json", Path(folder) / "killed" / "killed.json"
        begun = time.perf_counter()
        started(whole).wait()
        lasts = time.perf_counter() - begun
        print(f"uninterrupted: {lasts:.1f} s")
        kills = 0
        while kills < options.kills:
            process = started(killed)
            moment = float(rng.uniform(0.0, 0.6 * lasts))
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
            else:  # it was done before: the next one starts from nothing
                for file in killed.parent.iterdir():
                    file.unlink()
                continue
            kills += 1
            print(f"killed after {moment:4.1f} s; steps in the files: {progress(killed)}")
        started(killed).wait()
        same = [equal(whole, killed, joint) for joint in JOINTS]
        same.append(samples_equal(whole.with_name(POSTERIOR), killed.with_name(POSTERIOR)))
        print(f"bit for bit: {sum(same)} of {len(same)} files, after {kills} kills")
        return 0 if all(same) else 1


def started(out: Path) -> subprocess.Popen[bytes]:
    """``sim2real ranges`` on the shipped recordings, in a process of its own."""
    out.parent.mkdir(exist_ok=True)
    files = [DATA / "steps.csv", "--robot", DATA / "robot.toml", "--model", MODEL, "--out", out]
    command = [sys.executable, "-m", "sim2real", "ranges", *files, "--steps", STEPS, "--no-page"]
    return subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL, cwd=ROOT)


def progress(out: Path) -> str:
    """Steps that the file of each joint holds."""
    files = [chain_file(out, joint) for joint in JOINTS]
    return ", ".join(str(read_chain(f).steps) if f.exists() else "none" for f in files)


def equal(whole: Path, killed: Path, joint: str) -> bool:
    """Whether both chains of a joint are the same bit for bit, random numbers included."""
    a, b = (bits(read_chain(chain_file(out, joint))) for out in (whole, killed))
    return a == b


def bits(chain: Chain) -> tuple[bytes, ...]:
    """Everything in a chain."""
    arrays = (chain.coordinates, chain.log_density, chain.accepted, chain.random[1])
    origin = tuple(chain.origin[name].tobytes() for name in sorted(chain.origin))
    return *(x.tobytes() for x in arrays), *origin, repr(chain.random[2:]).encode()


def samples_equal(a: Path, b: Path) -> bool:
    """Whether both posterior samples are the same."""
    with np.load(a, allow_pickle=False) as first, np.load(b, allow_pickle=False) as second:
        return bool(np.array_equal(first["sample"], second["sample"]))


if __name__ == "__main__":
    sys.exit(main())
