"""Speed and memory of a reality that a Python file makes, and how long an ablation swims in it.

    python benchmarks/reality_speed.py datasets/pool/reality.py --device cuda:0 --cells 0.01 0.005

For each size of cells prints robots in a batch, seconds a control period, GPU memory, and minutes
that so many episodes of 1000 periods would take, as many robots at a time as the file says.
"""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path

import numpy as np
import warp as wp

from rl.experiments.reality import read_reality
from rl.task import TASKS
from sim.fluid.fluid import find_device
from sim2real.robot import read_robot

ROBOT = Path(__file__).parents[1] / "datasets" / "pool" / "robot.toml"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--robot", type=Path, default=ROBOT)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.01, 0.005])
    parser.add_argument("--episodes", type=int, default=75)
    parser.add_argument("--steps", type=int, default=50)
    options = parser.parse_args()
    robot, device = read_robot(options.robot), find_device(options.device)
    J, long = len(robot.joints), TASKS["turn"].steps
    for cell_m in options.cells:
        file = read_reality(options.file, cell_m=cell_m)
        groups = -(-options.episodes // (file.at_once or options.episodes))
        n = -(-options.episodes // groups)
        before = _used(device)
        reality = file(robot, n, 0, options.device)
        pose, _, _ = TASKS["turn"].place(np.random.default_rng(0), n, J)
        reality.reset(pose, np.zeros((n, J)))
        wave = 0.5 * np.sin(0.1 * np.arange(options.steps + 2)[:, None] - np.arange(J))
        for desired in wave[:2]:  # compiles
            reality.step(np.tile(desired, (n, 1)))
        begun = time.perf_counter()
        for desired in wave[2:]:
            seen, _ = reality.step(np.tile(desired, (n, 1)))
        period = (time.perf_counter() - begun) / options.steps
        print(
            f"cells {100 * cell_m:g} cm: {n} robots, {1e3 * period:.1f} ms a control period, "
            f"{(_used(device) - before) / 2**30:.2f} GiB; {options.episodes} episodes in {groups} "
            f"groups: {groups * long * period / 60:.1f} min; {np.isnan(seen).any(axis=1).sum()} "
            f"robots lost, moved {np.abs(seen[:, :2] - pose[:, :2]).max():.3f} m",
            flush=True,
        )
        del reality
        gc.collect()


def _used(device: wp.Device) -> int:
    """Bytes of GPU memory in use; 0 on a CPU."""
    return int(device.total_memory - device.free_memory) if device.is_cuda else 0


if __name__ == "__main__":
    main()
