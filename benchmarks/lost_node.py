"""Lose a node of a Ray cluster in the middle of a set of cases and of an ablation, and compare.

    python benchmarks/lost_node.py [--set SET]

Two Ray nodes run on this machine. Once both have work, one is killed, and later another joins. The
results must be those of local processes, to the last digit. SET is a sealed set
(``datasets/concealed/make.py``); without it only the ablation runs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
POOL = ROOT / "datasets" / "pool"
NODE = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
DIFFERENT = ("provenance",)
"""Fields that name the command and its files."""


def main() -> int:
    """Run both, with and without the loss."""
    os.environ.setdefault("RAY_raylet_start_wait_time_s", "180")  # a busy machine starts slowly
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--set", type=Path, help="a sealed set of a few cases")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        if options.set:
            solve = (str(ROOT / "datasets" / "concealed" / "solve.py"), str(options.set))
            compare("set", [*solve, "{out}"], place, "*/*ed.json", "*/diagnosis.json")
        ablation = ["-m", "sim2real", "ablate", *small_ablation(), "--out", "{out}"]
        compare("ablation", ablation, place, "ablation.json")
    return 0


def small_ablation() -> list[str]:
    """Two arms with two seeds; reality is a model, as a pool is slow on a CPU."""
    files = {name: str(POOL / f"{name}.json") for name in ("model", "ranges", "reality")}
    return [
        "--robot", str(POOL / "robot.toml"),
        *(word for name, file in files.items() for word in (f"--{name}", file)),
        *("--arms", "all", "no-servo", "--seeds", "2", "--repeats", "2", "--task", "near"),
        *("--envs", "8", "--steps", "8000", "--segment", "4000", "--updates-per-step", "0.05"),
    ]  # fmt: skip


def compare(name: str, command: list[str], place: Path, *results: str) -> None:
    """Run a command with local processes and on a cluster that loses a node; compare the results.

    Raises:
        SystemExit: If they differ, or there are none.
    """
    whole, lost = place / f"{name}-local", place / f"{name}-ray"
    begun = time.perf_counter()
    if started(command, whole, "--executor", "local", "--jobs", "2").wait():
        raise SystemExit(f"{name}: the local run failed")
    print(f"{name}: {time.perf_counter() - begun:.0f} s with local processes", flush=True)
    from ray.cluster_utils import Cluster  # it reads the environment

    begun = time.perf_counter()
    cluster = Cluster(initialize_head=True, head_node_args=NODE)
    second = cluster.add_node(**NODE)
    cluster.wait_for_nodes()
    process = started(command, lost, "--executor", "ray", "--address", cluster.address)
    before = wait_for_two(lost, process)
    cluster.remove_node(second, allow_graceful=False)
    gone = wait_for_a_loss(before, process)
    cluster.add_node(**NODE)
    status = process.wait()
    cluster.shutdown()
    if status:
        raise SystemExit(f"{name}: the run that lost a node failed")
    seconds = time.perf_counter() - begun
    print(f"{name}: {seconds:.0f} s on Ray; a node was lost that was at {gone}", flush=True)
    names = sorted(p.relative_to(whole) for pattern in results for p in whole.glob(pattern))
    different = [str(n) for n in names if content(whole / n) != content(lost / n)]
    if different or not names:
        raise SystemExit(f"{name}: differ: {', '.join(different) or 'no results'}")
    print(f"{name}: {len(names)} files of results, the same to the last digit", flush=True)


def started(command: list[str], out: Path, *more: str) -> subprocess.Popen[bytes]:
    """The command in a process of its own, which writes into the folder ``out``."""
    words = [word.format(out=out) for word in command]
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.Popen(
        [sys.executable, *words, *more],
        stdout=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": path},
    )


def running(out: Path) -> dict[str, int]:
    """Process of each job that has been started and is not done."""
    locks = [lock for lock in out.rglob("lock") if not (lock.parent / "done.json").exists()]
    found = {lock.parent.name: lock.read_text().split() for lock in locks}
    return {name: int(words[0]) for name, words in found.items() if words}


def wait_for_two(out: Path, process: subprocess.Popen[bytes]) -> dict[str, int]:
    """The jobs at work, as soon as there are two that have worked for a few seconds."""
    since: dict[str, float] = {}
    while process.poll() is None:
        jobs = running(out)
        since = {name: since.get(name, time.monotonic()) for name in jobs}
        if sum(time.monotonic() - start > 3 for start in since.values()) >= 2:
            return jobs
        time.sleep(0.1)
    raise SystemExit("it ended before two jobs ran at a time")


def wait_for_a_loss(before: dict[str, int], process: subprocess.Popen[bytes]) -> str:
    """Name of the job whose process has ended with its node."""
    while process.poll() is None:
        for name, worker in before.items():
            if not Path(f"/proc/{worker}").exists():
                return name
        time.sleep(0.05)
    raise SystemExit("it ended before the node was lost")


def content(path: Path) -> Any:  # noqa: ANN401 - any JSON
    """A result without the fields that differ between runs."""
    found = json.loads(path.read_text())
    return {key: value for key, value in found.items() if key not in DIFFERENT}


if __name__ == "__main__":
    sys.exit(main())
